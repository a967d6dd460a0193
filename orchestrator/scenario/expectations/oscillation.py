"""How a signal oscillates: at which frequency, how damped, for good, and how purely."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Self

from pydantic import Field, model_validator

from orchestrator import measures
from orchestrator.fmi.interface import Port
from orchestrator.scenario.expectations.base import Condition, ExpectationScope, Judgement
from orchestrator.scenario.expectations.figure import Figure, FigureBounds, shown
from orchestrator.scenario.expectations.quantities import Dimension, Distance, Frequency, Share, brought
from orchestrator.trace import FloatArray, Trace
from orchestrator.yaml_file import Block


class OscillationFigure(Figure):
    """A figure of the dominant oscillation, a decaying sine.

    Attributes:
        explains: share of the signal's variance that it has to explain to be one.
    """

    explains: Share = Field(0.5, ge=0, le=1)

    def oscillation(self, time: FloatArray, values: FloatArray) -> measures.Oscillation | None:
        """The oscillation; None where there is none that explains so much."""
        found = measures.dominant_oscillation(time, values)
        return None if found is None or found.explained < self.explains else found


class DominantFrequency(OscillationFigure):
    """Frequency of the dominant oscillation, the damped one: in rad/s, or with its unit, `2 Hz`."""

    words: ClassVar[str] = "dominant frequency"
    dimension: ClassVar[Dimension] = Dimension.FREQUENCY

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float | None:
        found = self.oscillation(time, values)
        return None if found is None else found.frequency


class Damping(OscillationFigure):
    """Damping ratio of the dominant oscillation; negative where it grows."""

    words: ClassVar[str] = "damping"
    dimension: ClassVar[Dimension] = Dimension.SHARE
    lowest: ClassVar[float] = -1.0

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float | None:
        found = self.oscillation(time, values)
        return None if found is None else found.damping


class Distortion(Figure):
    """Total harmonic distortion, relative to the fundamental.

    Attributes:
        frequency: of the fundamental [rad/s]; by default the dominant one.
        harmonics: up to which; by default 40, or as many as the samples tell.
    """

    words: ClassVar[str] = "distortion"
    dimension: ClassVar[Dimension] = Dimension.SHARE
    frequency: Frequency | None = None
    harmonics: int | None = Field(None, ge=2)

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float | None:
        frequency = self.frequency
        if frequency is None:
            found = measures.dominant_oscillation(time, values)
            if found is None:
                return None
            frequency = found.frequency
        return measures.total_harmonic_distortion(time, values, frequency, self.harmonics)


class LimitCycle(Block, Condition):
    """The signal ends in a steady oscillation of such amplitude and period, or in none.

    Attributes:
        amplitude: half of its range [unit of the signal].
        period: from one turn to the next like it [s].
        none_above: instead, the largest amplitude at which a steady oscillation is none [unit of the signal].
        steady: share by which amplitudes may drift, and periods differ.
    """

    amplitude: FigureBounds | None = None
    period: FigureBounds | None = None
    none_above: Distance | None = None
    steady: Share = Field(0.1, gt=0, lt=1)

    @model_validator(mode="after")
    def _one_question(self) -> Self:
        if (self.none_above is None) == (self.amplitude is None and self.period is None):
            raise ValueError("give `amplitude` or `period` or both, or else `none_above`")
        return self

    def __str__(self) -> str:
        if self.none_above is not None:
            return f"has no limit cycle{f' of more than {shown(self.none_above)}' if self.none_above else ''}"
        parts = [] if self.amplitude is None else [f"an amplitude of {self.amplitude.asked(Dimension.DISTANCE)}"]
        parts += [] if self.period is None else [f"a period of {self.period.asked(Dimension.TIME)}"]
        return f"has a limit cycle with {' and '.join(parts)}"

    def brought(self, place: str, port: Port, wiring: ExpectationScope) -> Self:
        amplitude = self.amplitude and self.amplitude.bounds_in(place, Dimension.DISTANCE, port)
        period = self.period and self.period.bounds_in(place, Dimension.TIME)
        return brought(self, place, port).model_copy(update={"amplitude": amplitude, "period": period})

    def judged(self, time: FloatArray, values: FloatArray, hold: bool, draws: Sequence[Trace]) -> Judgement:
        found = measures.limit_cycle(time, values, self.steady)
        if self.none_above is not None:
            amplitude, most = 0.0 if found is None else found.amplitude, float(self.none_above)
            return Judgement(amplitude <= most, f"amplitude {amplitude:.4g}", amplitude, most - amplitude)
        if found is None:
            return Judgement(False, "no limit cycle")
        answers = [
            bounds.judgement(words, figure, dimension)
            for bounds, words, figure, dimension in (
                (self.amplitude, "amplitude", found.amplitude, Dimension.DISTANCE),
                (self.period, "period", found.period, Dimension.TIME),
            )
            if bounds is not None
        ]
        return next((answer for answer in answers if not answer.held), answers[0])
