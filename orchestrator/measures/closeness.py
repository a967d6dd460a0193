"""How close a signal comes to a reference at the same stamps: figures over the whole of both.

Means are over time, of the lines (or with `hold` the steps) through both, so that uneven stamps count by how long they
last.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fmus.errors import TraceError
from orchestrator.measures.integrals import mean, rms
from orchestrator.measures.samples import checked
from orchestrator.trace import FloatArray


def nrmse(time: ArrayLike, values: ArrayLike, reference: ArrayLike, hold: bool = False) -> float:
    """Root of the mean square deviation over the range of the reference [1].

    Raises:
        TraceError: signal or reference are no samples of one length, so with the others; the reference is constant.
    """
    t, y, r = _pair(time, values, reference)
    return rms(t, y - r, hold) / _or_constant(float(np.ptp(r)), "NRMSE")


def fit(time: ArrayLike, values: ArrayLike, reference: ArrayLike, hold: bool = False) -> float:
    """FIT = 1 - |y - r| / |r - mean r| [1]: 1 is perfect, 0 no better than the reference's mean.

    Raises:
        TraceError: the reference is constant, too.
    """
    t, y, r = _pair(time, values, reference)
    return 1.0 - rms(t, y - r, hold) / _or_constant(rms(t, r - mean(t, r, hold), hold), "FIT")


def largest_deviation(time: ArrayLike, values: ArrayLike, reference: ArrayLike) -> tuple[float, float]:
    """Largest distance of a sample from the reference [unit], and its stamp [s]."""
    t, y, r = _pair(time, values, reference)
    deviation = np.abs(y - r)
    row = int(np.argmax(deviation))
    return float(deviation[row]), float(t[row])


def correlation_lag(time: ArrayLike, values: ArrayLike, reference: ArrayLike) -> tuple[float, float]:
    """By how much the signal comes after the reference [s], negative where it comes before, and how well the two then
    correlate [1].

    Of all shifts by up to half of the time, the one with the largest correlation coefficient of what then overlaps; a
    parabola through its neighbours tells it more finely than by samples, which are made even for that.

    Raises:
        TraceError: there are fewer than eight samples, or signal or reference are constant.
    """
    t, y, r = _pair(time, values, reference, fewest=8)
    even = np.linspace(t[0], t[-1], len(t))
    y, r = np.interp(even, t, y), np.interp(even, t, r)
    coefficients = _correlations(
        (y - y.mean()) / _or_constant(float(y.std()), "correlation"),
        (r - r.mean()) / _or_constant(float(r.std()), "correlation"),
    )
    row = int(np.argmax(coefficients))
    shift = float(row - len(t) // 2)
    if 0 < row < len(coefficients) - 1:
        before, here, after = coefficients[row - 1 : row + 2]
        bend = before - 2 * here + after
        shift += 0.5 * (before - after) / bend if bend < 0 else 0.0
    return shift * float(even[1] - even[0]), float(coefficients[row])


def _pair(
    time: ArrayLike, values: ArrayLike, reference: ArrayLike, fewest: int = 2
) -> tuple[FloatArray, FloatArray, FloatArray]:
    t, y = checked(time, values, fewest)
    return t, y, checked(t, reference)[1]


def _or_constant(spread: float, figure: str) -> float:
    """The spread, unless there is none."""
    if spread <= 0:
        raise TraceError(figure, "there is none: a signal is constant", "ask for the largest deviation instead")
    return spread


def _correlations(y: FloatArray, r: FloatArray) -> FloatArray:
    """(2 n + 1,) correlation coefficients of what overlaps, y taken n = K // 2 samples earlier, ..., n later."""
    from scipy.signal import correlate  # noqa: PLC0415 - loads slowly

    count, most = len(y), len(y) // 2
    shifts = np.arange(-most, most + 1)
    products = correlate(y, r, mode="full", method="fft")[count - 1 + shifts]
    overlap = count - np.abs(shifts)
    of_y = np.where(shifts >= 0, shifts, 0)
    of_r = np.where(shifts < 0, -shifts, 0)
    sum_y, square_y = _sums(y, of_y, overlap), _sums(y**2, of_y, overlap)
    sum_r, square_r = _sums(r, of_r, overlap), _sums(r**2, of_r, overlap)
    covariance = products - sum_y * sum_r / overlap
    spread = np.maximum(square_y - sum_y**2 / overlap, 0.0) * np.maximum(square_r - sum_r**2 / overlap, 0.0)
    sure = spread > (1e-9 * count) ** 2
    return np.where(sure, covariance / np.sqrt(np.where(sure, spread, 1.0)), -1.0)


def _sums(values: FloatArray, first: np.ndarray, count: np.ndarray) -> FloatArray:
    """Sums of so many values from these rows on."""
    summed = np.append(0.0, np.cumsum(values))
    return np.asarray(summed[first + count] - summed[first])
