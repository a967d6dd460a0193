"""Columns of numbers separated by tabs, under a header line that starts with `#`. Others' are read as they look."""

from __future__ import annotations

import io
from typing import BinaryIO

import numpy as np

from fmus.errors import TraceError
from orchestrator.formats import headings
from orchestrator.formats.texts.reading import read
from orchestrator.trace import Trace

__all__ = ["read", "write"]


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
