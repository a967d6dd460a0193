"""What is known of a parameter before the recordings: from a data sheet, or from a measurement of its own."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from fmus.errors import IdentificationError


class Prior(Protocol):
    """A distribution of a parameter's value, in its unit."""

    @property
    def source(self) -> str:
        """Where it is from, for people."""

    @property
    def text(self) -> str:
        """It in words, without the unit."""

    def bounds(self, place: str, lower: float, upper: float) -> tuple[float, float]:
        """The bounds that the parameter has with it.

        Raises:
            IdentificationError: it lies outside the bounds.
        """

    def distance(self, value: float) -> float:
        """How many standard deviations the value is off; 0 everywhere for one that only bounds."""

    def slope(self, value: float) -> float:
        """d distance / d value."""

    def std(self, value: float) -> float:
        """Standard deviation near a value [unit]."""


@dataclass(frozen=True)
class Normal:
    """A normal distribution."""

    mean: float
    deviation: float
    source: str = ""

    @property
    def text(self) -> str:
        return f"{self.mean:.5g} ± {self.deviation:.3g}"

    def bounds(self, place: str, lower: float, upper: float) -> tuple[float, float]:
        _positive(place, "std", self.deviation)
        _within(place, "mean", self.mean, lower, upper)
        return lower, upper

    def distance(self, value: float) -> float:
        return (value - self.mean) / self.deviation

    def slope(self, value: float) -> float:
        return 1 / self.deviation

    def std(self, value: float) -> float:
        return self.deviation


@dataclass(frozen=True)
class LogNormal:
    """A normal distribution of the logarithm: 68 % lie within `factor` of the median either way."""

    median: float
    factor: float
    source: str = ""

    @property
    def text(self) -> str:
        return f"{self.median:.5g} to a factor of {self.factor:.3g}"

    def bounds(self, place: str, lower: float, upper: float) -> tuple[float, float]:
        _positive(place, "median", self.median)
        if not 1 < self.factor < math.inf:
            raise IdentificationError(place, f"factor {self.factor:g} is no spread", "give a factor above 1")
        if lower < 0:
            raise IdentificationError(
                place, f"is log-normal, but the parameter may be {lower:g}", "give `min` of 0 or more"
            )
        _within(place, "median", self.median, lower, upper)
        return lower, upper

    def distance(self, value: float) -> float:
        return math.log(max(value, self._least) / self.median) / math.log(self.factor)

    def slope(self, value: float) -> float:
        return 1 / (max(value, self._least) * math.log(self.factor))

    def std(self, value: float) -> float:
        return max(value, self._least) * math.log(self.factor)

    @property
    def _least(self) -> float:
        """A value so small that it is none of the distribution; the logarithm of 0 is kept away."""
        return self.median * 1e-12


@dataclass(frozen=True)
class Uniform:
    """Anything between two values alike."""

    low: float
    high: float
    source: str = ""

    @property
    def text(self) -> str:
        return f"from {self.low:.5g} to {self.high:.5g}"

    def bounds(self, place: str, lower: float, upper: float) -> tuple[float, float]:
        if not self.low < self.high:
            raise IdentificationError(place, f"{self.low:g} to {self.high:g} leaves no room", "let min < max")
        _within(place, "min", self.low, lower, upper)
        _within(place, "max", self.high, lower, upper)
        return self.low, self.high

    def distance(self, value: float) -> float:
        return 0.0

    def slope(self, value: float) -> float:
        return 0.0

    def std(self, value: float) -> float:
        return (self.high - self.low) / math.sqrt(12)


def _positive(place: str, name: str, value: float) -> None:
    if not 0 < value < math.inf:
        raise IdentificationError(place, f"{name} {value:g} is not positive", "give one above 0")


def _within(place: str, name: str, value: float, lower: float, upper: float) -> None:
    if not (math.isfinite(value) and lower <= value <= upper):
        raise IdentificationError(
            place,
            f"{name} {value:g} is outside the parameter's bounds, {lower:g} to {upper:g}",
            "move the prior, or the parameter's `min` and `max`",
        )
