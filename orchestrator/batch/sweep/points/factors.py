"""What varies over the points of a sweep, in the units of its variables: laws that turn shares into values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import numpy as np
from scipy import stats

from orchestrator.fmi.interface import Value
from orchestrator.trace import FloatArray

LEAST = 2.0**-53  # a share is no closer to 0 and 1: a normal distribution ends nowhere


class Law(Protocol):
    """How a factor is distributed."""

    def at(self, shares: FloatArray) -> FloatArray:
        """(N,) values below which these shares (N,) of all lie."""

    @property
    def levels(self) -> FloatArray:
        """(L,) values of a grid."""

    @property
    def bounded(self) -> bool:
        """Whether it has a lowest and a highest value."""


@dataclass(frozen=True)
class UniformBetween:
    """Uniform from end to end, or its logarithm is.

    Attributes:
        count: levels of a grid.
    """

    low: float
    high: float
    log: bool = False
    count: int = 2

    def at(self, shares: FloatArray) -> FloatArray:
        low, high = self._ends
        found = low + shares * (high - low)
        return np.clip(np.exp(found), self.low, self.high) if self.log else found

    @property
    def levels(self) -> FloatArray:
        return self.at(np.linspace(0.0, 1.0, self.count))

    @property
    def bounded(self) -> bool:
        return True

    @property
    def _ends(self) -> tuple[float, float]:
        return (float(np.log(self.low)), float(np.log(self.high))) if self.log else (self.low, self.high)


@dataclass(frozen=True)
class TruncatedNormal:
    """Normal, without what lies outside the ends."""

    mean: float
    std: float
    low: float = -np.inf
    high: float = np.inf

    def at(self, shares: FloatArray) -> FloatArray:
        ends = stats.norm.cdf([(self.low - self.mean) / self.std, (self.high - self.mean) / self.std])
        inside = ends[0] + np.clip(shares, LEAST, 1 - LEAST) * (ends[1] - ends[0])
        found: FloatArray = np.clip(self.mean + self.std * stats.norm.ppf(inside), self.low, self.high)
        return found

    @property
    def levels(self) -> FloatArray:
        return np.array([self.mean])

    @property
    def bounded(self) -> bool:
        return bool(np.isfinite([self.low, self.high]).all())


@dataclass(frozen=True)
class Levels:
    """Some values, each as often."""

    values: tuple[float, ...]

    def at(self, shares: FloatArray) -> FloatArray:
        number = np.minimum((shares * len(self.values)).astype(int), len(self.values) - 1)
        found: FloatArray = self.levels[number]
        return found

    @property
    def levels(self) -> FloatArray:
        return np.array(self.values)

    @property
    def bounded(self) -> bool:
        return True


class Target(StrEnum):
    """What a factor is of."""

    VALUE = "a parameter or start value"
    CONSTANT = "a constant stimulus"
    RECORDING = "a recording that drives an input"
    FMU = "an FMU in place of a component"


@dataclass(frozen=True)
class Factor:
    """Something that varies.

    Attributes:
        name: component.variable, or a component.
        unit: of the variable, "" where it has none.
        words: what numbers of levels stand for, where values are no numbers; then the law gives such numbers.
        whole: the type of values that are no real numbers.
    """

    name: str
    law: Law
    target: Target = Target.VALUE
    unit: str = ""
    words: tuple[str, ...] = ()
    whole: type[int] | type[bool] | None = None

    def value(self, number: float) -> Value:
        """What a run is given, where a point has this number."""
        if self.words:
            return self.words[int(number)]
        return self.whole(number) if self.whole else float(number)


@dataclass(frozen=True, eq=False)
class JointFactors:
    """Factors that are drawn together, normally: mean (k,) and a root R (k, k) of their covariance R R'."""

    names: tuple[str, ...]
    mean: FloatArray
    root: FloatArray

    def at(self, shares: FloatArray) -> FloatArray:
        """(N, k) values of shares (N, k) of independent ones."""
        found: FloatArray = self.mean + stats.norm.ppf(np.clip(shares, LEAST, 1 - LEAST)) @ self.root.T
        return found


@dataclass(frozen=True)
class Space:
    """All factors; those that are drawn together come last."""

    factors: tuple[Factor, ...]
    joint: JointFactors | None = None

    def __len__(self) -> int:
        return len(self.factors)

    @property
    def names(self) -> list[str]:
        return [factor.name for factor in self.factors]

    @property
    def alone(self) -> Sequence[Factor]:
        """Those that are drawn by themselves."""
        return self.factors[: len(self) - (len(self.joint.names) if self.joint else 0)]

    def at(self, shares: FloatArray) -> FloatArray:
        """(N, d) points of shares (N, d)."""
        columns = [factor.law.at(shares[:, place]) for place, factor in enumerate(self.alone)]
        if self.joint is not None:
            columns += list(self.joint.at(shares[:, len(columns) :]).T)
        return np.stack(columns, axis=1) if columns else np.zeros((len(shares), 0))
