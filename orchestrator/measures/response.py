"""What is read off a response to a step: where it ends, how fast, how far beyond, and what is left.

Levels are met on the line between two samples, so that a figure does not jump by a sampling period; with `hold` they
are met at the sample that first has them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fmus.errors import TraceError
from orchestrator.measures.integrals import mean, rms
from orchestrator.measures.samples import checked, meets
from orchestrator.trace import FloatArray


def final_value(time: ArrayLike, values: ArrayLike, over: float = 0.0, hold: bool = False) -> float:
    """Mean over the last `over` seconds [unit]; with 0 the last sample.

    Raises:
        TraceError: the samples are no signal, so with the others; `over` is longer than they last.
    """
    t, y = checked(time, values)
    begin = t[-1] - over
    if begin < t[0] - 1e-9 * max(1.0, float(t[-1] - t[0])) or over < 0:
        raise TraceError("final value", f"is to be taken over {over:g} s of {t[-1] - t[0]:g} s", "shorten it")
    if over == 0:
        return float(y[-1])
    return mean(*_since(t, y, begin, hold), hold)


def steady_error(time: ArrayLike, values: ArrayLike, target: float, over: float = 0.0, hold: bool = False) -> float:
    """Final value less the target [unit]: positive where it ends beyond a target that is above."""
    return final_value(time, values, over, hold) - target


def settling_time(time: ArrayLike, values: ArrayLike, target: float, band: float, hold: bool = False) -> float | None:
    """Time from the first stamp until the signal stays within `band` of the target to its end [s]; None where it never
    does.

    Args:
        band: half the width of the band [unit], 2 % of the step, say.
    """
    t, y = checked(time, values)
    outside = np.flatnonzero(np.abs(y - target) > band)
    if not len(outside):
        return 0.0
    last = int(outside[-1])
    if last == len(t) - 1:
        return None
    edge = target + np.copysign(band, y[last] - target)
    return float((t[last + 1] if hold else meets(t, y, last, edge)) - t[0])


def rise_time(
    time: ArrayLike,
    values: ArrayLike,
    start: float,
    target: float,
    low: float = 0.1,
    high: float = 0.9,
    hold: bool = False,
) -> float | None:
    """Time from when the signal first has gone `low` of the way from start to target until it has gone `high` [s]; None
    where it does not get so far.

    Raises:
        TraceError: start and target are one.
    """
    t, y = checked(time, values)
    way = _way(y, start, target)
    first, last = _reaches(t, way, low, hold), _reaches(t, way, high, hold)
    return None if first is None or last is None else last - first


def overshoot(time: ArrayLike, values: ArrayLike, start: float, target: float) -> float:
    """How far the signal goes beyond the target, as a share of the way from start to target [1]; 0 where it does not.

    Raises:
        TraceError: start and target are one.
    """
    _, y = checked(time, values)
    return max(float(np.max(_way(y, start, target))) - 1.0, 0.0)


def peak(time: ArrayLike, values: ArrayLike, about: float = 0.0) -> tuple[float, float]:
    """Largest distance of a sample from `about` [unit], and when after the first stamp it comes first [s]."""
    t, y = checked(time, values)
    distance = np.abs(y - about)
    row = int(np.argmax(distance))
    return float(distance[row]), float(t[row] - t[0])


def residual_rms(time: ArrayLike, values: ArrayLike, target: float, band: float, hold: bool = False) -> float | None:
    """Root of the mean square distance from the target from the settling on [unit]; None where it never settles."""
    t, y = checked(time, values)
    settled = settling_time(t, y, target, band, hold)
    if settled is None:
        return None
    return rms(*_since(t, y - target, t[0] + settled, hold), hold)


def _since(t: FloatArray, y: FloatArray, begin: float, hold: bool) -> tuple[FloatArray, FloatArray]:
    """Stamps and samples from a time on, which has a sample of its own."""
    first = int(np.searchsorted(t, begin, side="right"))
    at_begin = y[max(first - 1, 0)] if hold else np.interp(begin, t, y)
    return np.append(begin, t[first:]), np.append(at_begin, y[first:])


def retreat(time: ArrayLike, values: ArrayLike, falling: bool = False) -> float:
    """How far the signal goes back below the largest value that it has had [unit], or above the smallest where it is to
    be `falling`; 0 for a monotone one."""
    _, y = checked(time, values)
    rising = -y if falling else y
    return float(np.max(np.maximum.accumulate(rising) - rising))


def _way(y: FloatArray, start: float, target: float) -> FloatArray:
    """Shares of the way from start to target."""
    if start == target:
        raise TraceError("response", f"starts at its target, {target:g}", "give another start or target")
    return np.asarray((y - start) / (target - start))


def _reaches(t: FloatArray, way: FloatArray, level: float, hold: bool) -> float | None:
    """When a signal first has this level or more [s]; None where it never does."""
    rows = np.flatnonzero(way >= level)
    if not len(rows):
        return None
    row = int(rows[0])
    return float(t[row]) if hold or row == 0 else meets(t, way, row - 1, level)
