"""The pendulum thesis' Steps 1-4 on a campaign of sine experiments: gains, resonances, physical parameters.

`study_as_published` repeats the two scripts of its appendix, slips included, for Tables 1 to 5; `study` is
the method to use: sine fits, log|G| least squares, all added masses at once, with 95 % intervals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.estimated_value import EstimatedValue, with_interval
from identification.resonance.added_mass import AddedMassBounds, AddedMassFit, Resonances, fit_damped, resonances
from identification.resonance.log_gain import (
    GainData,
    MagnitudeFit,
    PendulumFit,
    fit_magnitude,
    fit_pendulum,
    gain_data,
)
from identification.resonance.resonance import decibel, resonance_from_two_largest_as_published
from identification.signals.frequency_response import FreeDecay, fit_sine, quadrature_amplitude
from identification.signals.processing import (
    decimated,
    dominant_frequency_as_published,
    last_seconds,
    mean_step,
    mid_range,
    resampled_evenly,
)
from orchestrator.trace import FloatArray, ReadOnlyArrays, Trace, usable

LINEAR = 0.01  # relative misfit of the gains up to which a linear model is taken to hold


@dataclass(frozen=True)
class Experiment:
    """One recording of the answer to v(t) = amplitude sin(frequency t).

    Attributes:
        trace: holds the angle [rad].
        added_mass: [kg].
        added_length: its distance from the axis [m].
        amplitude: of the input [input unit].
        frequency: of the input [rad/s].
    """

    trace: Trace
    added_mass: float
    added_length: float
    amplitude: float
    frequency: float


@dataclass(frozen=True)
class Processing:
    """How a script of the thesis treats a recording before it takes the amplitude.

    Attributes:
        decimation: every so many samples of the evenly resampled angle are kept.
        window: last seconds that count as steady state [s].
        sums_decimated: whether Eq. 71 sums the decimated samples (yet times the undecimated step, which
            scales all amplitudes by 1/sqrt(decimation)) or all of them.
    """

    decimation: int
    window: float
    sums_decimated: bool


SYNTHETIC_SCRIPT = Processing(decimation=4, window=45.0, sums_decimated=False)
RECORDINGS_SCRIPT = Processing(decimation=25, window=30.0, sums_decimated=True)


@dataclass(frozen=True, eq=False)
class LoadResult(ReadOnlyArrays):
    """What the experiments with one added mass give.

    Attributes:
        added_mass, added_length: [kg], [m].
        frequency: (K,) increasing; as published those of the periodogram's peaks, else those of the input
            [rad/s].
        gain: (K,) [rad / input unit].
        gain_std: (K,) standard errors, zeros as published.
        resonance: [rad/s]; without uncertainty as published.
        magnitude: the fit behind the resonance, None as published.
    """

    added_mass: float
    added_length: float
    frequency: FloatArray
    gain: FloatArray
    gain_std: FloatArray
    resonance: EstimatedValue
    magnitude: MagnitudeFit | None


@dataclass(frozen=True)
class ResonanceStudy:
    """Result of Steps 1-4.

    Attributes:
        method: 'as published' or 'corrected'.
        loads: one result an added mass, lightest first (Tables 1 and 4).
        parameters: p1 [kg m^2], p2 [N m s/rad], p3 [N m], and p4 [N m / input unit] when corrected (Tables 2,
            5).
        fit: the regression behind `parameters`.
        warnings: what a reader of the figures must know.
    """

    method: str
    loads: tuple[LoadResult, ...]
    parameters: dict[str, EstimatedValue]
    fit: AddedMassFit | PendulumFit
    warnings: tuple[str, ...]


def study_as_published(
    experiments: Sequence[Experiment],
    processing: Processing,
    bounds: AddedMassBounds,
    signal: str = "angle",
) -> ResonanceStudy:
    """Steps 1-4 by the thesis' scripts: mid-range centring, Eq. 71, Eq. 100 in dB, Eq. 102 with bounds.

    Args:
        experiments: any order; at least two frequencies for each added mass, three added masses.
        processing: SYNTHETIC_SCRIPT or RECORDINGS_SCRIPT.
        bounds: of p1, p2, p3.
        signal: name of the angle in the traces.

    Raises:
        TraceError: a recording is too short, has a NaN, or is constant.
        IdentificationError: too few experiments, or no convergence.
    """
    loads = tuple(_load_as_published(group, processing, signal) for group in _by_load(experiments))
    fit = fit_damped(_resonances(loads), bounds)
    warnings = ["method as published: Eq. 100 is biased, the parameters only reproduce the thesis"]
    warnings += [f"{name} ended on its bound" for name in fit.at_bound]
    return ResonanceStudy("as published", loads, fit.parameters, fit, tuple(warnings))


def study(experiments: Sequence[Experiment], window: float, signal: str = "angle") -> ResonanceStudy:
    """Steps 1-4 corrected: sine fits over the last `window` [s], log|G| fits, p1..p4 from all masses at once.

    The free decay left of the transient is fitted along with the sines, at the frequency and rate that a
    first pass finds, so the window may begin before it has died out.

    Args:
        experiments: any order; at least four frequencies for each added mass, two added masses.
        signal: name of the angle in the traces.

    Raises:
        TraceError: a recording is too short, has a NaN, or is constant.
        IdentificationError: too few experiments, no convergence, or no resonance.
    """
    loads = tuple(_load(group, window, signal) for group in _by_load(experiments))
    fit = fit_pendulum(_all_gains(loads))
    return ResonanceStudy("corrected", loads, fit.parameters, fit, _model_warnings(fit))


def _all_gains(loads: Sequence[LoadResult]) -> GainData:
    counts = [len(load.gain) for load in loads]
    return gain_data(
        np.concatenate([load.frequency for load in loads]),
        np.concatenate([load.gain for load in loads]),
        np.concatenate([load.gain_std for load in loads]),
        np.repeat([load.added_mass for load in loads], counts),
        np.repeat([load.added_length for load in loads], counts),
    )


def _model_warnings(fit: PendulumFit) -> tuple[str, ...]:
    warnings = [
        f"{name} = {p.value:.3g} {p.unit} cannot be told from 0 (95 % up to {p.ci95[1]:.3g})"
        for name, p in fit.parameters.items()
        if p.ci95[0] <= 0 <= p.ci95[1]
    ]
    if fit.model_error > LINEAR:
        warnings.append(
            f"the gains depart by {100 * fit.model_error:.1f} % from any linear pendulum "
            "(dry friction, backlash?); fit in the time domain for a model that predicts"
        )
    return tuple(warnings)


def _by_load(experiments: Sequence[Experiment]) -> list[list[Experiment]]:
    """Experiments of one added mass together, lightest first, each by frequency."""

    def load(experiment: Experiment) -> tuple[float, float]:
        return experiment.added_mass, experiment.added_length

    if not experiments:
        raise IdentificationError("resonance study", "there are no experiments")
    ordered = sorted(experiments, key=lambda e: (*load(e), e.frequency))
    return [list(group) for _, group in groupby(ordered, key=load)]


def _resonances(loads: Sequence[LoadResult]) -> Resonances:
    return resonances(
        [load.resonance.value for load in loads],
        [load.added_mass for load in loads],
        [load.added_length for load in loads],
    )


def _load_as_published(group: Sequence[Experiment], processing: Processing, signal: str) -> LoadResult:
    points = np.array([point_as_published(experiment, processing, signal) for experiment in group])
    frequency, gain = points.T
    resonance = resonance_from_two_largest_as_published(frequency, decibel(gain))
    return LoadResult(
        group[0].added_mass,
        group[0].added_length,
        frequency,
        gain,
        np.zeros_like(gain),
        with_interval(resonance, math.inf, unit="rad/s"),
        None,
    )


def point_as_published(experiment: Experiment, processing: Processing, signal: str) -> tuple[float, float]:
    """Frequency of the periodogram's peak [rad/s] and gain [rad / input unit], by the thesis' scripts."""
    even = resampled_evenly(usable(experiment.trace, [signal]).select([signal]))
    coarse = last_seconds(decimated(even, processing.decimation), processing.window)
    summed = coarse if processing.sums_decimated else last_seconds(even, processing.window)
    centred = summed[signal] - mid_range(coarse[signal])
    amplitude = quadrature_amplitude(centred, mean_step(even.time), processing.window)
    frequency = dominant_frequency_as_published(coarse[signal], mean_step(coarse.time))
    return frequency, amplitude / experiment.amplitude


def _load(group: Sequence[Experiment], window: float, signal: str) -> LoadResult:
    steady = [last_seconds(usable(e.trace, [signal]), window) for e in group]
    frequency = np.array([experiment.frequency for experiment in group])
    gain, gain_std = _gains(group, steady, signal, None)
    first = fit_magnitude(frequency, gain)
    gain, gain_std = _gains(group, steady, signal, _free_decay(first))
    fit = fit_magnitude(frequency, gain, gain_std)
    load = group[0]
    return LoadResult(load.added_mass, load.added_length, frequency, gain, gain_std, fit.omega_opt, fit)


def _free_decay(fit: MagnitudeFit) -> FreeDecay:
    rate = fit.a1.value / 2
    return FreeDecay(rate, math.sqrt(fit.a0.value - rate**2))


def _gains(
    group: Sequence[Experiment], steady: Sequence[Trace], signal: str, decay: FreeDecay | None
) -> tuple[FloatArray, FloatArray]:
    """(K,) gains and their standard errors."""
    fits = [
        fit_sine(trace.time, trace[signal], experiment.frequency, decay=decay)
        for experiment, trace in zip(group, steady, strict=True)
    ]
    drive = np.array([experiment.amplitude for experiment in group])
    return np.array([f.amplitude for f in fits]) / drive, np.array([f.amplitude_std for f in fits]) / drive
