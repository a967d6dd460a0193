"""Values of an FMU's variables, many at once: packed into memory of C's types that is prepared once."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from typing import Any

from fmus.errors import FmuFileError
from orchestrator.fmi.component import Texts
from orchestrator.fmi.functions.base import FAILED, FmiFunctions
from orchestrator.fmi.interface import Port, Value
from orchestrator.fmi.said import LOG


def _cast(ctype: Any, kind: str) -> Callable[[Any], Any]:
    """From a value to the C type's; whole numbers that do not fit are an OverflowError, for ctypes would cut them."""
    if kind == "Boolean":
        return bool
    if ctype is ctypes.c_char_p:
        return lambda text: str(text).encode()
    if kind == "Binary":
        return lambda text: bytes.fromhex(str(text))
    if ctype in (ctypes.c_double, ctypes.c_float):
        return float
    bits = 8 * ctypes.sizeof(ctype)
    low = -(1 << bits - 1) if ctype(-1).value == -1 else 0
    high = low + (1 << bits) - 1

    def whole(value: float) -> int:
        number = round(value)
        if not low <= number <= high:
            raise OverflowError(f"{value} does not fit into {kind} ({low} to {high})")
        return number

    return whole


def _decoded(text: bytes | None) -> str:
    return (text or b"").decode(errors="replace")


class VariableGroup:
    """Some variables of one FMU, read or written together: one call for each FMI type among them.

    Args:
        texts: gives the numbers of texts.

    Attributes:
        typed: its variables by FMI type, in the order in which they are read and written.
        floats: the only type, where that is one of floats.
        texts: the place of each text -> its variable.
        partial: whether it has elements of an array without the others.
    """

    def __init__(self, fmi: FmiFunctions, ports: Sequence[Port], texts: Texts) -> None:
        by_type: dict[str, list[int]] = {}
        for place, port in enumerate(ports):
            by_type.setdefault(fmi.storage(port.type), []).append(place)
        self._fmi, self._ports, self._texts = fmi, ports, texts
        self.texts = {place: port.name for place, port in enumerate(ports) if port.type == "String"}
        kinds = {"Binary": BinaryValues}
        self.typed = [kinds.get(kind, TypedValues)(fmi, kind, ports, places) for kind, places in by_type.items()]
        only = self.typed[0] if len(self.typed) == 1 else None
        self.floats = only if only is not None and only.plain else None
        self.partial = any(typed.partial for typed in self.typed)

    def write(self, values: Sequence[Value]) -> int:
        """The worst status; nothing is written where a value does not fit its type."""
        if self.floats is not None:
            self.floats.values[:] = values
            return self.floats.set(*self.floats.arguments)
        for typed in self.typed:
            typed.pack(values)
        return max((typed.set(*typed.arguments) for typed in self.typed), default=0)

    def read(self) -> tuple[int, Sequence[float]]:
        """The worst status, and the values as numbers, texts as those that stand for them."""
        if self.floats is not None:
            status = self.floats.get(*self.floats.arguments)
            return status, self.floats.values[:]
        status, values = self.taken()
        if not self.texts:
            return status, [float(value) for value in values]
        named, number = self.texts, self._texts.number
        return status, [
            number(named[place], str(value)) if place in named else float(value) for place, value in enumerate(values)
        ]

    def keep(self, given: Sequence[tuple[Port, Value]]) -> None:
        """Let the elements of arrays that it does not carry have these values, or else their start values."""
        for typed in self.typed:
            if typed.partial:
                typed.keep(given)

    def taken(self) -> tuple[int, Sequence[Value]]:
        """The worst status, and the values in their own types."""
        if self.floats is not None:
            return self.read()
        values: list[Value] = [0.0] * len(self._ports)
        worst = max((typed.get(*typed.arguments) for typed in self.typed), default=0)
        for typed in self.typed:
            typed.unpack(values)
        return worst, values

    def differing(
        self, place: str, wanted: Iterable[Value], values: Iterable[Value]
    ) -> Iterator[tuple[str, Value, Value]]:
        """Name, wanted and present value of each variable that has another value than the wanted one but for rounding,
        be it to the single precision in which some FMUs keep theirs; `place` names the FMU."""
        for port, value, taken in zip(self._ports, wanted, values, strict=True):
            if value != taken and not self._close(place, port, value, taken):
                yield port.name, value, taken

    def _close(self, place: str, port: Port, value: Value, taken: Value) -> bool:
        if not (isinstance(value, float) and isinstance(taken, float)):
            return False
        if math.isclose(value, taken, rel_tol=1e-12):
            return True
        single = math.isfinite(taken) and ctypes.c_float(value).value == ctypes.c_float(taken).value == taken
        if single and not self._fmi.single(port):
            LOG.info("%s.%s: is kept in single precision, %r as %r", place, port.name, value, taken)
        return single


