"""Apache Parquet: a float64 column a signal, or one of text, its unit in the field's metadata, the name in the
schema's."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from fmus.errors import InputError, TraceError
from fmus.words import excerpt
from orchestrator.formats.arrow import arrays, is_text, numbers, texts
from orchestrator.formats.layout import MAX_VALUES, FileColumns, Layout, choose
from orchestrator.formats.recording import Recording
from orchestrator.formats.stamps import Stamps, since_first
from orchestrator.processes.interrupts import whole
from orchestrator.processes.memory import require
from orchestrator.trace import FloatArray, Trace

COPIES = 4  # of the samples that are in memory while they are read
GROUP = 1 << 16  # rows of a trace in pieces that are written together
WRITING: dict[str, Any] = {"write_page_checksum": True, "use_dictionary": False}  # samples seldom repeat
SMALL: dict[str, Any] = WRITING | {"compression": "zstd", "compression_level": 19, "use_byte_stream_split": True}


def read(path: Path, layout: Layout) -> Recording:
    """The wanted columns; the others may hold anything.

    Raises:
        TraceError: not a Parquet file, damaged, a column that is not there or holds no numbers.
    """
    try:
        with parquet.ParquetFile(path, page_checksum_verification=True) as file:
            return _recording(file, layout, path)
    except (pa.ArrowException, OSError, ValueError, KeyError) as problem:
        if isinstance(problem, InputError):
            raise
        raise TraceError(
            path, f"is not a readable Parquet file ({excerpt(problem)})", "record or export it again"
        ) from None


def write(trace: Trace, file: BinaryIO) -> None:
    """The trace, bit for bit."""
    parquet.write_table(table(trace), file, **WRITING)


def write_small(trace: Trace, file: BinaryIO, facts: Mapping[str, str]) -> None:
    """The trace, bit for bit, in few bytes, and facts about it that the file keeps under their names."""
    columns = table(trace)
    metadata = {**(columns.schema.metadata or {}), **{name.encode(): text.encode() for name, text in facts.items()}}
    parquet.write_table(columns.replace_schema_metadata(metadata), file, **SMALL)


def facts(path: Path) -> dict[str, str]:
    """What a file keeps about its columns, by name.

    Raises:
        TraceError: not a Parquet file.
    """
    try:
        metadata = parquet.read_schema(path).metadata
    except (pa.ArrowException, OSError) as problem:
        raise TraceError(path, f"is not a readable Parquet file ({excerpt(problem)})", "write it again") from None
    return {name.decode(errors="replace"): _text(metadata, name) for name in metadata or {}}


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
        kept.append(table(piece))
        if sum(map(len, kept)) >= GROUP:
            flush()

    try:
        yield append
    finally:
        with whole():
            flush()
            if writer is not None:
                writer.close()


def table(trace: Trace) -> pa.Table:
    """The trace as columns, the stamps first."""
    fields = [pa.field("time", pa.float64(), metadata={"unit": "s"})]
    for name in trace.names:
        unit = trace.unit(name)
        told = {"unit": unit} if unit else {}
        told |= {"holds": "text"} if name in trace.texts else {}
        kind = pa.string() if name in trace.texts else pa.float64()
        fields.append(pa.field(name, kind, metadata=told or None))
    return pa.table(arrays(trace), schema=pa.schema(fields, metadata={"name": trace.name}))


def _recording(file: parquet.ParquetFile, layout: Layout, path: Path) -> Recording:
    schema = file.schema_arrow
    units = tuple(_text(field.metadata, b"unit") for field in schema)
    odd = {number: str(field.type) for number, field in enumerate(schema) if not _is_numeric(field.type)}
    worded = {n: _text(f.metadata, b"holds") == "text" for n, f in enumerate(schema) if is_text(f.type)}
    stamped = [n for n, f in enumerate(schema) if pa.types.is_timestamp(f.type) or pa.types.is_duration(f.type)]
    useless = {number: what for number, what in odd.items() if number not in stamped}
    columns = FileColumns(len(schema), tuple(schema.names), units, useless, stamped, _head(file), worded)
    choice = choose(layout, columns, path)
    if file.metadata.num_rows * len(choice.wanted) > MAX_VALUES:
        raise TraceError(path, f"claims {file.metadata.num_rows:,} samples", "cut the recording")
    size = COPIES * 8 * file.metadata.num_rows * len(choice.wanted)
    require(path, f"{file.metadata.num_rows:,} samples", size, "cut the recording, or read fewer `columns`")
    rows = file.read(columns=[schema.names[number] for number in choice.wanted])

    def column(number: int) -> FloatArray:
        return numbers(_column(rows, schema.names, number))

    def words(number: int) -> tuple[FloatArray, tuple[str, ...]]:
        return texts(_column(rows, schema.names, number))

    stamps = _stamps(_column(rows, schema.names, choice.time), layout, path) if choice.time in stamped else None
    return choice.recording(column, _text(schema.metadata, b"name"), stamps, words=words)


def _column(rows: pa.Table, names: Sequence[str], number: int) -> pa.ChunkedArray:
    """A column by its number in the file, whose `names` may be there several times."""
    same = rows.schema.get_all_field_indices(names[number])
    return rows.column(same[names[:number].count(names[number])])


def _is_numeric(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_boolean(kind))


def _head(file: parquet.ParquetFile) -> Callable[[int], FloatArray]:
    """The first samples of a column by its number."""

    def head(number: int) -> FloatArray:
        names = file.schema_arrow.names
        batch = next(file.iter_batches(1000, columns=[names[number]]), None)
        return np.empty(0) if batch is None else numbers(_column(pa.table(batch), names, number))

    return head


def _stamps(column: pa.ChunkedArray, layout: Layout, path: Path) -> Stamps:
    if column.null_count:
        raise TraceError(path, f"{column.null_count} time stamps are missing", "drop those rows")
    if pa.types.is_duration(column.type):
        return Stamps(column.cast(pa.duration("ns")).cast(pa.int64()).to_numpy() / 1e9)
    instants = column.cast(pa.timestamp("ns", column.type.tz)).cast(pa.int64()).to_numpy()
    return since_first(instants, "UTC" if column.type.tz else layout.time_zone, path)


def _text(metadata: dict[bytes, bytes] | None, key: bytes) -> str:
    return (metadata or {}).get(key, b"").decode(errors="replace")
