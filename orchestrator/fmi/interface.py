"""What an FMU offers to a system, in plain values: its variables and what acts on what."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from fmus import units
from fmus.errors import WiringError
from fmus.modelling.model import element
from fmus.units import Unit
from orchestrator.crossing import NamedUnit, quantity, taken
from orchestrator.fmi.clocks.declared import Clock

Value = float | int | bool | str


class Written(str):
    """A value as somebody has written it, whose type the variable decides."""

    __slots__ = ()

    def read(self) -> Value:
        """As a number, or true or false, where it looks like one."""
        text = self.strip()
        if text.lower() in ("true", "false"):
            return text.lower() == "true"
        for kind in (int, float):
            try:
                return kind(text)
            except ValueError:
                continue
        return text


_REAL = ("Real", "Float64", "Float32")
_TRUTH = {"true": True, "1": True, "false": False, "0": False}
_ALONE = ("Binary", "Clock")  # nothing connects, sets or records them
TANGENT = "Tangent"  # type of a derivative along a direction, which native FMUs of the library carry beside values
_TANGENT_NAME = re.compile(r"(.+) along direction (\d+)")
_WHOLE = re.compile(r"(U?)Int(\d+)|Integer")


@dataclass(frozen=True)
class Array:
    """An array variable as a whole.

    Attributes:
        starts: start values of all elements, row by row; None where the file gives none for an array of this shape.
    """

    name: str
    shape: tuple[int, ...]
    starts: tuple[Value, ...] | None = field(default=None, repr=False)


@dataclass(frozen=True)
class Port:
    """A scalar variable of an FMU, or an element of an array, named as in `A[1,2]`.

    Attributes:
        type: FMI type name ("Real", "Float64", "Integer", "Int32", "Boolean", "Enumeration", "String", ...).
        variability: "constant", "fixed", "tunable", "discrete" or "continuous".
        start: start value as the file gives it, None without one.
        items: name -> value of an enumeration.
        array: what it is an element of.
        element: its number there, from 0 and row by row.
        definitions: what units are by the FMU's own word, by name.
        exact: whether it has its start value once the initialisation has begun, unless it was given another.
        relative: whether it is a difference between values, so that offsets of units do not count.
    """

    name: str
    reference: int
    type: str
    causality: str
    unit: str | None = None
    start: str | None = None
    minimum: float | None = None
    maximum: float | None = None
    items: Mapping[str, int] | None = None
    description: str = ""
    variability: str = "continuous"
    array: Array | None = field(default=None, repr=False)
    element: int = 0
    definitions: Mapping[str, Unit] = field(default_factory=dict, repr=False)
    exact: bool = False
    relative: bool = False

    @property
    def measure(self) -> NamedUnit:
        """Its unit, as the FMU defines it; by its name where the FMU does not."""
        return self.meaning(self.unit)

    def meaning(self, name: str | None) -> NamedUnit:
        """A unit of a value that comes to it or goes from it: by the FMU's word, or else by its name."""
        known = self.definitions.get(name or "")
        unit = NamedUnit(name or "", known or units.parse(name or ""), known is not None)
        return unit.difference if self.relative else unit

    @property
    def start_number(self) -> float | None:
        """Its declared start value as a number, None where it is none."""
        text = (self.start or "").strip()
        try:
            return float({"true": "1", "false": "0"}.get(text, text))
        except ValueError:
            return None

    @property
    def numeric(self) -> bool:
        """Whether its values are numbers (or true and false), so that they can be connected and recorded."""
        return self.type not in ("String", *_ALONE)

    @property
    def recordable(self) -> bool:
        """Whether a trace can hold its values: numbers, or texts."""
        return not self.alone

    @property
    def stepwise(self) -> bool:
        """Whether it changes in steps: between two samples of a recording it has the value of the earlier one."""
        return not self.real or self.variability == "discrete"

    @property
    def real(self) -> bool:
        """Whether its values are real numbers."""
        return self.type in _REAL

    @property
    def alone(self) -> bool:
        """Whether it is left as it is: clocks never tick, binary variables keep what they have."""
        return self.type in _ALONE

    @property
    def settable(self) -> bool:
        """Whether it can be given a value before a run: parameters, inputs, and states with a start value."""
        stated = self.start is not None and self.causality in ("structuralParameter", "local", "output")
        settable = stated or self.causality in ("parameter", "input")
        return settable and self.variability != "constant" and not self.alone

    def parsed(self, start: str) -> Value:
        """A start value as the file gives it, in the variable's type.

        Raises:
            ValueError: it is none of that type.
        """
        if self.type == "Boolean":
            if start.strip() not in _TRUTH:
                raise ValueError(start)
            return _TRUTH[start.strip()]
        if self.type in _REAL:
            return float(start)
        if not self.numeric:
            return start
        low, high = self._whole_range
        number = int(start)
        if not low <= number <= high or (self.items and number not in self.items.values()):
            raise ValueError(start)
        return number

    def typed(self, place: str, value: Value) -> Value:
        """The value in the variable's type; an item of an enumeration by its name or number.

        Raises:
            WiringError: it is of another type; the message names `place`.
        """
        if self.type == "String":
            return str(value)
        if isinstance(value, Written):
            value = value.read()
        if self.items:
            return self._item(place, value)
        if isinstance(value, str):
            return self.quantity(place, value)
        if self.type == "Boolean":
            if value not in (0, 1):
                raise WiringError(place, f"is a Boolean, not {value}", "give true or false")
            return bool(value)
        if isinstance(value, bool):
            raise WiringError(place, f"cannot be {str(value).lower()}", f"give a {self.type}")
        return float(value) if self.type in _REAL else self._whole(place, value)

    def number(self, place: str, value: float | str) -> float:
        """The number that somebody gives, as one or like `3000 rpm`; raises as `quantity` does."""
        return self.quantity(place, value) if isinstance(value, str) else value

    def quantity(self, place: str, text: str, difference: bool = False) -> float:
        """The number that a text like `3000 rpm` means in the variable's unit.

        Args:
            difference: whether it is one between values, so that offsets of units do not count.

        Raises:
            WiringError: it is no number with a unit, or the unit is not known, or of another quantity.
        """
        found = quantity(text) if self.type in _REAL else None
        if found is None:
            raise WiringError(place, f"cannot be '{text}'", f"give a {self.type}")
        number, name = found
        if name == self.unit:
            return number
        unit, own = self.meaning(name), self.measure
        if unit.unit is None or own.unit is None:
            unknown = f"'{name}' is no unit that is known" if unit.unit is None else "the variable has no unit"
            raise WiringError(place, f"cannot be '{text}': {unknown}", "give a plain number")
        if difference:
            unit, own = unit.difference, own.difference
        return taken(place, number, unit, own)

    def _item(self, place: str, value: Value) -> int:
        """The number of an enumeration's item."""
        items = self.items or {}
        if isinstance(value, str) and value in items:
            return items[value]
        if not isinstance(value, bool) and value in items.values():
            return int(value)
        known = ", ".join(f"{name} ({number})" for name, number in items.items())
        raise WiringError(
            place, f"cannot be '{value}'" if isinstance(value, str) else f"cannot be {value}", f"give {known}"
        )

    @property
    def _whole_range(self) -> tuple[float, float]:
        """The whole numbers of its type."""
        match = _WHOLE.fullmatch(self.type)
        if match is None:
            return -math.inf, math.inf
        bits = int(match[2] or 32)
        low = 0 if match[1] else -(1 << bits - 1)
        return low, low + (1 << bits) - 1

    def _whole(self, place: str, value: float) -> int:
        if not math.isfinite(value) or int(value) != value:
            raise WiringError(place, f"is of type {self.type}, {value} is not whole", "give a whole number")
        low, high = self._whole_range
        if not low <= value <= high:
            raise WiringError(
                place, f"{value} does not fit into {self.type} ({low} to {high})", "choose a value inside"
            )
        return int(value)


