"""MATLAB v5 files: one numeric matrix with a row a sample.

Files of our own also hold the cell arrays `names` and `units` with an entry a column; a foreign matrix gets
its names from the layout.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import numpy as np

from fmus.errors import TraceError
from orchestrator.formats import mat5
from orchestrator.formats.layout import MAX_VALUES, Columns, Layout, choose
from orchestrator.formats.mat5 import MatVariable
from orchestrator.formats.recording import Recording, excerpt
from orchestrator.trace import Trace

NUMERIC = frozenset({"double", "single", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))})
ONE_MATRIX = "save one real matrix with a row a sample"
DAMAGED = "record or export it again as MATLAB v5 (save -v6 or -v7)"
HEADER = b"MATLAB 5.0 MAT-file, servotwin trace"

T = TypeVar("T")


def read(path: Path, layout: Layout) -> Recording:
    """The wanted columns of the wanted matrix; no other variable is read.

    Raises:
        TraceError: not a v5 file, damaged, the variable or a column missing, or not a real matrix.
    """
    _check_version(path)
    contents = {variable.name: variable for variable in _careful(path, mat5.variables)}
    wanted = _wanted(contents, layout.variable, path)
    rows, count = wanted.shape
    names, units = (_labels(path, contents.get(key), count) for key in ("names", "units"))
    if names is None and rows < count:
        raise TraceError(f"{path}: {wanted.name}", f"is {rows} x {count}, fewer samples than columns", "transpose it")
    matrix = _careful(path, lambda file: mat5.matrix(file, wanted))
    columns = Columns(count, names, units or (), head=lambda number: matrix[:, number])
    choice = choose(replace(layout, variable=wanted.name), columns, path)
    return choice.recording(lambda number: matrix[:, number])


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


def _check_version(path: Path) -> None:
    with path.open("rb") as file:
        start = file.read(10)
    if start.startswith((b"MATLAB 7.3", b"\x89HDF\r\n\x1a\n")):
        raise TraceError(path, "is MATLAB v7.3 (HDF5), which is not read", "save it in MATLAB with save(..., '-v7')")
    if start != b"MATLAB 5.0":
        raise TraceError(path, "is not a MATLAB v5 file", "save it in MATLAB with save(..., '-v7')")


def _wanted(contents: dict[str, MatVariable], name: str | None, path: Path) -> MatVariable:
    held = ", ".join(f"{name} ({variable.kind})" for name, variable in list(contents.items())[:20]) or "nothing"
    matrices = [variable for variable in contents.values() if _is_matrix(variable)]
    if name is None:
        if len(matrices) != 1:
            number, fix = len(matrices) or "no", "name one as `variable` in the layout"
            raise TraceError(path, f"holds {number} numeric matrices ({held})", fix if matrices else ONE_MATRIX)
        name = matrices[0].name
    if name not in contents:
        raise TraceError(path, f"has no variable '{name}'", f"it holds {held}")
    variable = contents[name]
    size = " x ".join(map(str, variable.shape))
    if not _is_matrix(variable):
        raise TraceError(f"{path}: {name}", f"is {size} {variable.kind}, not a numeric matrix", ONE_MATRIX)
    if not 0 < variable.count <= MAX_VALUES:
        raise TraceError(f"{path}: {name}", f"claims {size} values", ONE_MATRIX)
    return variable


def _is_matrix(variable: MatVariable) -> bool:
    return variable.kind in NUMERIC and len(variable.shape) == 2


def _labels(path: Path, variable: MatVariable | None, count: int) -> tuple[str, ...] | None:
    if variable is None or variable.kind != "cell" or variable.count != count:
        return None
    texts = _careful(path, lambda file: mat5.texts(file, variable))
    return tuple(texts) if texts is not None and len(texts) == count else None


def _careful(path: Path, read: Callable[[BinaryIO], T]) -> T:
    try:
        with path.open("rb") as file:
            return read(file)
    except (ValueError, struct.error, zlib.error) as problem:
        raise TraceError(path, f"is damaged ({excerpt(problem)})", DAMAGED) from None


def _cell(texts: list[str]) -> np.ndarray[Any, Any]:
    cell = np.empty((1, len(texts)), dtype=object)
    cell[0] = texts
    return cell
