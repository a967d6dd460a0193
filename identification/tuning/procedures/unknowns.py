"""Parameters of a controller that are sought between bounds, and where a value lies between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.parameters import Scale
from orchestrator.fmi.interface import Port
from orchestrator.trace import FloatArray


@dataclass(frozen=True)
class Unknown:
    """A parameter of the controller that is sought.

    Attributes:
        low, high: the bounds, in its unit, or like `5 V`.
        start: where the search begins; the controller's own value without.
        scale: in which steps are taken between the bounds, `linear` or `log`.
    """

    low: float | str
    high: float | str
    start: float | str | None = None
    scale: Scale = "linear"

    def span(self, port: Port) -> Span:
        """In numbers.

        Raises:
            InputError: a unit of another quantity, or bounds that are none.
        """
        place = f"unknowns.{port.name}"
        low, high = (port.number(place, end) for end in (self.low, self.high))
        given = self.start if self.start is not None else float(port.start or 0.0)
        start = port.number(place, given)
        if not low < high:
            raise IdentificationError(place, f"has the bounds {low:g} and {high:g}", "give `min` below `max`")
        if self.scale == "log" and low <= 0:
            raise IdentificationError(place, f"is searched in a log scale from {low:g}", "give a `min` above 0")
        for name, limit, out in (("min", port.minimum, low), ("max", port.maximum, high)):
            if limit is not None and (out < limit if name == "min" else out > limit):
                raise IdentificationError(place, f"is searched to {out:g}, outside its {name} {limit:g}", "narrow it")
        if not low <= start <= high:
            raise IdentificationError(
                place, f"starts at {start:g}, outside [{low:g}, {high:g}]", "give another `start`"
            )
        return Span(port.name, low, high, start, self.scale)


@dataclass(frozen=True)
class Span:
    """An unknown in numbers, between its bounds."""

    name: str
    low: float
    high: float
    start: float
    scale: Scale

    def value(self, part: float) -> float:
        """Between the bounds, from 0 to 1."""
        inside = (
            self.low * (self.high / self.low) ** part
            if self.scale == "log"
            else self.low + part * (self.high - self.low)
        )
        return float(min(max(inside, self.low), self.high))

    def part(self, value: float) -> float:
        """Where a value lies, 0 at the lower and 1 at the upper bound."""
        if self.scale == "log":
            return float(np.log(value / self.low) / np.log(self.high / self.low))
        return float((value - self.low) / (self.high - self.low))


def parts(unknowns: Sequence[Span], values: Mapping[str, float]) -> FloatArray:
    return np.array([unknown.part(values[unknown.name]) for unknown in unknowns])
