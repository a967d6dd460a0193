"""The elements of an FMU's array variables as ports, with the shapes that structural parameters give them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from fmpy.model_description import ModelVariable

from fmus.errors import WiringError
from fmus.modelling.model import element_names
from orchestrator.fmi.interface import Array, Port, Value

LARGEST = 1 << 17  # elements of all arrays of an FMU that become ports


class LeftOutError(Exception):
    """An array has no ports; the message says why."""


@dataclass(frozen=True)
class Sizes:
    """What structural parameters say of the shapes of arrays.

    Attributes:
        given: name -> value, of those that are given one.
        original, present: value reference -> start value and present value, of all that dimensions refer to.
    """

    given: Mapping[str, Value]
    original: Mapping[int, int]
    present: Mapping[int, int]

    def shape(self, variable: ModelVariable) -> tuple[int, ...]:
        """Present shape of an array; () of a scalar."""
        return _shape(variable, self.present)

    def declared(self, variable: ModelVariable) -> tuple[int, ...]:
        """Shape of an array that its start values are for; () of a scalar."""
        return _shape(variable, self.original)

    def resized(self, variable: ModelVariable) -> bool:
        """Whether it is not the shape that the start values are for."""
        return self.shape(variable) != self.declared(variable)


def _shape(variable: ModelVariable, sizes: Mapping[int, int]) -> tuple[int, ...]:
    found = ((size.start, size.valueReference) for size in variable.dimensions)
    return tuple(int(start) if start is not None else sizes[reference] for start, reference in found)


def sizes(place: object, ports: Sequence[Port], parameters: Mapping[str, Value]) -> Sizes:
    """What these parameters, and the start values of the others, say of shapes.

    Args:
        ports: those of the variables that dimensions refer to, and of all structural parameters.

    Raises:
        WiringError: a structural parameter cannot have that value.
    """
    original = {port.reference: int(port.start) for port in ports if port.start is not None}
    chosen = [port for port in ports if port.causality == "structuralParameter" and port.name in parameters]
    given = {port.name: _checked(f"{place}: {port.name}", port, parameters[port.name]) for port in chosen}
    return Sizes(given, original, original | {port.reference: int(given[port.name]) for port in chosen})


def _checked(place: str, port: Port, value: Value) -> Value:
    typed = port.typed(place, value)
    low = -math.inf if port.minimum is None else port.minimum
    high = math.inf if port.maximum is None else port.maximum
    if not isinstance(typed, str) and not low <= typed <= high:
        raise WiringError(place, f"is {typed}, outside its bounds [{low:g}, {high:g}]", "choose a value inside")
    return typed


def elements(port: Port, shape: tuple[int, ...], starts: Sequence[str] | None, room: int) -> Iterator[Port]:
    """The port of each element of an array.

    Args:
        port: of the variable as a whole.
        starts: start values as the file gives them, all or one for all; None without any for this shape.

    Raises:
        LeftOutError: it has more elements than `room`, or a start value too many or too few.
    """
    count = math.prod(shape)
    size = f"an array of {' x '.join(map(str, shape))} elements"
    if port.alone or min(shape) < 0 or count > room:
        raise LeftOutError(size)
    texts = None if starts is None else list(starts) * (count if len(starts) == 1 else 1)
    if texts is not None and len(texts) != count:
        raise LeftOutError(f"{size} with {len(texts)} start values")
    whole = Array(port.name, shape, None if texts is None else tuple(map(port.parsed, texts)))
    for number, name in enumerate(element_names(port.name, shape)):
        yield replace(port, name=name, start=None if texts is None else texts[number], array=whole, element=number)
