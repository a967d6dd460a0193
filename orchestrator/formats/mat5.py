"""The MATLAB v5 container: which variables a file holds, and one of them as numbers or as texts.

SciPy's reader crashes the whole process on some damaged files, so this one looks at every length before it uses it.
Layout: "MAT-File Format", The MathWorks, chapter 1. Damage is a ValueError, struct.error or zlib.error.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import BinaryIO

import numpy as np

from orchestrator.trace import FloatArray

MATRIX, COMPRESSED = 14, 15
NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16"}
CLASSES = (
    "unknown",
    "cell",
    "struct",
    "object",
    "char",
    "sparse",
    "double",
    "single",
    "int8",
    "uint8",
    "int16",
    "uint16",
    "int32",
    "uint32",
    "int64",
    "uint64",
    "function",
    "opaque",
)
COMPLEX, LOGICAL = 0x0800, 0x0200
HEAD = 4096  # bytes that hold flags, dimensions and name of any variable
SLACK = 2**20  # bytes that a variable may need beyond its numbers


@dataclass(frozen=True)
class MatVariable:
    """One variable of a file and where it lies; `kind` is its MATLAB class, marked when complex or logical."""

    name: str
    shape: tuple[int, ...]
    kind: str
    start: int
    size: int
    compressed: bool
    order: str

    @property
    def count(self) -> int:
        """Number of elements."""
        return math.prod(self.shape)


def variables(file: BinaryIO) -> list[MatVariable]:
    """Every named variable, in the file's order; only the head of each is read."""
    file.seek(124)
    order = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}.get(file.read(4), "")
    if not order:
        raise ValueError("its version or byte order is unknown")
    end = file.seek(0, 2)
    start, found = 128, []
    while start < end:
        file.seek(start)
        kind, size = struct.unpack(order + "II", file.read(8))
        start += 8 + size
        if start > end:
            raise ValueError("it ends inside a variable")
        found.append(_variable(file, kind, size, order))
    return [variable for variable in found if variable.name]


def matrix(file: BinaryIO, variable: MatVariable) -> FloatArray:
    """The numbers of a real numeric variable, in its shape."""
    real = next(islice(_elements(_payload(file, variable), variable.order), 3, None), None)
    if real is None or real[0] not in NUMBERS:
        raise ValueError(f"'{variable.name}' holds no numbers")
    numbers = np.frombuffer(real[1], variable.order + NUMBERS[real[0]])
    if len(numbers) != variable.count:
        raise ValueError(f"'{variable.name}' holds {len(numbers)} numbers instead of {variable.count}")
    return numbers.reshape(variable.shape, order="F").astype(float)


def texts(file: BinaryIO, variable: MatVariable) -> list[str] | None:
    """The texts in a cell array, None when something else is in it, too."""
    parts = islice(_elements(_payload(file, variable), variable.order), 3, None)
    found = [_text(data, variable.order) if kind == MATRIX else None for kind, data in parts]
    return None if None in found else [text for text in found if text is not None]


def _variable(file: BinaryIO, kind: int, size: int, order: str) -> MatVariable:
    place = file.tell()
    head = file.read(min(size, HEAD))
    if kind == COMPRESSED:
        head = zlib.decompressobj().decompress(head, HEAD)
        kind = struct.unpack_from(order + "I", head)[0]
        name, shape, class_ = _described(head[8:], order) if kind == MATRIX else ("", (), "")
        return MatVariable(name, shape, class_, place, size, True, order)
    name, shape, class_ = _described(head, order) if kind == MATRIX else ("", (), "")
    return MatVariable(name, shape, class_, place, size, False, order)


def _described(data: bytes | memoryview, order: str) -> tuple[str, tuple[int, ...], str]:
    """Name, shape and class from the head of a matrix element; no name where there is no matrix."""
    head = list(islice(_elements(data, order), 3))
    if len(head) < 3 or len(head[0][1]) < 4:
        raise ValueError("the head of a variable is incomplete")
    flags = struct.unpack_from(order + "I", head[0][1])[0]
    number = flags & 0xFF
    class_ = CLASSES[number] if number < len(CLASSES) else CLASSES[0]
    if class_ == "opaque":
        return bytes(head[1][1]).decode("latin-1"), (), class_
    shape = tuple(np.frombuffer(head[1][1], order + "i4").tolist())
    if any(length < 0 for length in shape):
        raise ValueError("a variable has a negative dimension")
    mark = "complex " if flags & COMPLEX else ""
    return bytes(head[2][1]).decode("latin-1"), shape, "logical" if flags & LOGICAL else mark + class_


def _elements(data: bytes | memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Type and content of the elements that lie one after the other in `data`."""
    view, place = memoryview(data), 0
    while place < len(view):
        kind, size = struct.unpack_from(order + "II", view, place)
        start = place + 8
        if kind >> 16:  # the small format: at most four bytes, kept in the tag itself
            kind, size, start = kind & 0xFFFF, min(kind >> 16, 4), place + 4
        if start + size > len(view):
            raise ValueError("an element is longer than what holds it")
        yield kind, view[start : start + size]
        place = start + size + -(start + size) % 8


def _payload(file: BinaryIO, variable: MatVariable) -> bytes:
    file.seek(variable.start)
    data = file.read(variable.size)
    if not variable.compressed:
        return data
    return zlib.decompressobj().decompress(data, 8 * variable.count + SLACK)[8:]


def _text(data: memoryview, order: str) -> str | None:
    if len(data) == 0:
        return ""
    _, shape, class_ = _described(data, order)
    if class_ != "char" or len(shape) != 2 or shape[0] > 1:
        return None
    kind, content = next(islice(_elements(data, order), 3, None), (16, memoryview(b"")))
    coding = TEXTS.get(kind)
    if coding == "utf-16":
        coding += "-le" if order == "<" else "-be"
    return bytes(content).decode(coding) if coding else None
