"""ColumnNames of numbers separated by blanks or tabs, under optional header lines that start with `#`.

The last header line names the columns when it has as many names as there are columns.
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import BinaryIO

import numpy as np

from fmus.errors import TraceError
from orchestrator.formats import headings
from orchestrator.formats.layout import ColumnNames, Layout, choose
from orchestrator.formats.recording import Recording, excerpt
from orchestrator.trace import Trace


def read(path: Path, layout: Layout) -> Recording:
    """The wanted columns.

    Raises:
        TraceError: no numbers, a column that is not there, text in a number, a row of another length.
    """
    choice = choose(layout, _columns(path), path)
    try:
        with path.open(encoding="utf-8-sig") as file:
            data = np.loadtxt(file, ndmin=2)
    except UnicodeDecodeError:
        raise TraceError(path, "is not UTF-8 text", "save it as UTF-8") from None
    except ValueError as problem:
        raise TraceError(path, excerpt(problem).partition(";")[0], "correct or cut that row") from None
    return choice.recording(lambda number: data[:, number])


def write(trace: Trace, file: BinaryIO) -> None:
    """The trace as tab-separated text; every number keeps all its bits."""
    heads = headings.headings(trace)
    if any("\t" in heading for heading in heads):
        raise TraceError(trace.name, "a signal's name or unit has a tab in it", "rename it or write .parquet")
    file.write(("# " + "\t".join(heads) + "\n").encode())
    text = io.TextIOWrapper(file, "utf-8", write_through=True)
    for row in np.column_stack([trace.time, *trace.signals.values()]).tolist():
        text.write("\t".join(map(repr, row)) + "\n")
    text.detach()


def _columns(path: Path) -> ColumnNames:
    heading = ""
    with path.open("rb") as file:
        while text := headings.line(file, path):
            if text.startswith("#"):
                heading = text
            elif text.strip():
                return _named(heading.strip().lstrip("#").strip(), len(text.partition("#")[0].split()))
    raise TraceError(path, "holds no numbers", "check that it is a table of text")


def _named(heading: str, count: int) -> ColumnNames:
    for cells in (heading.split("\t"), re.split(r"\s+(?!\[)", heading)):
        if heading and len(cells) == count:
            return headings.columns(cells)
    return ColumnNames(count)
