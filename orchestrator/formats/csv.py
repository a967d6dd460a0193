"""Comma-separated text: one header line of `name [unit]`, then a row a sample. Others' are read as they look.

An empty cell is a missing sample (NaN), also of a text.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import pyarrow as pa
from pyarrow import compute as pc
from pyarrow import csv as arrow

from fmus.errors import TraceError
from orchestrator.formats import headings
from orchestrator.formats.arrow import arrays, is_text
from orchestrator.formats.texts.reading import read
from orchestrator.trace import Trace

__all__ = ["appending", "read", "write"]


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
    broken = next((name for name, known in trace.texts.items() for text in known if len(text.splitlines()) > 1), None)
    if broken is not None:
        raise TraceError(broken, "has a text with a line break", "write .parquet")
    columns = [c if is_text(c.type) else pc.if_else(pc.is_nan(c), pa.nulls(len(c), c.type), c) for c in arrays(trace)]
    table = pa.table(columns, names=headings.headings(trace))
    arrow.write_csv(table, file, arrow.WriteOptions(include_header=False))


def _quoted(heading: str) -> str:
    return '"' + heading.replace('"', '""') + '"' if set(heading) & set(',"') else heading