def start_numbers(ports: Iterable[Port]) -> dict[str, float]:
    """Declared start values of those that have one that is a number, and are no elements of arrays."""
    starts = {port.name: port.start_number for port in ports if port.numeric and not port.array}
    return {name: start for name, start in starts.items() if start is not None}


@dataclass(frozen=True)
class Interface:
    """What a component offers to a system.

    Attributes:
        ports: name -> scalar variable or element of an array.
        left_out: arrays that have no ports, each with the reason.
        sizes: structural parameters that were given values, with which the arrays have these shapes.
        clocks: name -> clock.
        clocked: variable -> the clocks at whose ticks it is set or changes.
        event_mode: whether it takes events, and so ticks, from outside.
        variable_step: whether its communication steps may change their length.
        updates: whether it tells of what happens within a step (intermediate update).
        intermediate: variables that it then gives.
        feed_through: output -> the inputs that act on it at once; None where the FMU does not say.
        doubts: variable, or else what there is, -> what its description says that may not be meant.
    """

    model_name: str
    fmi_version: str
    ports: Mapping[str, Port]
    feed_through: Mapping[str, frozenset[str] | None]
    has_state: bool = False
    fixed_step: float | None = None
    left_out: Mapping[str, str] = field(default_factory=dict)
    sizes: Mapping[str, Value] = field(default_factory=dict)
    clocks: Mapping[str, Clock] = field(default_factory=dict)
    clocked: Mapping[str, frozenset[str]] = field(default_factory=dict)
    event_mode: bool = False
    variable_step: bool = True
    updates: bool = False
    intermediate: frozenset[str] = frozenset()
    doubts: Mapping[str, str] = field(default_factory=dict)

    @property
    def ticks(self) -> bool:
        """Whether it has clocks that tick, or can be ticked."""
        return self.event_mode and bool(self.clocks)

    def shape(self, array: str) -> tuple[int, ...] | None:
        """Shape of an array, or of scalars that are named as its elements; None where there are none."""
        start = len(array)
        found = [port for name, port in self.ports.items() if name.startswith(f"{array}[")]
        places = (element(f"x{port.name[start:]}") for port in found)
        shapes = [port.array.shape for port in found if port.array is not None and port.array.name == array]
        return shapes[0] if shapes else max((place for _, place in filter(None, places)), default=None)

    def of(self, causality: str) -> tuple[Port, ...]:
        """Ports of one causality."""
        return tuple(port for port in self.ports.values() if port.causality == causality)


def along(variable: str, directions: int) -> list[str]:
    """Names of a variable's tangents, which are variables like others in a loop."""
    return [f"{variable} along direction {number}" for number in range(1, directions + 1)]


def tangent(interface: Interface, name: str, directions: int) -> Port | None:
    """The tangent of this name; None where it is none."""
    named = _TANGENT_NAME.fullmatch(name)
    port = interface.ports.get(named[1]) if named else None
    if named is None or port is None:
        return None
    return replace(port, name=name, type=TANGENT, array=Array(name, (directions,)), element=int(named[2]) - 1)
