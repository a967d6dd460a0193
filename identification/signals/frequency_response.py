"""Amplitudes of sinusoids in recordings, and the frequency response they give (pendulum thesis, Step 3).

The least-squares sine fit is the estimator to use: it needs no even sampling, leaves offset and free decay
out, and says how uncertain it is. Eqs. 68 and 71 are here as the thesis has them.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fmus.errors import IdentificationError
from identification.estimation.estimated_value import propagated
from orchestrator.trace import FloatArray, Trace

REFINEMENTS = 50  # Gauss-Newton steps allowed for the frequency


@dataclass(frozen=True)
class FreeDecay:
    """A transient exp(-rate t) cos(frequency t + any phase) that may ride on a steady state.

    Attributes:
        rate: [1/s].
        frequency: [rad/s].
    """

    rate: float
    frequency: float


@dataclass(frozen=True)
class SineFit:
    """offset + amplitude sin(frequency t + phase), fitted by least squares.

    Standard errors assume residuals that are independent from sample to sample; with slow disturbances they
    are too small.

    Attributes:
        amplitude, offset, residual_std: in the unit of the samples; amplitude >= 0.
        phase: at t = 0 of the stamps, in (-pi, pi] [rad].
        frequency: given or refined [rad/s]; `frequency_std` is 0 when it was given.
    """

    frequency: float
    amplitude: float
    phase: float
    offset: float
    amplitude_std: float
    phase_std: float
    offset_std: float
    frequency_std: float
    residual_std: float

    def __call__(self, time: ArrayLike) -> FloatArray:
        """The fitted steady state at `time` [s]."""
        return self.offset + self.amplitude * np.sin(self.frequency * np.asarray(time) + self.phase)


def fit_sine(
    time: ArrayLike,
    values: ArrayLike,
    frequency: float,
    *,
    refine: bool = False,
    decay: FreeDecay | None = None,
) -> SineFit:
    """The sine of this frequency that fits `values` (K,) at the stamps `time` (K,) [s] best.

    Args:
        frequency: [rad/s].
        refine: let Gauss-Newton improve the frequency too; it must be right to within about half a bin, pi /
            T.
        decay: fit this transient along and leave it out of the result.

    Raises:
        IdentificationError: less than one period, stamps that do not tell the terms apart, too few samples,
            or a refinement that does not settle.
    """
    stamps, samples = np.asarray(time, dtype=float), np.asarray(values, dtype=float)
    _check(stamps, samples, frequency)
    middle = float(stamps.mean())
    centred = stamps - middle
    if refine:
        frequency = _refined(centred, samples, frequency, decay)
    design = _design(centred, frequency, decay)
    weights, covariance, residual_std = _least_squares(design, samples, int(refine))
    if refine:
        slope = _slope(centred, frequency, weights)
        _, covariance, _ = _least_squares(np.column_stack([design, slope]), samples, 0)
    fitted = _sine_fit(weights, covariance, frequency, middle, refined=refine)
    return SineFit(**fitted, residual_std=residual_std)


def _check(stamps: FloatArray, samples: FloatArray, frequency: float) -> None:
    if stamps.shape != samples.shape or stamps.ndim != 1:
        raise IdentificationError("sine fit", f"{stamps.shape} stamps for {samples.shape} samples")
    if not np.all(np.isfinite(samples)):
        raise IdentificationError("sine fit", "a sample is not finite", "repair or cut the recording")
    if not (frequency > 0 and len(stamps) > 1 and np.ptp(stamps) * frequency >= 2 * math.pi * (1 - 1e-9)):
        raise IdentificationError(
            "sine fit",
            f"the recording holds less than one period of {frequency:g} rad/s",
            "record for longer",
        )


def _design(time: FloatArray, frequency: float, decay: FreeDecay | None) -> FloatArray:
    """(K, 3) columns sin, cos, 1, and two more for a decay."""
    columns = [np.sin(frequency * time), np.cos(frequency * time), np.ones_like(time)]
    if decay is not None:
        envelope = np.exp(-decay.rate * (time - time[0]))
        columns += [envelope * np.sin(decay.frequency * time), envelope * np.cos(decay.frequency * time)]
    return np.column_stack(columns)


def _slope(time: FloatArray, frequency: float, weights: FloatArray) -> FloatArray:
    """(K,) derivative of the fitted sine with respect to the frequency."""
    return np.asarray(time * (weights[0] * np.cos(frequency * time) - weights[1] * np.sin(frequency * time)))


def _least_squares(design: FloatArray, samples: FloatArray, more: int) -> tuple[FloatArray, FloatArray, float]:
    """Weights (n,), their covariance (n, n) and the residuals' std; `more` parameters were fitted besides."""
    dof = len(samples) - design.shape[1] - more
    solution, _, rank, _ = np.linalg.lstsq(design, samples, rcond=1e-9)
    weights = np.asarray(solution, dtype=float)
    if dof < 1 or rank < design.shape[1]:
        raise IdentificationError(
            "sine fit",
            f"{len(samples)} samples do not determine {design.shape[1] + more} terms",
            "record more",
        )
    residual = samples - design @ weights
    variance = float(residual @ residual) / dof
    return weights, variance * np.linalg.inv(design.T @ design), math.sqrt(variance)


