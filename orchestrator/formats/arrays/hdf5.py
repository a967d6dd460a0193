"""HDF5, for which the extra `formats` installs h5py: MATLAB v7.3 files, and others with a data set a channel.

Nothing outside of the file is opened: links to other files, external and virtual storage are left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fmus.errors import TraceError
from fmus.words import excerpt
from orchestrator.formats.arrays import tree
from orchestrator.formats.arrays.tree import DEEPEST, Node, NumberArray, Other, Structure
from orchestrator.formats.layout import MAX_VALUES, Layout
from orchestrator.formats.recording import Recording
from orchestrator.trace import FloatArray

if TYPE_CHECKING:
    import h5py

TEXT = 10_000  # letters
MOST = 100_000  # nodes


def read(path: Path, layout: Layout) -> Recording:
    """The wanted channels.

    Raises:
        TraceError: h5py is not there, or the file is damaged or holds no channels.
    """
    try:
        import h5py  # noqa: PLC0415 (of an extra)
    except ImportError:
        raise TraceError(path, "is HDF5 (MATLAB v7.3), which needs h5py", "pip install servotwin[formats]") from None
    try:
        with h5py.File(path, "r") as file:
            walk = _Walk()
            return tree.read(path, layout, {key: walk.node(file, key, 0) for key in file if not key.startswith("#")})
    except TraceError:
        raise
    except Exception as problem:  # whatever a library makes of damage
        raise TraceError(path, f"is damaged ({excerpt(problem)})", "record or export it again") from None


class _Walk:
    """Nodes of a file, as many as anybody needs."""

    def __init__(self) -> None:
        self.count = 0

    def node(self, group: h5py.Group, key: str, depth: int) -> Node:
        """What lies in the file under a key of a group."""
        import h5py  # noqa: PLC0415 (see above)

        if not isinstance(group.get(key, getlink=True), h5py.HardLink):
            return Other((), "link")
        return self._object(group[key], depth)

    def _object(self, held: h5py.Group | h5py.Dataset, depth: int) -> Node:
        import h5py  # noqa: PLC0415 (see above)

        self.count += 1
        if depth > DEEPEST or self.count > MOST:
            raise ValueError("it holds too many things inside each other")
        if isinstance(held, h5py.Dataset):
            return self._dataset(held, depth)
        if not isinstance(held, h5py.Group):
            return Other((), "type")
        return _elements({key: self.node(held, key, depth + 1) for key in held})

    def _dataset(self, held: h5py.Dataset, depth: int) -> Node:
        import h5py  # noqa: PLC0415 (see above)

        shape = tuple(map(int, held.shape or ()))
        kind = _text(held.attrs.get("MATLAB_class", b""))
        if held.external or held.is_virtual:
            return Other(shape, "external")
        if h5py.check_ref_dtype(held.dtype) is h5py.Reference:
            if math.prod(shape) > MOST:
                raise ValueError("it holds too many references")
            return [self._object(held.file[one], depth + 1) for one in held[()].ravel() if one]
        if kind == "char" or h5py.check_string_dtype(held.dtype):
            return _letters(held) if math.prod(shape) <= TEXT else Other(shape, "char")
        if held.dtype.names and len(shape) == 1:
            fields = {name: _numbers(held, shape, name) for name in held.dtype.names if held.dtype[name].kind in "biuf"}
            return Structure([fields])
        return _numbers(held, shape[::-1] if kind else shape) if held.dtype.kind in "biuf" else Other(shape, "data")


def _numbers(held: h5py.Dataset, shape: tuple[int, ...], field: str | None = None) -> NumberArray:
    """Numbers; MATLAB's, whose order of dimensions is the other way round, in MATLAB's shape."""

    def read() -> FloatArray:
        if math.prod(shape) > MAX_VALUES:
            raise ValueError(f"it claims {math.prod(shape)} numbers")
        whole = np.asarray(held[()][field], dtype=float) if field else _unpacked(np.asarray(held[()]), held.attrs)
        return whole.T if whole.shape != shape or held.attrs.get("MATLAB_class") is not None else whole

    unit = next((_text(held.attrs[key]) for key in ("unit", "units") if key in held.attrs), "")
    return NumberArray(shape, read, str(held.dtype), unit)


def _unpacked(stored: NDArray[Any], told: Mapping[str, Any]) -> FloatArray:
    """What stored numbers stand for by the conventions of netCDF: scaled, and NaN where there is no value."""
    values = stored.astype(float)
    for key in ("_FillValue", "missing_value"):
        values[np.isin(stored, told.get(key, ()))] = np.nan
    for key, changed in (("scale_factor", np.multiply), ("add_offset", np.add)):
        if key in told:
            values = changed(values, np.ravel(told[key])[0])
    return values


def _elements(fields: dict[str, Node]) -> Structure:
    """A structure; one whose fields are all lists of one length is an array of them."""
    lists = [node for node in fields.values() if isinstance(node, list)]
    lengths = {len(node) for node in lists}
    if not lists or len(lists) != len(fields) or len(lengths) != 1:
        return Structure([fields])
    return Structure([dict(zip(fields, values, strict=True)) for values in zip(*lists, strict=True)])


def _letters(held: h5py.Dataset) -> str:
    content = held[()]
    if isinstance(content, np.ndarray) and content.dtype.kind in "ui":
        return "".join(map(chr, content.ravel(order="F").tolist()))
    return _text(content)


def _text(value: object) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else value if isinstance(value, str) else ""
