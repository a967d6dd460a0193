"""Comma-separated text: one header line of `name [unit]`, then a row a sample.

An empty cell is a missing sample (NaN).
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import pyarrow as pa
from pyarrow import csv as arrow

from fmus.errors import TraceError
from orchestrator.formats import headings
from orchestrator.formats.arrow import arrays, numbers
from orchestrator.formats.layout import ColumnNames, Layout, choose
from orchestrator.formats.recording import Recording, excerpt
from orchestrator.trace import Trace


def read(path: Path, layout: Layout) -> Recording:
    """The wanted columns; the others may hold anything.

    Raises:
        TraceError: no readable header, a column that is not there, text in a number, a row of another length.
    """
    columns = _columns(path)
    choice = choose(layout, columns, path)
    names = [str(number) for number in range(columns.count)]
    wanted = [names[number] for number in choice.wanted]
    try:
        with path.open("rb") as file:
            rows = arrow.read_csv(
                file,
                read_options=arrow.ReadOptions(
                    column_names=names, skip_rows=int(columns.names is not None), use_threads=False
                ),
                convert_options=arrow.ConvertOptions(
                    include_columns=wanted, column_types={name: pa.float64() for name in wanted}
                ),
            )
    except (pa.ArrowInvalid, pa.ArrowKeyError) as problem:
        raise TraceError(path, excerpt(problem), "correct or cut that row") from None
    return choice.recording(lambda number: numbers(rows[names[number]]))


def write(trace: Trace, file: BinaryIO) -> None:
    """The trace as text; every number keeps all its bits."""
    text = ",".join(_quoted(heading) for heading in headings.headings(trace))
    file.write(text.encode() + b"\n")
    _write_rows(trace, file)


@contextmanager
def appending(path: Path) -> Iterator[Callable[[Trace], None]]:
    """A function that appends the rows of a trace to the file."""
    with path.open("wb") as file:

        def append(piece: Trace) -> None:
            (_write_rows if file.tell() else write)(piece, file)

        yield append


def _write_rows(trace: Trace, file: BinaryIO) -> None:
    table = pa.table(arrays(trace), names=headings.headings(trace))
    arrow.write_csv(table, file, arrow.WriteOptions(include_header=False))


def _columns(path: Path) -> ColumnNames:
    with path.open("rb") as file:
        text = headings.line(file, path)
    try:
        cells = next(csv.reader([text], strict=True), [])
    except csv.Error as problem:
        raise TraceError(path, f"header line: {excerpt(problem)}", "check that it is comma-separated text") from None
    if not cells:
        raise TraceError(path, "begins with an empty line", "put the header first")
    if all(map(headings.is_number, cells)):
        return ColumnNames(len(cells))
    return headings.columns(cells)


def _quoted(heading: str) -> str:
    return '"' + heading.replace('"', '""') + '"' if set(heading) & set(',"') else heading
