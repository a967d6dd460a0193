"""Arrow streams: rows that can be read up to the last that was written, whatever became of who wrote them."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
from pyarrow import parquet as pq

from fmus.errors import TraceError
from fmus.files import sha256
from fmus.words import excerpt
from orchestrator.formats import parquet
from orchestrator.formats.layout import Layout
from orchestrator.formats.recording import Recording
from orchestrator.trace import Trace

SUFFIX = ".arrows"


@contextmanager
def appending(path: Path) -> Iterator[Callable[[Trace], None]]:
    """A function that appends the rows of a trace to the file at once."""
    writer: pa.ipc.RecordBatchStreamWriter | None = None
    with pa.OSFile(str(path), "wb") as file:

        def append(piece: Trace) -> None:
            nonlocal writer
            table = parquet.table(piece)
            writer = writer or pa.ipc.new_stream(file, table.schema)
            writer.write_table(table)

        yield append


def read(path: Path, layout: Layout) -> Recording:
    """The wanted columns of all rows that are whole.

    Raises:
        TraceError: it is no such file, holds no rows, or lacks a column.
    """
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder, "copy.parquet")
        try:
            whole = settle(path, copy)
            recording = parquet.read(copy, layout)
        except TraceError as error:
            raise TraceError(path, error.problem, error.fix) from None
    notes = recording.notes if whole else (*recording.notes, "breaks off within a piece, which is left out")
    return replace(recording, path=path, sha256=sha256(path), notes=notes)


def settle(path: Path, target: Path) -> bool:
    """Write what is whole as a Parquet file, in bounded memory; whether that is all.

    Raises:
        TraceError: it is no such file, or holds no rows.
        OSError: the disk takes no more.
    """
    ends, kept, rows = list[Exception](), list[pa.RecordBatch](), 0
    try:
        with (
            pa.OSFile(str(path)) as file,
            pa.ipc.open_stream(file) as stream,
            pq.ParquetWriter(target, stream.schema, **parquet.WRITING) as writer,
        ):
            while (batch := _next(stream, ends)) is not None or kept:
                kept += [] if batch is None else [batch]
                rows += 0 if batch is None else len(batch)
                if batch is None or sum(map(len, kept)) >= parquet.GROUP:
                    writer.write_table(pa.Table.from_batches(kept).combine_chunks())
                    kept.clear()
    except pa.ArrowInvalid as problem:
        raise TraceError(path, f"is not a readable Arrow stream ({excerpt(problem)})", "record it again") from None
    if not rows:
        raise TraceError(path, "holds no rows", "record it again")
    return isinstance(ends[0], StopIteration)


def _next(stream: pa.ipc.RecordBatchStreamReader, ends: list[Exception]) -> pa.RecordBatch | None:
    """The next piece of the file; None at its end, or where it breaks off, which is added to the ends."""
    try:
        return None if ends else stream.read_next_batch()
    except (StopIteration, pa.ArrowInvalid, OSError) as end:
        ends.append(end)
        return None
