"""The MATLAB v5 container: which variables a file holds, and what is in each.

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
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from orchestrator.formats.arrays.tree import DEEPEST, Node, NumberArray, Other, Structure
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
NUMERIC = frozenset(
    {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
)
COMPLEX, LOGICAL = 0x0800, 0x0200
HEAD = 4096  # bytes that hold flags, dimensions and name of any variable
SLACK = 2**20  # bytes that a variable may need beyond its numbers
LARGEST = 2**29  # bytes of a structure


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


def node(file: BinaryIO, variable: MatVariable) -> Node:
    """What a variable holds; numbers are read when they are asked for."""
    if variable.kind in NUMERIC:
        return NumberArray(variable.shape, lambda: _whole(file, variable), variable.kind)
    if variable.kind in ("struct", "cell", "char"):
        return _node(_payload(file, variable, LARGEST), variable.order)
    return Other(variable.shape, variable.kind)


def _whole(file: BinaryIO, variable: MatVariable) -> FloatArray:
    read = _node(_payload(file, variable, 8 * variable.count + SLACK), variable.order)
    if not isinstance(read, NumberArray):
        raise ValueError(f"'{variable.name}' holds no numbers")
    return read.read()


def _node(data: bytes | memoryview, order: str, depth: int = 0) -> Node:
    """What a matrix element holds, its parts looked through."""
    if len(data) == 0:
        return Other((0, 0), "empty")
    if depth > DEEPEST:
        raise ValueError("structures are too deep inside each other")
    _, shape, class_ = _described(data, order)
    if class_ not in NUMERIC and class_ not in ("struct", "cell", "char"):
        return Other(shape, class_)
    parts = list(_elements(data, order))[3:]
    count = math.prod(shape)
    if class_ in NUMERIC:
        numbers = _numbers(parts, count, order).reshape(shape, order="F")
        return NumberArray(shape, lambda: numbers.astype(float), class_)
    if class_ == "char":
        return _text(parts, shape, order)
    if class_ == "cell":
        return [_node(part, order, depth + 1) for kind, part in parts if kind == MATRIX]
    return _structure(parts, count, order, depth)


def _structure(parts: list[tuple[int, memoryview]], count: int, order: str, depth: int) -> Structure:
    """The elements of a struct array: its fields' names are told once, of a fixed length."""
    if len(parts) < 2 or len(parts[0][1]) != 4:
        raise ValueError("a structure has no names of fields")
    length, names = struct.unpack(order + "I", parts[0][1])[0], bytes(parts[1][1])
    fields = [names[at : at + length].partition(b"\0")[0].decode("latin-1") for at in range(0, len(names), length or 1)]
    if length == 0 or len(parts) - 2 != count * len(fields):
        raise ValueError("a structure has not as many fields as it says")
    nodes = (_node(part, order, depth + 1) for _, part in parts[2:])
    return Structure([{field: next(nodes) for field in fields} for _ in range(count)])


def _numbers(parts: list[tuple[int, memoryview]], count: int, order: str) -> NDArray[Any]:
    if not parts or parts[0][0] not in NUMBERS:
        if count == 0:
            return np.empty(0)
        raise ValueError("a variable holds no numbers")
    numbers = np.frombuffer(parts[0][1], order + NUMBERS[parts[0][0]])
    if len(numbers) != count:
        raise ValueError(f"a variable holds {len(numbers)} numbers instead of {count}")
    return numbers


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


def _payload(file: BinaryIO, variable: MatVariable, most: int) -> bytes:
    file.seek(variable.start)
    data = file.read(variable.size)
    if not variable.compressed:
        return data
    return zlib.decompressobj().decompress(data, most)[8:]


def _text(parts: list[tuple[int, memoryview]], shape: tuple[int, ...], order: str) -> Node:
    kind, content = parts[0] if parts else (16, memoryview(b""))
    coding = TEXTS.get(kind)
    if coding is None or len(shape) != 2 or shape[0] > 1:
        return Other(shape, "char")
    if coding == "utf-16":
        coding += "-le" if order == "<" else "-be"
    return bytes(content).decode(coding)
