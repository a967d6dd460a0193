"""Delays between a system and the recordings of it: latencies of commands and readings, and offsets of their clocks.

With a delay d of an input the plant gets at t the command of t - d; with a delay d of an output the plant's output of
t - d is recorded at t. What is known of an output corrects its stamps. What is a parameter moves the simulated output,
smoothly, as it moves commands, so that it can be estimated.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import Polynomial

from orchestrator.trace import FloatArray, ReadOnlyArrays

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

_ROUNDING = 1e-9  # of a step
_TOGETHER = 1e-9  # stamps and instants so near are one [s]


@dataclass(frozen=True)
class KnownDelay:
    """A delay that is known [s]."""

    seconds: float

    @property
    def lowest(self) -> float:
        return self.seconds

    @property
    def start(self) -> float:
        return self.seconds

    @property
    def highest(self) -> float:
        return self.seconds

    def at(self, values: Mapping[str, float]) -> float:
        """The delay [s], whatever the parameters."""
        return self.seconds


@dataclass(frozen=True)
class Estimated:
    """A delay that is a parameter: where its estimation begins and where it may lie [s]."""

    parameter: str
    start: float
    lowest: float
    highest: float

    def at(self, values: Mapping[str, float]) -> float:
        """The delay [s] with these values of the parameters."""
        return values[self.parameter]


Delay = KnownDelay | Estimated


def known(delay: Delay | None) -> float:
    """What the stamps of an output are corrected by [s]."""
    return delay.seconds if isinstance(delay, KnownDelay) else 0.0


def estimated(outputs: Iterable[Delay | None]) -> tuple[Delay | None, ...]:
    """The delays of outputs that are parameters, None for those that stamps are corrected by."""
    return tuple(delay if isinstance(delay, Estimated) else None for delay in outputs)


def compared_rows(outputs: Iterable[Delay | None], step: Fraction, count: int) -> slice:
    """Which of a free run's `count` instants are compared: those whose outputs lie within the run for every delay.

    Args:
        outputs: their delays, None where stamps are corrected.
        step: between two instants [s].
    """
    delays = [delay for delay in outputs if delay is not None]
    late = max((delay.highest for delay in delays), default=0.0)
    early = max((-delay.lowest for delay in delays), default=0.0)
    return slice(_steps(late, step), max(count - _steps(early, step), 0))


def _steps(duration: float, step: Fraction) -> int:
    """Whole steps that cover a duration [s]; none for a negative one."""
    return max(0, math.ceil(duration / float(step) - _ROUNDING))


@dataclass(frozen=True, eq=False)
class HeldCommand(ReadOnlyArrays):
    """A command that keeps the value of each sample until the next; before the first stamp it has the first value.

    Attributes:
        time: (K,) stamps [s].
        values: (K,) samples.
    """

    time: FloatArray
    values: FloatArray

    def at(self, instants: FloatArray) -> FloatArray:
        """(N,) what it is at these instants [s], to a billionth of a second."""
        rows = np.searchsorted(self.time, instants + _TOGETHER, side="right") - 1
        return np.asarray(self.values[np.clip(rows, 0, None)])

    def between(self, start: float, stop: float) -> HeldCommand:
        """The part that says what it is from start to stop [s]."""
        first = max(int(np.searchsorted(self.time, start, side="right")) - 1, 0)
        last = max(int(np.searchsorted(self.time, stop, side="right")), first + 1)
        return HeldCommand(self.time[first:last], self.values[first:last])

    def means(self, edges: FloatArray) -> FloatArray:
        """(N,) exact means between N + 1 rising edges [s]."""
        return np.asarray(np.diff(self._integral(edges)) / np.diff(edges))

    def _integral(self, instants: FloatArray) -> FloatArray:
        """(N,) integral from the first stamp to these instants."""
        known = np.concatenate([[0.0], np.cumsum(self.values[:-1] * np.diff(self.time))])
        rows = np.clip(np.searchsorted(self.time, instants, side="right") - 1, 0, len(self.time) - 1)
        return np.asarray(known[rows] + self.values[rows] * (instants - self.time[rows]))


class LinearCommand(HeldCommand):
    """A command that goes in lines from sample to sample; before the first and after the last it has their values."""

    def at(self, instants: FloatArray) -> FloatArray:
        return np.asarray(np.interp(instants, self.time, self.values))

    def between(self, start: float, stop: float) -> LinearCommand:
        first = max(int(np.searchsorted(self.time, start, side="right")) - 1, 0)
        last = max(int(np.searchsorted(self.time, stop)) + 1, first + 1)
        return LinearCommand(self.time[first:last], self.values[first:last])

    def _integral(self, instants: FloatArray) -> FloatArray:
        time, values = self.time, self.values
        known = np.concatenate([[0.0], np.cumsum((values[:-1] + values[1:]) / 2 * np.diff(time))])
        rows = np.clip(np.searchsorted(time, instants, side="right") - 1, 0, len(time) - 1)
        return np.asarray(known[rows] + (values[rows] + self.at(instants)) / 2 * (instants - time[rows]))


@dataclass(frozen=True, eq=False)
class Command:
    """A recorded command that reaches an input by its mean over each step, with a delay where it has one.

    Attributes:
        stepwise: whether the input has no values between those of the command, so that means would be none of it.
    """

    delay: Delay
    held: HeldCommand
    stepwise: bool = False

    def values(self, instants: FloatArray, delay: float) -> FloatArray:
        """(K,) what the input gets from each of these even instants to the next, by its mean [s]; stepwise, what it
        is at the instant."""
        if self.stepwise:
            return self.held.at(instants - delay)
        step = (instants[-1] - instants[0]) / (len(instants) - 1)
        return self.held.means(np.append(instants, instants[-1] + step) - delay)


@dataclass(frozen=True, eq=False)
class StartReading:
    """A start value that is read off a signal with a delay.

    Attributes:
        curve: the value over the time of the signal.
        at: where the window begins [s].
    """

    delay: Delay
    curve: Polynomial
    at: float

    def value(self, delay: float) -> float:
        """The start value: what the signal shows `delay` [s] after the window's beginning."""
        return float(self.curve(self.at + delay))


def late_outputs(
    simulated: FloatArray,
    step: float,
    delays: Sequence[float | None],
    instants: FloatArray,
    stepwise: Collection[int] = (),
) -> FloatArray:
    """(K', m) what is recorded of outputs (K, m) at these instants (K',) [steps], each by its delay [s].

    Between the instants of the free run an output is the cubic through its values, with central differences as
    slopes: exact for parabolas. An output without a delay (None) is taken as it is.

    Args:
        stepwise: outputs that keep their value until the next instant, where they are not delayed by a parameter.
    """
    time = np.asarray(np.arange(len(simulated)) * step, dtype=float)
    rows = np.floor(instants).astype(np.int64)
    whole = np.array_equal(rows, instants)
    columns = [
        simulated[rows, i]
        if delay is None and (whole or i in stepwise)
        else _curve(time, simulated[:, i])(instants * step - (delay or 0.0))
        for i, delay in enumerate(delays)
    ]
    return np.column_stack(columns)


def _curve(time: FloatArray, values: FloatArray) -> CubicHermiteSpline:
    from scipy.interpolate import CubicHermiteSpline  # noqa: PLC0415 - loads slowly

    slopes = np.gradient(values, time, edge_order=2 if len(time) > 2 else 1)
    return CubicHermiteSpline(time, values, slopes)
