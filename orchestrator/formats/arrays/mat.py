"""MATLAB files: one numeric matrix with a row a sample, a vector a channel, or a structure of channels.

Files of our own hold a matrix and the cell arrays `names` and `units` with an entry a column; a foreign matrix gets
its names from the layout.
"""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from fmus.errors import TraceError
from fmus.words import excerpt
from orchestrator.formats.arrays import mat5, tree
from orchestrator.formats.layout import Layout
from orchestrator.formats.recording import Recording
from orchestrator.trace import Trace

DAMAGED = "record or export it again as MATLAB v5 (save -v6 or -v7)"
HEADER = b"MATLAB 5.0 MAT-file, servotwin trace"


def read(path: Path, layout: Layout) -> Recording:
    """The wanted columns of the wanted matrix, or the channels; no other variable is read.

    Raises:
        TraceError: not a v5 or v7.3 file, damaged, the variable or a column missing, or nothing numeric.
    """
    with path.open("rb") as file:
        start = file.read(10)
        if start.startswith((b"MATLAB 7.3", b"\x89HDF\r\n\x1a\n")):
            from orchestrator.formats.arrays import hdf5  # noqa: PLC0415 (of an extra)

            return hdf5.read(path, layout)
        if start != b"MATLAB 5.0":
            raise TraceError(path, "is not a MATLAB v5 or v7.3 file", "save it in MATLAB with save(..., '-v7')")
        try:
            held = {variable.name: mat5.node(file, variable) for variable in mat5.variables(file)}
            return tree.read(path, layout, held)
        except TraceError:
            raise
        except (ValueError, struct.error, zlib.error) as problem:
            raise TraceError(path, f"is damaged ({excerpt(problem)})", DAMAGED) from None


def write(trace: Trace, file: BinaryIO) -> None:
    """The trace as matrix `D` (K, 1 + signals), time first, with `names` and `units`, bit for bit."""
    from scipy.io import savemat  # noqa: PLC0415 (half of the time that reading any recording would take)

    content = {
        "D": np.column_stack([trace.time, *trace.signals.values()]),
        "names": _cell(["time", *trace.names]),
        "units": _cell(["s", *(trace.unit(name) or "" for name in trace.names)]),
    }
    whole = io.BytesIO()
    savemat(whole, content, oned_as="column")
    # scipy puts the date into the 116 bytes of free text; the same trace shall give the same file
    file.write(HEADER.ljust(116) + whole.getvalue()[116:])


def _cell(texts: list[str]) -> np.ndarray[Any, Any]:
    cell = np.empty((1, len(texts)), dtype=object)
    cell[0] = texts
    return cell
