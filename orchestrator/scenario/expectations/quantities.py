"""Numbers of expectations as files hold them: plain, or with a unit of their own, and what that is brought to.

A time, a share and a frequency are brought to their units when a file is read; a level or a distance of a signal waits
for the variable.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from typing import Annotated, Any, TypeVar, get_args

from pydantic import BeforeValidator, Field

from fmus.errors import WiringError
from fmus.unit_table import TURN
from fmus.units import SECOND
from orchestrator.crossing import NamedUnit, named, quantity, taken
from orchestrator.fmi.interface import Port
from orchestrator.yaml_file import Block, Quantity

Number = float | str
"""In the unit of the signal; a text with a unit of its own, `90 deg`, until it is brought."""


class Dimension(StrEnum):
    """What a figure of a signal is, and so its unit."""

    LEVEL = "level"
    DISTANCE = "distance"
    TIME = "time"
    SHARE = "share"
    FREQUENCY = "frequency"
    AREA = "area"
    SQUARE_AREA = "square area"
    TIME_AREA = "time area"

    def number(self, place: str, value: Number, port: Port | None, difference: bool = False) -> float:
        """The number that is meant for a figure of a signal, or for a difference of two.

        Raises:
            WiringError: as `number`.
        """
        if self is Dimension.FREQUENCY:
            return frequency(place, value)
        own = Dimension.DISTANCE if difference and self is Dimension.LEVEL else self
        return number(place, value, own._unit(port.measure if port else named("1")), own is not Dimension.LEVEL)

    @property
    def own(self) -> str:
        """The name of its unit, where that is not made of a signal's; else ""."""
        return {Dimension.TIME: "s", Dimension.FREQUENCY: "rad/s"}.get(self, "")

    def written(self, unit: str) -> str:
        """The name of its unit, where that of the signal is `unit`; "" where it has none."""
        of_signal = "" if unit == "1" else unit
        joined = f"({of_signal})" if "/" in of_signal or "." in of_signal else of_signal
        squared = f"{joined}2" if joined else ""
        names = {
            Dimension.TIME: self.own,
            Dimension.SHARE: "",
            Dimension.FREQUENCY: self.own,
            Dimension.AREA: f"{joined}.s".strip("."),
            Dimension.SQUARE_AREA: f"{squared}.s".strip("."),
            Dimension.TIME_AREA: f"{joined}.s2".strip("."),
        }
        return names.get(self, of_signal)

    def _unit(self, signal: NamedUnit) -> NamedUnit:
        """Its unit for a signal with that one."""
        if self is Dimension.LEVEL:
            return signal
        if self in (Dimension.TIME, Dimension.SHARE):
            return named("s" if self is Dimension.TIME else "1")
        one = signal.difference
        again, seconds = {
            Dimension.AREA: (0, 1),
            Dimension.SQUARE_AREA: (1, 1),
            Dimension.TIME_AREA: (0, 2),
        }.get(self, (0, 0))
        unit = one.unit and one.unit.times(one.unit, again).times(SECOND, seconds)
        return NamedUnit(self.written(one.name), unit, one.declared)


def number(place: str, value: Number, unit: NamedUnit, difference: bool = False) -> float:
    """The number that is meant, in this unit.

    Args:
        difference: whether it is one between values, so that offsets of units do not count.

    Raises:
        WiringError: a text is no number with a unit that is known, or that of another quantity.
    """
    if not isinstance(value, str):
        return value
    found = quantity(value)
    own = named(found[1]) if found else NamedUnit()
    if found is None or own.unit is None or unit.unit is None:
        raise WiringError(place, f"cannot be '{value}': no unit that is known on both sides", "give a plain number")
    return taken(place, found[0], own.difference if difference else own, unit)


def frequency(place: str, value: Number) -> float:
    """The number that is meant in rad/s; a text in Hz counts periods. Raises as `number` does."""
    found = quantity(value) if isinstance(value, str) else None
    if found is not None and named(found[1]).counts_turns:
        return TURN * number(place, value, named("Hz"))
    return number(place, value, named("rad/s"))


def _reading(unit: str, read: Callable[[str, Number], float], example: str) -> BeforeValidator:
    def checked(value: Any) -> Any:
        if not isinstance(value, str):
            return value
        try:
            return read("it", value)
        except WiringError as error:
            raise ValueError(f"'{value}' is no quantity in {unit}") from error

    text = Annotated[Quantity, Field(examples=[example])]
    return BeforeValidator(checked, json_schema_input_type=float | text)


Share = Annotated[float, _reading("1", lambda place, value: number(place, value, named("1")), "5 %")]
"""[1], or `5 %`."""
Frequency = Annotated[float, _reading("rad/s or Hz", frequency, "2 Hz"), Field(gt=0)]
"""[rad/s], or `2 Hz`."""
Level = Annotated[float | Quantity, Dimension.LEVEL]
"""A value of the signal, in its unit or with its own: `90 deg`."""
Distance = Annotated[float | Quantity, Dimension.DISTANCE]
"""A difference between values of the signal."""

B = TypeVar("B", bound=Block)


def brought(block: B, place: str, port: Port) -> B:
    """A block whose levels and distances are numbers in the unit of the signal.

    Raises:
        WiringError: as `number`.
    """
    found = {}
    for name, field in type(block).model_fields.items():
        own = [mark for mark in field.metadata if isinstance(mark, Dimension)]
        dimensions, value = [*own, *_marks(field.annotation)], getattr(block, name)
        if dimensions:
            found[name] = _numbers(place, value, dimensions[0], port)
        elif isinstance(value, Block):
            found[name] = brought(value, place, port)
    return block.model_copy(update=found)


def _marks(kind: Any) -> list[Dimension]:
    own = [mark for mark in getattr(kind, "__metadata__", ()) if isinstance(mark, Dimension)]
    return own + [mark for inner in get_args(kind) for mark in _marks(inner)]


def _numbers(place: str, value: Any, dimension: Dimension, port: Port) -> Any:
    if isinstance(value, tuple | list):
        return tuple(_numbers(place, entry, dimension, port) for entry in value)
    return dimension.number(place, value, port) if isinstance(value, str) else value
