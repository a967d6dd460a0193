"""Whether a signal oscillates for good, and how: the cycle that friction, backlash or quantisation leave a loop in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from orchestrator.measures.events import crossings
from orchestrator.measures.samples import checked
from orchestrator.trace import FloatArray

FEWEST = 3  # cycles that show a steady one
BEYOND = 0.2  # of the range, that a cycle goes beyond its middle; what is less is noise on it
ROUNDING = 1e-9  # of the largest value: smaller amplitudes are none


@dataclass(frozen=True)
class SteadyOscillation:
    """An oscillation that neither decays nor grows.

    Attributes:
        amplitude: half of its range, the median of its cycles [unit].
        period: mean [s].
        cycles: whole ones in the window.
    """

    amplitude: float
    period: float
    cycles: int


def limit_cycle(time: ArrayLike, values: ArrayLike, steady: float = 0.1) -> SteadyOscillation | None:
    """The steady oscillation in a window that begins after the transient; None where there is none.

    A cycle lasts from one passage upwards through the middle of the range to the next. There must be three or more,
    from begin to end of the window, whose amplitude drifts by no more than a share `steady` in all, and whose periods
    differ by no more than that.

    Raises:
        TraceError: the samples are no signal.
    """
    t, y = checked(time, values)
    low, high = float(y.min()), float(y.max())
    if high - low <= ROUNDING * max(abs(low), abs(high)):
        return None
    up = crossings(t, y, (low + high) / 2, "up", BEYOND * (high - low))
    if len(up) <= FEWEST:
        return None
    periods = np.diff(up)
    period = float(periods.mean())
    amplitudes = _amplitudes(t, y, up)
    throughout = max(up[0] - t[0], t[-1] - up[-1]) <= (1 + steady) * period
    if not throughout or np.ptp(periods) > steady * period or _drift(amplitudes) > steady:
        return None
    return SteadyOscillation(float(np.median(amplitudes)), period, len(periods))


def _amplitudes(t: FloatArray, y: FloatArray, up: FloatArray) -> FloatArray:
    """(n,) half the range of each cycle."""
    rows = np.searchsorted(t, up)
    highest = np.maximum.reduceat(y[: rows[-1]], rows[:-1])
    lowest = np.minimum.reduceat(y[: rows[-1]], rows[:-1])
    return np.asarray((highest - lowest) / 2)


def _drift(amplitudes: FloatArray) -> float:
    """By what share of their mean amplitudes (n,) change from the first to the last, along the line that fits them."""
    slope = np.polyfit(np.arange(len(amplitudes)), amplitudes, 1)[0]
    return float(abs(slope) * (len(amplitudes) - 1) / amplitudes.mean())
