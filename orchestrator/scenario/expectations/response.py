"""Figures of a response: where it ends, how fast, how far beyond, what is left, and integrals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Literal

from pydantic import Field

from orchestrator import measures
from orchestrator.fmi.interface import Port
from orchestrator.scenario.expectations.base import Condition, ExpectationScope, Judgement
from orchestrator.scenario.expectations.figure import Figure
from orchestrator.scenario.expectations.quantities import Dimension, Distance, Level, Share, brought
from orchestrator.trace import FloatArray, Trace
from orchestrator.yaml_file import Block, Time


class FinalValue(Figure):
    """Mean over the last seconds.

    Attributes:
        over: how many [s]; 0 takes the last sample.
    """

    words: ClassVar[str] = "final value"
    dimension: ClassVar[Dimension] = Dimension.LEVEL
    lowest: ClassVar[float] = float("-inf")
    over: Time = Field(0.0, ge=0)

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float:
        return measures.final_value(time, values, self.over, hold)


class SteadyError(Figure):
    """Distance of the final value from a target.

    Attributes:
        target: where it should end [unit of the signal].
        over: as in `FinalValue` [s].
    """

    words: ClassVar[str] = "steady error"
    dimension: ClassVar[Dimension] = Dimension.DISTANCE
    target: Level
    over: Time = Field(0.0, ge=0)

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float:
        return abs(measures.steady_error(time, values, float(self.target), self.over, hold))


class SettlingTime(Figure):
    """Time until the signal stays within `band` of the target.

    Attributes:
        target: where it should end [unit of the signal].
        band: half the width [unit of the signal].
    """

    words: ClassVar[str] = "settling time"
    dimension: ClassVar[Dimension] = Dimension.TIME
    target: Level
    band: Distance

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float | None:
        return measures.settling_time(time, values, float(self.target), float(self.band), hold)


class ResidualRms(Figure):
    """Root of the mean square distance from the target once the signal has settled, as for the settling time.

    Attributes:
        target: where it should end [unit of the signal].
        band: within which it has settled, half the width [unit of the signal].
    """

    words: ClassVar[str] = "residual rms"
    dimension: ClassVar[Dimension] = Dimension.DISTANCE
    target: Level
    band: Distance

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float | None:
        return measures.residual_rms(time, values, float(self.target), float(self.band), hold)


class RiseTime(Figure):
    """Time from `low` to `high` of the way to the target.

    Attributes:
        target: end of the way [unit of the signal].
        start: of the way; by default the first sample [unit of the signal].
        low, high: shares of the way between which the time is taken.
    """

    words: ClassVar[str] = "rise time"
    dimension: ClassVar[Dimension] = Dimension.TIME
    target: Level
    start: Level | None = None
    low: Share = Field(0.1, ge=0, lt=1)
    high: Share = Field(0.9, gt=0, le=1)

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float | None:
        start = float(values[0] if self.start is None else self.start)
        return measures.rise_time(time, values, start, float(self.target), self.low, self.high, hold)


class Overshoot(Figure):
    """How far the signal goes beyond the target, as a share of the way there.

    Attributes:
        target: end of the way [unit of the signal].
        start: of the way; by default the first sample [unit of the signal].
    """

    words: ClassVar[str] = "overshoot"
    dimension: ClassVar[Dimension] = Dimension.SHARE
    target: Level
    start: Level | None = None

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float:
        start = float(values[0] if self.start is None else self.start)
        return measures.overshoot(time, values, start, float(self.target))


class Peak(Figure):
    """Largest distance of a sample from a value.

    Attributes:
        about: the value [unit of the signal].
    """

    words: ClassVar[str] = "peak"
    dimension: ClassVar[Dimension] = Dimension.DISTANCE
    about: Level = 0.0

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float:
        return measures.peak(time, values, float(self.about))[0]


class Monotone(Block, Condition):
    """The signal only rises, or only falls.

    Attributes:
        direction: which way it goes.
        slack: how far it may go back all the same [unit of the signal].
    """

    direction: Literal["rising", "falling"]
    slack: Distance = 0.0

    def __str__(self) -> str:
        return f"is {self.direction} but for {self.slack}" if self.slack else f"is {self.direction}"

    def brought(self, place: str, port: Port, wiring: ExpectationScope) -> Monotone:
        return brought(self, place, port)

    def judged(self, time: FloatArray, values: FloatArray, hold: bool, draws: Sequence[Trace]) -> Judgement:
        back = measures.retreat(time, values, self.direction == "falling")
        return Judgement(back <= float(self.slack), f"goes back by {back:.4g}", back, float(self.slack) - back)


class Rms(Figure):
    """Root of the mean square distance from a value.

    Attributes:
        about: the value [unit of the signal].
    """

    words: ClassVar[str] = "rms"
    dimension: ClassVar[Dimension] = Dimension.DISTANCE
    about: Level = 0.0

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float:
        return measures.rms(time, values - float(self.about), hold)


class Integral(Figure):
    """An integral over the distance from a target.

    Attributes:
        target: the value from which it is taken [unit of the signal].
    """

    target: Level = 0.0


class Iae(Integral):
    """Integral of the absolute distance from the target."""

    words: ClassVar[str] = "IAE"
    dimension: ClassVar[Dimension] = Dimension.AREA

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float:
        return measures.iae(time, values - float(self.target), hold)


class Ise(Integral):
    """Integral of the squared distance from the target."""

    words: ClassVar[str] = "ISE"
    dimension: ClassVar[Dimension] = Dimension.SQUARE_AREA

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float:
        return measures.ise(time, values - float(self.target), hold)


class Itae(Integral):
    """Integral of the absolute distance from the target, weighted with the time since `after`."""

    words: ClassVar[str] = "ITAE"
    dimension: ClassVar[Dimension] = Dimension.TIME_AREA

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float:
        return measures.itae(time, values - float(self.target), hold)


class Effort(Figure):
    """Integral of the square, each sample held until the next."""

    words: ClassVar[str] = "effort"
    dimension: ClassVar[Dimension] = Dimension.SQUARE_AREA

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float:
        return measures.effort(time, values)
