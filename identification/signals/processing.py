"""What is done to a recording before anything is estimated from it: sampling, windows, filters, spectra.

Functions whose name ends in `_as_published` follow the pendulum thesis (Angelchev Shiryaev 2024) to the
letter, slips included, so that its tables can be reproduced; the others are the ones to use.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fmus.errors import IdentificationError, TraceError
from orchestrator.trace import ComplexArray, FloatArray, Trace


def mean_step(time: FloatArray) -> float:
    """Mean distance of the stamps `time` (K,) [s]."""
    return float((time[-1] - time[0]) / (len(time) - 1))


def resampled_evenly(trace: Trace, period: float | None = None) -> Trace:
    """The trace on an even grid from its first stamp, by linear interpolation.

    Args:
        period: distance of the new stamps [s]; the mean step of the recording when None (as published, Eq.
            25).

    Raises:
        TraceError: fewer than two samples, or the period is not positive or longer than the recording.
    """
    if len(trace) < 2:
        raise TraceError(trace.name, f"holds {len(trace)} samples", "resampling needs at least two")
    if period is None:
        period, steps = mean_step(trace.time), len(trace) - 1
    elif 0 < period <= trace.duration:
        steps = int(np.floor(trace.duration / period * (1 + 1e-12) + 1e-9))
    else:
        raise TraceError(trace.name, f"cannot be resampled every {period:g} s over {trace.duration:g} s")
    return trace.resampled(trace.time[0] + period * np.arange(steps + 1))


def decimated(trace: Trace, factor: int) -> Trace:
    """Every `factor`-th sample from the first, without an anti-aliasing filter (as published)."""
    if factor < 1:
        raise TraceError(trace.name, f"cannot be decimated by {factor}", "give a factor of 1 or more")
    signals = {name: values[::factor] for name, values in trace.signals.items()}
    return Trace(trace.time[::factor], signals, trace.units, trace.name)


def last_seconds(trace: Trace, duration: float) -> Trace:
    """The last `duration` [s] of the trace, the transient before it removed.

    Raises:
        TraceError: the recording is shorter than that.
    """
    if not 0 < duration <= trace.duration * (1 + 1e-9):
        raise TraceError(
            trace.name,
            f"lasts {trace.duration:g} s, the last {duration:g} s were asked for",
            "shorten the window",
        )
    stop = float(trace.time[-1])
    return trace.between(stop - duration - 1e-9 * max(1.0, abs(stop)), stop)


def mid_range(values: FloatArray) -> float:
    """Half-way between the extremes: the centre as published, moved by a single outlier."""
    return float((values.max() + values.min()) / 2)


def detrended(values: ArrayLike, degree: int = 0) -> FloatArray:
    """`values` (K,) less their mean (degree 0) or their least-squares line or polynomial over the index."""
    samples = np.asarray(values, dtype=float)
    index = np.linspace(-1, 1, len(samples))
    return samples - np.polynomial.polynomial.polyval(index, np.polynomial.polynomial.polyfit(index, samples, degree))


def dft(values: ArrayLike) -> ComplexArray:
    """W_k for k = 1..N of `values` (N,): the discrete Fourier transform with factor 1/sqrt(N) (Eq. 27).

    The samples count from 1, so W_k is NumPy's transform times exp(-j 2 pi k / N); the mean is the last
    element.
    """
    samples = np.asarray(values, dtype=float)
    k = np.arange(1, len(samples) + 1)
    turned = np.fft.fft(samples)[k % len(samples)] * np.exp(-2j * np.pi * k / len(samples))
    return np.asarray(turned / np.sqrt(len(samples)))


def periodogram(values: ArrayLike) -> FloatArray:
    """|W_k|^2 for k = 1..N (Eq. 28); a sine of amplitude A on a bin gives N A^2 / 4 there (Eq. 33)."""
    return np.abs(dft(values)) ** 2


def dft_frequencies(count: int, period: float) -> FloatArray:
    """Frequencies 2 pi k / (N period), k = 1..N [rad/s], that belong to `dft` and `periodogram` (Eq. 26)."""
    return np.arange(1.0, count + 1) * (2 * np.pi / (count * period))


def dominant_frequency(values: ArrayLike, period: float) -> float:
    """Frequency [rad/s] of the periodogram's largest peak below Nyquist; resolution 2 pi / (N period)."""
    power = periodogram(detrended(values))[: len(np.asarray(values)) // 2]
    return float(dft_frequencies(len(np.asarray(values)), period)[np.argmax(power)])


def dominant_frequency_as_published(values: ArrayLike, period: float) -> float:
    """Frequency [rad/s] of the largest peak as the thesis' scripts read it: N/(N - 1) times too high.

    They drop the mean from the transform and then scale the axis with the number of elements left.
    """
    power = np.abs(np.fft.fft(np.asarray(values, dtype=float))[1:]) ** 2
    left = len(power)
    return float(2 * np.pi * (1 + np.argmax(power[: left // 2])) / (left * period))


def low_pass(values: ArrayLike, period: float, cutoff: float, causal: bool = False) -> FloatArray:
    """`values` (K,) or (K, m) through a Butterworth low-pass of second order, forwards and backwards: no phase shift.

    Args:
        period: sampling period [s].
        cutoff: corner frequency [Hz]; the two passes together take 6 dB there.
        causal: forwards only, from rest at the first sample: 3 dB at the corner, and the filter's lag. Inputs and
            outputs of a model must then be filtered alike, or the lag becomes part of the model.

    Raises:
        IdentificationError: the corner is not below half the sampling rate, or there are too few samples.
    """
    samples = np.asarray(values, dtype=float)
    if not 0 < cutoff < 0.5 / period:
        raise IdentificationError(
            "low_pass",
            f"a corner at {cutoff:g} Hz cannot be had at {1 / period:g} Hz",
            "keep it below half the rate",
        )
    from scipy import signal  # noqa: PLC0415 - loads slowly

    sections = signal.butter(2, cutoff, fs=1 / period, output="sos")
    if len(samples) <= 3 * (2 * len(sections) + 1):
        raise IdentificationError("low_pass", f"{len(samples)} samples are too few", "give a longer signal")
    if not causal:
        return np.asarray(signal.sosfiltfilt(sections, samples, axis=0))
    return np.asarray(signal.sosfilt(sections, samples - samples[0], axis=0) + samples[0])


def differentiate(values: ArrayLike, period: float, half_width: int = 5, degree: int = 3, order: int = 1) -> FloatArray:
    """Derivative [unit / s^order] of evenly sampled `values` (K,) or (K, m), by Savitzky-Golay polynomials.

    Args:
        period: sampling period [s].
        half_width: samples on either side that a polynomial is fitted to; more smooths more.
        degree: of the polynomials; polynomials up to it are differentiated exactly.
        order: 1 for speed, 2 for acceleration.

    Raises:
        IdentificationError: fewer samples than a window, or a window that does not determine the polynomial.
    """
    samples = np.asarray(values, dtype=float)
    window = 2 * half_width + 1
    if not order <= degree < window <= len(samples):
        raise IdentificationError(
            "differentiate",
            f"{window} of {len(samples)} samples cannot carry degree {degree} and derivative {order}",
            "keep order <= degree < window <= samples",
        )
    from scipy.signal import savgol_filter  # noqa: PLC0415 - loads slowly

    return np.asarray(savgol_filter(samples, window, degree, deriv=order, delta=period, axis=0))