def _refined(time: FloatArray, samples: FloatArray, frequency: float, decay: FreeDecay | None) -> float:
    start, resolution = frequency, 2 * math.pi / float(np.ptp(time))
    for _ in range(REFINEMENTS):
        design = _design(time, frequency, decay)
        weights = np.asarray(np.linalg.lstsq(design, samples, rcond=1e-9)[0], dtype=float)
        full = np.column_stack([design, _slope(time, frequency, weights)])
        step = float(np.linalg.lstsq(full, samples, rcond=1e-9)[0][-1])
        frequency += step
        if abs(frequency - start) > resolution:
            break
        if abs(step) < 1e-9 * resolution:
            return frequency
    raise IdentificationError(
        "sine fit", f"no sine near {start:g} rad/s was found", "give a frequency closer to the true one"
    )


def _sine_fit(
    weights: FloatArray, covariance: FloatArray, frequency: float, middle: float, *, refined: bool
) -> dict[str, float]:
    """Everything of a `SineFit` but its residuals, with the origin of time moved back from `middle` [s]."""
    along, across, offset = (float(weight) for weight in weights[:3])
    amplitude = math.hypot(along, across)
    if amplitude == 0:
        raise IdentificationError(
            "sine fit", f"the samples hold no sine of {frequency:g} rad/s", "check the signal's column"
        )
    gradients = np.zeros((4, len(covariance)))
    gradients[0, :2] = np.array([along, across]) / amplitude
    gradients[1, :2] = np.array([-across, along]) / amplitude**2
    gradients[2, 2] = 1
    if refined:
        gradients[1, -1] = -middle
        gradients[3, -1] = 1
    amplitude_std, phase_std, offset_std, frequency_std = (propagated(g, covariance) for g in gradients)
    return {
        "frequency": frequency,
        "amplitude": amplitude,
        "phase": cmath.phase(cmath.rect(1, math.atan2(across, along) - frequency * middle)),
        "offset": offset,
        "amplitude_std": amplitude_std,
        "phase_std": phase_std,
        "offset_std": offset_std,
        "frequency_std": frequency_std,
    }


def quadrature_amplitude(centred: ArrayLike, step: float, duration: float) -> float:
    """Amplitude of a sine by Eq. 71 as published: sqrt(2 S / T), S the rectangle sum of the centred squares.

    Whoever passes samples that are not `step` [s] apart, or a `duration` [s] other than count * step, gets
    the amplitude scaled accordingly; the thesis' script for the recordings does (its step is that before
    decimation).
    """
    return float(np.sqrt(2 * np.sum(np.square(centred)) * step / duration))


@dataclass(frozen=True)
class FrequencyPoint:
    """The frequency response at one frequency.

    Attributes:
        frequency: [rad/s].
        response: G(j frequency) [output unit / input unit].
        gain_std: of |G|, in the unit of the response.
        phase_std: of arg G [rad].
    """

    frequency: float
    response: complex
    gain_std: float
    phase_std: float

    @property
    def gain(self) -> float:
        """|G|."""
        return abs(self.response)

    @property
    def phase(self) -> float:
        """arg G, in (-pi, pi] [rad]."""
        return cmath.phase(self.response)


def frequency_point(time: ArrayLike, driven: ArrayLike, answer: ArrayLike, frequency: float) -> FrequencyPoint:
    """G(j frequency) from sine fits to input `driven` (K,) and output `answer` (K,): Eq. 68, with phase.

    Args:
        time: (K,) stamps, even or not [s].
        frequency: [rad/s].

    Raises:
        IdentificationError: as `fit_sine`, or the input does not hold this frequency.
    """
    cause = fit_sine(time, driven, frequency)
    effect = fit_sine(time, answer, frequency)
    if cause.amplitude <= 3 * cause.amplitude_std or cause.amplitude == 0:
        raise IdentificationError(
            "frequency response",
            f"the input holds no sine of {frequency:g} rad/s",
            "check the input's column",
        )
    response = cmath.rect(effect.amplitude / cause.amplitude, effect.phase - cause.phase)
    gain_std = abs(response) * math.hypot(
        cause.amplitude_std / cause.amplitude, effect.amplitude_std / max(effect.amplitude, 1e-300)
    )
    return FrequencyPoint(frequency, response, gain_std, math.hypot(cause.phase_std, effect.phase_std))


def frequency_response(
    trace: Trace, driven: str, answer: str, frequencies: Iterable[float]
) -> tuple[FrequencyPoint, ...]:
    """G(j frequency) from one signal of a recording to another, at each frequency that the first holds.

    Args:
        driven, answer: names of the input and the output.
        frequencies: [rad/s].

    Raises:
        TraceError: there is no such signal.
        IdentificationError: as `frequency_point`.

    Source: the pendulum thesis, Eq. 68, with phase.
    """
    return tuple(frequency_point(trace.time, trace[driven], trace[answer], frequency) for frequency in frequencies)
