"""Where values lie in memory, and the calls that carry them there and back."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Sequence
from typing import Any

from orchestrator.engine._compiled import Storage
from orchestrator.fmi.functions.values import VariableGroup
from orchestrator.trace import FloatArray

Row = tuple[int, ...]  # a value or a call in the terms of the extension


def side_by_side(places: Sequence[int]) -> bool:
    return [*places] == list(range(places[0], places[0] + len(places)))


def moved(group: VariableGroup, floats: Sequence[int], verb: str, direct: bool) -> tuple[list[Row], list[Row]]:
    """The values of a group that are converted between the FMU's types and floats, and the calls that get or set
    all; where it may be `direct`, floats that lie side by side are not converted: the FMU is given their place."""
    values: list[Row] = []
    calls: list[Row] = []
    for typed in group.typed:
        kind, size, places = _storage(typed.kind, typed.ctype), ctypes.sizeof(typed.ctype), typed.places
        memory, total = ctypes.addressof(typed.values), len(typed.values)
        if direct and kind == Storage.FLOAT64 and typed.in_order and side_by_side(places):
            memory = floats[places[0]]
        else:
            values += [
                (kind, memory + size * slot, floats[place]) for slot, place in zip(typed.slots, places, strict=True)
            ]
        width = size if kind in (Storage.FLOAT64, Storage.FLOAT32) else 0
        references = ctypes.addressof(typed.references), len(typed.references)
        calls.append((entry(getattr(typed, verb)), *references, memory, total, width))
    return values, calls


def addresses(values: FloatArray) -> list[int]:
    first = int(values.__array_interface__["data"][0])
    return list(range(first, first + values.nbytes, values.itemsize))


@functools.cache
def _storage(kind: str, ctype: Any) -> int:
    """How the extension calls an FMI type kept as this C type."""
    size = ctypes.sizeof(ctype)
    if kind == "Boolean":
        return int(Storage.BOOL if size == 1 else Storage.FLAG)
    if ctype in (ctypes.c_double, ctypes.c_float):
        return int(Storage.FLOAT64 if size == 8 else Storage.FLOAT32)
    signed = ctype(-1).value == -1
    return int(getattr(Storage, f"{'' if signed else 'U'}INT{8 * size}"))


def entry(function: Any) -> int:
    """Its address."""
    return ctypes.c_size_t.from_buffer(function).value