class TypedValues:
    """Variables of one FMI type: prepared arguments for the FMU's get and set functions.

    Attributes:
        places: where its variables lie in the group.
        slots: where each lies in `values`; an array goes with all its elements.
        partial: whether it has elements of an array without the others; those have what `rest` says.
        plain: whether it has one float a variable, in the order of the group.
    """

    def __init__(self, fmi: FmiFunctions, kind: str, ports: Sequence[Port], places: Sequence[int]) -> None:
        self.kind, self.places = kind, places
        self.ctype = ctype = fmi.ctype(kind)
        self._cast = _cast(ctype, kind)
        uncasts: dict[str, Callable[[Any], Value]] = {"Boolean": bool, "String": _decoded}
        self._uncast = uncasts.get(kind)
        self._fmi = fmi
        references: list[int] = []
        self._starts: list[Any] = []  # None where the file does not say
        self._first: dict[int, int] = {}  # reference of an array -> slot of its first element
        self.slots: list[int] = []
        for port in (ports[place] for place in places):
            if port.array is None or port.reference not in self._first:
                references.append(port.reference)
                self._begin(port)
            self.slots.append(self._first[port.reference] + port.element if port.array else len(self._starts) - 1)
        size = len(self._starts)
        self.partial = len(set(self.slots)) < size
        self.in_order = self.slots == list(range(size))
        self.plain = ctype in (ctypes.c_double, ctypes.c_float) and self.in_order
        self.values = (ctype * size)()
        self.references = (ctypes.c_uint * len(references))(*references)
        counts = map(ctypes.c_size_t, (len(references), *fmi.count(size)))
        self.arguments = (fmi.handle, self.references, next(counts), self.values, *counts)
        self._rest: list[Any] = []

    def _begin(self, port: Port) -> None:
        """Make room for a variable, an array with all its elements."""
        if port.array is None:
            self._starts.append(None)
            return
        self._first[port.reference] = len(self._starts)
        if port.array.starts is None:
            self._starts += [None] * math.prod(port.array.shape)
        else:
            self._starts += map(self._cast, port.array.starts)

    @cached_property
    def get(self) -> Callable[..., int]:
        """The FMU's function; it is looked for when it is needed."""
        return self._fmi.accessor("Get", self.kind)

    @cached_property
    def set(self) -> Callable[..., int]:
        """The FMU's function; it is looked for when it is needed."""
        return self._fmi.accessor("Set", self.kind)

    def keep(self, given: Iterable[tuple[Port, Value]]) -> None:
        """Let the elements of arrays that it does not carry have these values, or else their start values, or else
        what they have."""
        rest = list(self._starts)
        for port, value in given:
            if port.array is not None and port.reference in self._first:
                rest[self._first[port.reference] + port.element] = self._cast(value)
        if None in {rest[slot] for slot in set(range(len(rest))).difference(self.slots)}:
            self._require_found(self.get(*self.arguments))
            rest = [found if value is None else value for found, value in zip(self.values[:], rest, strict=True)]
        self._rest = [self._cast(0) if value is None else value for value in rest]
        self.values[:] = self._rest

    def _require_found(self, status: int) -> None:
        if status >= FAILED:
            problem = "has arrays of other sizes than its start values, and does not say what they hold"
            raise FmuFileError(self._fmi.fmu.instanceName, problem, "give or connect all their elements")

    def pack(self, values: Sequence[Value]) -> None:
        """Take its values out of those of the group."""
        packed = [self._cast(values[place]) for place in self.places]
        if self.in_order:
            self.values[:] = packed
            return
        if self.partial:
            if not self._rest:
                self.keep(())
            self.values[:] = self._rest
        for slot, value in zip(self.slots, packed, strict=True):
            self.values[slot] = value

    def unpack(self, values: list[Value]) -> None:
        """Put its values among those of the group."""
        found = self.values[:]
        for slot, place in zip(self.slots, self.places, strict=True):
            values[place] = self._uncast(found[slot]) if self._uncast else found[slot]


class BinaryValues(TypedValues):
    """Variables of type Binary: outside of the FMU their bytes stand in hexadecimal, as in descriptions."""

    def __init__(self, fmi: FmiFunctions, kind: str, ports: Sequence[Port], places: Sequence[int]) -> None:
        super().__init__(fmi, kind, ports, places)
        self._sizes = (ctypes.c_size_t * len(self.values))()
        handle, references, count, values, *rest = self.arguments
        self.arguments = (handle, references, count, self._sizes, values, *rest)
        self._kept: list[Any] = []  # what the FMU is given, while it takes it

    def pack(self, values: Sequence[Value]) -> None:
        given = [self._cast(values[place]) for place in self.places]
        self._kept = [ctypes.create_string_buffer(one, max(len(one), 1)) for one in given]
        for slot, (one, buffer) in enumerate(zip(given, self._kept, strict=True)):
            self._sizes[slot], self.values[slot] = len(one), ctypes.addressof(buffer)

    def unpack(self, values: list[Value]) -> None:
        for slot, place in enumerate(self.places):
            size, address = self._sizes[slot], self.values[slot]
            values[place] = ctypes.string_at(address, size).hex() if address and size else ""
