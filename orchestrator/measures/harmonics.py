"""How much of a periodic signal is not its fundamental.

Amplitudes are those of the sines that fit the samples best, together with a mean: no window, no whole number of periods
and no even stamps are needed. Source: the definition of THD in IEC 61000-4-7, relative to the fundamental.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from fmus.errors import TraceError
from orchestrator.measures.samples import checked
from orchestrator.trace import FloatArray

MOST = 40  # harmonics, as the standard counts them
ROWS = 8192  # samples at a time, so that long signals take no memory


def harmonic_amplitudes(time: ArrayLike, values: ArrayLike, frequency: float, count: int) -> FloatArray:
    """(count,) amplitudes of the sines of 1, 2, ... times the frequency [unit].

    Args:
        frequency: of the fundamental [rad/s].

    Raises:
        TraceError: the samples are no signal, last less than a period, or are too sparse for the highest harmonic.
    """
    t, y = checked(time, values, fewest=2)
    if frequency * (t[-1] - t[0]) < 2 * math.pi * (1 - 1e-9):
        raise TraceError("harmonics", f"{t[-1] - t[0]:g} s hold less than a period", "widen the window")
    if not 0 < count <= _below_nyquist(t, frequency):
        raise TraceError("harmonics", f"there are {_below_nyquist(t, frequency)} below half the sampling rate")
    order = frequency * np.arange(1, count + 1)
    normal, right = np.zeros((2 * count + 1, 2 * count + 1)), np.zeros(2 * count + 1)
    for first in range(0, len(t), ROWS):
        angle = np.outer(t[first : first + ROWS] - t[0], order)
        design = np.column_stack([np.ones(len(angle)), np.cos(angle), np.sin(angle)])
        normal += design.T @ design
        right += design.T @ y[first : first + ROWS]
    if np.linalg.cond(normal) > 1e10:
        raise TraceError("harmonics", f"{len(t)} samples do not tell {count} apart", "widen the window")
    weights = np.linalg.solve(normal, right)
    return np.asarray(np.hypot(weights[1 : count + 1], weights[count + 1 :]))


def total_harmonic_distortion(time: ArrayLike, values: ArrayLike, frequency: float, count: int | None = None) -> float:
    """Root of the sum of the squared amplitudes of the harmonics 2, 3, ..., `count` over that of the fundamental [1].

    Args:
        frequency: of the fundamental [rad/s].
        count: by default 40, or as many as lie below half the mean sampling rate.

    Raises:
        TraceError: as `harmonic_amplitudes`, or there is no fundamental.
    """
    t, y = checked(time, values, fewest=2)
    highest = min(MOST, _below_nyquist(t, frequency)) if count is None else count
    first, *others = harmonic_amplitudes(t, y, frequency, highest)
    if first <= 1e-12 * np.max(np.abs(y)):
        raise TraceError("harmonics", f"there is no fundamental of {frequency:g} rad/s", "check the frequency")
    return math.hypot(*others) / float(first)


def _below_nyquist(t: FloatArray, frequency: float) -> int:
    """How many harmonics lie below half the mean sampling rate."""
    highest = math.pi * (len(t) - 1) / float(t[-1] - t[0])
    return math.ceil(highest / frequency * (1 - 1e-9)) - 1 if frequency > 0 else 0
