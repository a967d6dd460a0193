"""The oscillation that a signal shows most, with its damping: a decaying sine, fitted to all samples.

The fit starts at peaks of the spectrum and lets Levenberg-Marquardt find frequency and decay; offset and amplitudes
follow by least squares (variable projection, Golub and Pereyra 1973). Stamps may be uneven, and noise averages out, as
it does not in a logarithmic decrement from peaks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from orchestrator.measures.samples import checked
from orchestrator.trace import FloatArray

FEWEST = 8  # samples that a fit of five numbers needs
PEAKS = 3  # of the spectrum that a fit is started from
DECAYS = (0.0, 1.0, 4.0, 12.0)  # over the whole window, that it is started from


@dataclass(frozen=True)
class Oscillation:
    """offset + amplitude exp(-decay t) cos(frequency t + phase), t from the first stamp.

    Attributes:
        frequency: at which it swings, the damped one [rad/s].
        decay: negative where it grows [1/s].
        amplitude: at the first stamp [unit].
        explained: share of the signal's variance that it explains [1].
    """

    frequency: float
    decay: float
    amplitude: float
    explained: float

    @property
    def damping(self) -> float:
        """Damping ratio [1]."""
        return self.decay / self.natural_frequency

    @property
    def natural_frequency(self) -> float:
        """That without damping [rad/s]."""
        return math.hypot(self.frequency, self.decay)


def dominant_oscillation(time: ArrayLike, values: ArrayLike) -> Oscillation | None:
    """The decaying, steady or growing sine that explains most of a signal; None where the signal is constant, or less
    than a period of it is there.

    Raises:
        TraceError: the samples are no signal, or fewer than eight.
    """
    t, y = checked(time, values, fewest=FEWEST)
    duration = float(t[-1] - t[0])
    t = (t - t[0]) / duration  # all below is in durations
    variance = float(np.mean((y - y.mean()) ** 2))
    if variance <= (1e-12 * np.max(np.abs(y))) ** 2:
        return None
    starts = [(frequency, decay) for frequency in _peaks(t, y) for decay in DECAYS]
    start = min(starts, key=lambda pair: float(np.sum(_residuals(np.array(pair), t, y) ** 2)))
    from scipy.optimize import least_squares  # noqa: PLC0415 - loads slowly

    fitted = least_squares(_residuals, start, args=(t, y), method="lm", x_scale=[1.0, 1.0])
    frequency, decay = abs(float(fitted.x[0])), float(fitted.x[1])
    if frequency < 2 * math.pi:
        return None
    weights = _weights(_design(np.array([frequency, decay]), t), y)
    amplitude = math.hypot(weights[1], weights[2]) * math.exp(min(decay, 0.0))
    explained = 1.0 - 2 * fitted.cost / len(y) / variance
    return Oscillation(frequency / duration, decay / duration, amplitude, explained)


def _peaks(t: FloatArray, y: FloatArray) -> list[float]:
    """The highest peaks of the spectrum of samples that are made even, and of their rate [rad a duration]."""
    even = np.interp(np.linspace(0.0, 1.0, len(t)), t, y)
    finer = 4  # than a bin
    size = np.abs(np.fft.rfft(even - even.mean(), finer * len(even)))
    rows: list[int] = []
    for spectrum in (size, size * np.arange(len(size))):
        peaks = np.flatnonzero((spectrum[1:-1] >= spectrum[:-2]) & (spectrum[1:-1] > spectrum[2:])) + 1
        rows += map(int, peaks[np.argsort(spectrum[peaks])[::-1][:PEAKS]])
    return [2 * math.pi * row / finer for row in dict.fromkeys(rows)] or [2 * math.pi]


def _design(shape: FloatArray, t: FloatArray) -> FloatArray:
    """(K, 3) columns 1, cos, sin, the latter two under an envelope that is 1 where it is largest."""
    frequency, decay = shape
    envelope = np.exp(-decay * (t if decay >= 0 else t - 1.0))
    return np.column_stack([np.ones_like(t), envelope * np.cos(frequency * t), envelope * np.sin(frequency * t)])


def _weights(design: FloatArray, y: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(design.T @ design, design.T @ y, rcond=1e-13)[0])


def _residuals(shape: FloatArray, t: FloatArray, y: FloatArray) -> FloatArray:
    design = _design(shape, t)
    return np.asarray(y - design @ _weights(design, y))
