"""Resampling, windows, spectra and filters against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import IdentificationError, TraceError
from identification.signals.processing import (
    decimated,
    detrended,
    dft,
    dft_frequencies,
    differentiate,
    dominant_frequency,
    dominant_frequency_as_published,
    last_seconds,
    low_pass,
    mean_step,
    mid_range,
    periodogram,
    resampled_evenly,
)
from orchestrator.trace import Trace


def jittered(seed: int = 0, samples: int = 2000, period: float = 1e-3) -> Trace:
    steps = np.random.default_rng(seed).uniform(0.2, 1.8, samples - 1) * period
    time = np.concatenate([[0.3], 0.3 + np.cumsum(steps)])
    return Trace(time, {"ramp": 2 * time + 1, "wave": np.sin(7 * time)}, {"ramp": "rad"})


def test_resampling_at_the_mean_step_keeps_the_ends_and_is_even() -> None:
    trace = jittered()
    even = resampled_evenly(trace)
    assert len(even) == len(trace)
    assert even.time[[0, -1]] == pytest.approx(trace.time[[0, -1]])
    assert np.ptp(np.diff(even.time)) < 1e-12
    assert even.unit("ramp") == "rad"


@given(st.integers(0, 50), st.floats(1e-4, 0.4))
def test_resampling_at_any_period_is_exact_for_a_straight_line(seed: int, period: float) -> None:
    even = resampled_evenly(jittered(seed, 500), period)
    assert even["ramp"] == pytest.approx(2 * even.time + 1)
    assert even.time[-1] <= jittered(seed, 500).time[-1] + 1e-9
    assert even.time[-1] + period > jittered(seed, 500).time[-1] - 1e-9


@pytest.mark.parametrize("period", [0.0, -1.0, 100.0, np.nan])
def test_a_period_that_does_not_fit_the_recording_is_refused(period: float) -> None:
    with pytest.raises(TraceError, match="cannot be resampled"):
        resampled_evenly(jittered(), period)


def test_decimation_keeps_every_nth_sample_from_the_first() -> None:
    trace = jittered()
    assert np.array_equal(decimated(trace, 7)["wave"], trace["wave"][::7])
    with pytest.raises(TraceError, match="factor"):
        decimated(trace, 0)


def test_the_last_seconds_hold_the_scripts_number_of_samples() -> None:
    even = Trace(np.arange(1751.0) * 0.04, {"q": np.arange(1751.0)})
    kept = last_seconds(even, 45)
    assert len(kept) == 45 / 0.04 + 1
    assert kept["q"][-1] == 1750


def test_a_window_longer_than_the_recording_is_refused() -> None:
    with pytest.raises(TraceError, match="lasts"):
        last_seconds(jittered(), 30)


def test_mid_range_is_the_centre_of_the_extremes() -> None:
    assert mid_range(np.array([1.0, 1.0, 1.0, 5.0])) == 3.0


def test_detrending_removes_polynomials_of_its_degree() -> None:
    t = np.linspace(0, 1, 101)
    assert detrended(3 + 0 * t) == pytest.approx(0 * t, abs=1e-12)
    assert detrended(3 - 5 * t, 1) == pytest.approx(0 * t, abs=1e-12)
    assert detrended(np.sin(t)).mean() == pytest.approx(0, abs=1e-12)


def test_the_dft_is_the_sum_of_eq_27() -> None:
    w = np.random.default_rng(1).normal(size=24)
    m = k = np.arange(1, 25)
    direct = np.exp(-1j * 2 * np.pi * np.outer(k, m) / 24) @ w / np.sqrt(24)
    assert dft(w) == pytest.approx(direct)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=64))
def test_the_periodogram_keeps_the_energy(values: list[float]) -> None:
    assert periodogram(values).sum() == pytest.approx(np.sum(np.square(values)), abs=1e-6)


def test_a_sine_on_a_bin_has_the_two_peaks_of_eq_33() -> None:
    count, bin_, amplitude = 120, 7, 0.3
    power = periodogram(amplitude * np.sin(2 * np.pi * bin_ / count * np.arange(1, count + 1)))
    expected = np.zeros(count)
    expected[[bin_ - 1, count - bin_ - 1]] = count * amplitude**2 / 4
    assert power == pytest.approx(expected, abs=1e-12)


def test_the_published_frequency_axis_is_too_long_by_one_sample() -> None:
    count, period = 1000, 0.04
    omega = dft_frequencies(count, period)[24]
    wave = 5 + np.sin(omega * period * np.arange(count))
    assert dominant_frequency(wave, period) == pytest.approx(omega)
    assert dominant_frequency_as_published(wave, period) == pytest.approx(omega * count / (count - 1))


def test_the_low_pass_takes_no_phase_and_half_the_amplitude_at_its_corner() -> None:
    t = np.arange(20000) / 1000
    slow, corner = np.sin(2 * np.pi * 1 * t), np.sin(2 * np.pi * 50 * t)
    inner = slice(5000, 15000)
    assert low_pass(slow, 1e-3, 50)[inner] == pytest.approx(slow[inner], abs=1e-4)
    assert low_pass(corner, 1e-3, 50)[inner] == pytest.approx(corner[inner] / 2, abs=1e-6)
    both = low_pass(np.column_stack([slow, corner]), 1e-3, 50)
    assert both[inner, 1] == pytest.approx(corner[inner] / 2, abs=1e-6)


def test_a_corner_above_half_the_rate_is_refused() -> None:
    with pytest.raises(IdentificationError, match="half the rate"):
        low_pass(np.zeros(100), 0.01, 60)
    with pytest.raises(IdentificationError, match="too few"):
        low_pass(np.zeros(5), 0.01, 6)


@given(st.lists(st.floats(-5, 5), min_size=4, max_size=4), st.sampled_from([1, 2]))
def test_differentiation_is_exact_for_polynomials_of_its_degree(coefficients: list[float], order: int) -> None:
    t = 0.01 * np.arange(60)
    cubic = np.polynomial.Polynomial(coefficients)
    assert differentiate(cubic(t), 0.01, order=order) == pytest.approx(cubic.deriv(order)(t), abs=1e-6)


def test_differentiation_refuses_windows_that_do_not_fit() -> None:
    with pytest.raises(IdentificationError, match="window"):
        differentiate(np.zeros(8), 0.01)


def test_the_mean_step_is_the_span_over_the_intervals() -> None:
    assert mean_step(np.array([0.0, 1.0, 5.0])) == 2.5
