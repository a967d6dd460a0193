"""Apache Parquet: a float64 column a signal, its unit in the field's metadata, the name in the schema's."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import pyarrow as pa
from pyarrow import parquet

from fmus.errors import TraceError
from orchestrator.formats.arrow import arrays, numbers
from orchestrator.formats.layout import MAX_VALUES, Columns, Layout, choose
from orchestrator.formats.recording import Recording, excerpt
from orchestrator.interrupts import whole
from orchestrator.trace import FloatArray, Trace

GROUP = 1 << 16  # rows of a trace in pieces that are written together
WRITING: dict[str, Any] = {"write_page_checksum": True, "use_dictionary": False}  # samples seldom repeat


def read(path: Path, layout: Layout) -> Recording:
    """The wanted columns; the others may hold anything.

    Raises:
        TraceError: not a Parquet file, damaged, a column that is not there or holds no numbers.
    """
    try:
        with parquet.ParquetFile(path, page_checksum_verification=True) as file:
            return _recording(file, layout, path)
    except (pa.ArrowException, OSError, ValueError, KeyError) as problem:
        if isinstance(problem, TraceError):
            raise
        raise TraceError(
            path, f"is not a readable Parquet file ({excerpt(problem)})", "record or export it again"
        ) from None


def write(trace: Trace, file: BinaryIO) -> None:
    """The trace, bit for bit."""
    parquet.write_table(_arrow(trace), file, **WRITING)


@contextmanager
def appending(path: Path) -> Iterator[Callable[[Trace], None]]:
    """A function that appends the rows of a trace to the file; the file can be read when the context is left."""
    kept: list[pa.Table] = []
    writer: parquet.ParquetWriter | None = None

    def flush() -> None:
        nonlocal writer
        if kept:
            writer = writer or parquet.ParquetWriter(path, kept[0].schema, **WRITING)
            writer.write_table(pa.concat_tables(kept).combine_chunks())
            kept.clear()

    def append(piece: Trace) -> None:
        kept.append(_arrow(piece))
        if sum(map(len, kept)) >= GROUP:
            flush()

    try:
        yield append
    finally:
        with whole():
            flush()
            if writer is not None:
                writer.close()


def _arrow(trace: Trace) -> pa.Table:
    fields = [pa.field("time", pa.float64(), metadata={"unit": "s"})]
    for name in trace.names:
        unit = trace.unit(name)
        fields.append(pa.field(name, pa.float64(), metadata={"unit": unit} if unit else None))
    return pa.table(arrays(trace), schema=pa.schema(fields, metadata={"name": trace.name}))


def _recording(file: parquet.ParquetFile, layout: Layout, path: Path) -> Recording:
    schema = file.schema_arrow
    units = tuple(_text(field.metadata, b"unit") for field in schema)
    choice = choose(layout, Columns(len(schema), tuple(schema.names), units), path)
    for number in choice.wanted:
        _check_numeric(schema.field(number), path)
    if file.metadata.num_rows * len(choice.wanted) > MAX_VALUES:
        raise TraceError(path, f"claims {file.metadata.num_rows} samples", "cut the recording")
    rows = file.read(columns=[schema.names[number] for number in choice.wanted])

    def column(number: int) -> FloatArray:
        return numbers(rows[schema.names[number]])

    return choice.recording(column, _text(schema.metadata, b"name"))


def _check_numeric(field: pa.Field, path: Path) -> None:
    if not (pa.types.is_floating(field.type) or pa.types.is_integer(field.type)):
        raise TraceError(f"{path}: column '{field.name}'", f"holds {field.type}, not numbers", "choose another column")


def _text(metadata: dict[bytes, bytes] | None, key: bytes) -> str:
    return (metadata or {}).get(key, b"").decode(errors="replace")
