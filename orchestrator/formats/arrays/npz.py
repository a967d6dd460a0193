"""NumPy's .npz and .npy: a matrix with a row a sample, a vector a channel, or records. Pickles are never loaded."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from fmus.errors import TraceError
from fmus.words import excerpt
from orchestrator.formats.arrays import tree
from orchestrator.formats.arrays.tree import Node, NumberArray, Other, Structure
from orchestrator.formats.layout import Layout
from orchestrator.formats.recording import Recording


def read(path: Path, layout: Layout) -> Recording:
    """The wanted channels.

    Raises:
        TraceError: damaged, or it holds no numbers.
    """
    try:
        if not zipfile.is_zipfile(path):
            with path.open("rb") as file:
                return tree.read(path, layout, {path.stem: _node(path, None, file, path.stat().st_size)})
        with zipfile.ZipFile(path) as archive:
            held: dict[str, Node] = {}
            for entry in archive.infolist():
                if entry.filename.endswith(".npy"):
                    with archive.open(entry) as member:
                        held[entry.filename[:-4]] = _node(path, entry.filename, member, entry.file_size)  # type: ignore[arg-type]
            return tree.read(path, layout, held)
    except TraceError:
        raise
    except Exception as problem:  # whatever a library makes of damage
        raise TraceError(path, f"is damaged ({excerpt(problem)})", "save it again with numpy.savez") from None


def _node(path: Path, member: str | None, file: BinaryIO, size: int) -> Node:
    """What an array holds, by its header; its samples are read when they are asked for."""
    version = np.lib.format.read_magic(file)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, kind = header(file)
    if kind.hasobject:
        return Other(shape, "pickled objects")
    if math.prod(shape) * kind.itemsize > size:
        raise ValueError(f"an array claims {math.prod(shape)} values")
    if kind.names and len(shape) == 1:
        return Structure([{name: _numbers(path, member, shape, kind[name], name) for name in kind.names}])
    return _numbers(path, member, shape, kind)


def _numbers(path: Path, member: str | None, shape: tuple[int, ...], kind: np.dtype[Any], field: str = "") -> Node:
    def read() -> Any:
        loaded = np.load(path, allow_pickle=False)
        values = loaded if member is None else loaded[member]
        return values[field] if field else values

    if kind.kind == "M":
        return NumberArray(shape, read, str(kind), stamped=True)
    if kind.kind == "m" and np.datetime_data(kind)[0] not in ("generic", "Y", "M"):
        return NumberArray(shape, lambda: read() / np.timedelta64(1, "s"), str(kind), "s")
    return (
        NumberArray(shape, lambda: read().astype(float), str(kind)) if kind.kind in "biuf" else Other(shape, str(kind))
    )
