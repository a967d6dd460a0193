"""Column headings of text files: `name [unit]`, written and read back."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from fmus.errors import TraceError
from orchestrator.formats.layout import ColumnNames
from orchestrator.trace import Trace

MAX_HEADER = 2**16  # bytes


def split(heading: str) -> tuple[str, str]:
    """Name and unit ("" when there is none) of a heading."""
    text = heading.strip()
    start = text.rfind("[")
    if start > 0 and text.endswith("]"):
        return text[:start].rstrip(), text[start + 1 : -1].strip()
    return text, ""


def joined(name: str, unit: str) -> str:
    """The heading of a column; `split` gives name and unit back.

    Raises:
        TraceError: they would not come back, or would not fit on one line.
    """
    heading = f"{name} [{unit}]" if unit or name.endswith("]") else name
    if split(heading) != (name, unit) or not name or heading.splitlines() != [heading]:
        raise TraceError(
            repr(name), f"with unit '{unit}' cannot be a column heading", "rename the signal or write .parquet"
        )
    return heading


def headings(trace: Trace) -> list[str]:
    """One heading a column of the written file, time first."""
    return ["time [s]", *(joined(name, trace.unit(name) or "") for name in trace.names)]


def columns(cells: list[str]) -> ColumnNames:
    """The columns that these headings announce."""
    names, units = zip(*map(split, cells), strict=True)
    return ColumnNames(len(cells), names, units)


def line(file: BinaryIO, path: Path) -> str:
    """The next line of a text file, "" at its end.

    Raises:
        TraceError: it is too long for a header line, or no UTF-8 text.
    """
    raw = file.readline(MAX_HEADER + 1)
    if len(raw) > MAX_HEADER:
        raise TraceError(path, f"a header line is longer than {MAX_HEADER} bytes", "check that it is a table of text")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise TraceError(
            path, f"is not UTF-8 text (byte {problem.start} of a header line)", "save it as UTF-8"
        ) from None


def is_number(cell: str) -> bool:
    """Whether a cell holds a sample rather than a heading."""
    try:
        float(cell)
    except ValueError:
        return False
    return True
