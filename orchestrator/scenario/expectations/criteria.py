"""Integral criteria of a signal: of its error, its amount and its effort."""

from __future__ import annotations

from typing import ClassVar

from orchestrator import measures
from orchestrator.scenario.expectations.figure import Figure
from orchestrator.scenario.expectations.quantities import Dimension, Level
from orchestrator.trace import FloatArray


class Rms(Figure):
    """Root of the mean square distance from a value."""

    words: ClassVar[str] = "rms"
    dimension: ClassVar[Dimension] = Dimension.DISTANCE
    about: Level = 0.0

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float:
        return measures.rms(time, values - float(self.about), hold)


class Iae(Figure):
    """Integral of the absolute distance from the target."""

    words: ClassVar[str] = "IAE"
    dimension: ClassVar[Dimension] = Dimension.AREA
    target: Level = 0.0

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float:
        return measures.iae(time, values - float(self.target), hold)


class Ise(Figure):
    """Integral of the squared distance from the target."""

    words: ClassVar[str] = "ISE"
    dimension: ClassVar[Dimension] = Dimension.SQUARE_AREA
    target: Level = 0.0

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float:
        return measures.ise(time, values - float(self.target), hold)


class Itae(Figure):
    """Integral of the absolute distance from the target, weighted with the time since `after`."""

    words: ClassVar[str] = "ITAE"
    dimension: ClassVar[Dimension] = Dimension.TIME_AREA
    target: Level = 0.0

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float:
        return measures.itae(time, values - float(self.target), hold)


class Effort(Figure):
    """Integral of the square, each sample held until the next."""

    words: ClassVar[str] = "effort"
    dimension: ClassVar[Dimension] = Dimension.SQUARE_AREA

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float:
        return measures.effort(time, values)
