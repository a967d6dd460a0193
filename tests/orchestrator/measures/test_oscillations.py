"""Frequencies, dampings, limit cycles and distortion are found as they were made."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from fmus.errors import TraceError
from orchestrator.measures import (
    SteadyOscillation,
    dominant_oscillation,
    harmonic_amplitudes,
    limit_cycle,
    total_harmonic_distortion,
)

uneven = st.integers(0, 1000).map(lambda seed: np.sort(np.random.default_rng(seed).uniform(0.0, 10.0, 400)))


@settings(deadline=None, max_examples=15)
@given(uneven, st.floats(2.0, 30.0), st.floats(0.0, 0.2), st.floats(-5.0, 5.0), st.floats(0.0, 6.0))
def test_a_decaying_sine_is_found_at_uneven_stamps(
    t: np.ndarray, frequency: float, damping: float, offset: float, phase: float
) -> None:
    decay = damping * frequency
    y = offset + 2.0 * np.exp(-decay * (t - t[0])) * np.cos(frequency * t + phase)
    found = dominant_oscillation(t, y)
    assert found is not None
    natural = math.hypot(frequency, decay)
    assert (found.frequency, found.amplitude, found.explained) == pytest.approx((frequency, 2.0, 1.0), rel=1e-3)
    assert found.damping == pytest.approx(decay / natural, abs=1e-4)


def test_poles_are_read_off_a_noisy_step_response() -> None:
    plant = control.tf([25.0], [1.0, 2 * 0.1 * 5.0, 25.0])
    t = np.linspace(0.0, 6.0, 1201)
    y = control.step_response(plant, t).outputs + 0.01 * np.random.default_rng(3).standard_normal(len(t))
    found = dominant_oscillation(t, y)
    assert found is not None
    assert (found.natural_frequency, found.damping) == pytest.approx((5.0, 0.1), rel=0.01)
    assert found.explained > 0.97


def test_of_two_modes_the_one_that_explains_more_is_found() -> None:
    t = np.linspace(0.0, 5.0, 2001)
    y = np.sin(8.0 * t) + 0.3 * np.sin(35.0 * t)
    found = dominant_oscillation(t, y)
    assert found is not None and found.frequency == pytest.approx(8.0, rel=0.01)
    assert found.explained == pytest.approx(1 / 1.09, abs=0.02)


def test_a_growing_oscillation_has_negative_damping() -> None:
    t = np.linspace(0.0, 10.0, 1001)
    found = dominant_oscillation(t, 0.01 * np.exp(0.3 * t) * np.sin(4.0 * t))
    assert found is not None
    assert (found.decay, found.amplitude) == pytest.approx((-0.3, 0.01), rel=1e-3)


def test_a_constant_and_less_than_a_period_have_no_oscillation() -> None:
    t = np.linspace(0.0, 1.0, 101)
    assert dominant_oscillation(t, np.full(101, 3.0)) is None
    assert dominant_oscillation(t, np.sin(2.0 * t)) is None


@given(st.floats(0.5, 5.0), st.floats(1e-3, 1e3), st.floats(-1e3, 1e3))
def test_a_steady_oscillation_is_a_limit_cycle(frequency: float, amplitude: float, offset: float) -> None:
    t = np.linspace(0.0, 10.0, 4001)
    found = limit_cycle(t, offset + amplitude * np.sin(2 * math.pi * frequency * t))
    assert found is not None
    assert (found.period, found.amplitude) == pytest.approx((1 / frequency, amplitude), rel=1e-3)
    assert 10 * frequency - 3.01 <= found.cycles <= 10 * frequency


def test_a_relay_with_hysteresis_cycles_as_its_closed_form() -> None:
    """An integrator behind a relay of 2 with switching points at +-0.5: a triangle of period 4 * 0.5 / 2."""
    t = np.linspace(0.0, 12.0, 6001)
    y = 0.5 * signal.sawtooth(2 * math.pi * t, 0.5)
    assert limit_cycle(t, y) == SteadyOscillation(pytest.approx(0.5), pytest.approx(1.0), 11)


@pytest.mark.parametrize(
    ("what", "values"),
    [
        ("decays", lambda t: np.exp(-0.1 * t) * np.sin(6 * t)),
        ("grows", lambda t: np.exp(0.1 * t) * np.sin(6 * t)),
        ("constant", lambda t: np.full_like(t, 2.0)),
        ("rounding", lambda t: 2.0 + 1e-15 * np.sin(6 * t)),
        ("ramp", lambda t: t),
        ("noise", lambda t: np.random.default_rng(0).standard_normal(len(t))),
        ("stops", lambda t: np.where(t < 5, np.sin(6 * t), 0.0)),
        ("begins late", lambda t: np.where(t > 5, np.sin(6 * t), 0.0)),
        ("chirp", lambda t: np.sin(6 * t + t**2)),
        ("two cycles", lambda t: np.sin(2 * math.pi * 0.25 * t)),
    ],
)
def test_what_does_not_go_on_alike_is_no_limit_cycle(what: str, values: object) -> None:
    t = np.linspace(0.0, 10.0, 2001)
    assert limit_cycle(t, values(t)) is None  # type: ignore[operator]


@pytest.mark.slow
@pytest.mark.parametrize("periods", [4.0, 5.3])
def test_a_square_wave_has_its_fourier_series(periods: float) -> None:
    """Odd amplitudes 4 / (n pi); all of them together distort by sqrt(pi^2 / 8 - 1)."""
    t = np.arange(0.0, periods, 1e-4) + 0.5e-4
    y = signal.square(2 * math.pi * t)
    expected = [4 / (n * math.pi) if n % 2 else 0.0 for n in range(1, 10)]
    assert harmonic_amplitudes(t, y, 2 * math.pi, 9) == pytest.approx(expected, abs=0.01)
    series = math.sqrt(sum(1 / n**2 for n in range(3, 41, 2)))
    assert total_harmonic_distortion(t, y, 2 * math.pi) == pytest.approx(series, rel=0.01)


def test_amplitudes_of_whole_periods_are_those_of_the_discrete_fourier_transform() -> None:
    t = np.arange(1000) / 100
    y = np.random.default_rng(2).standard_normal(1000)
    spectrum = 2 * np.abs(np.fft.rfft(y)) / 1000
    assert harmonic_amplitudes(t, y, 2 * math.pi, 20) == pytest.approx(spectrum[10:201:10], rel=1e-9)


def test_a_pure_sine_is_not_distorted_at_uneven_stamps() -> None:
    t = np.sort(np.random.default_rng(5).uniform(0.0, 3.0, 900))
    assert total_harmonic_distortion(t, 1.0 + np.sin(9.0 * t), 9.0) == pytest.approx(0.0, abs=1e-9)


def test_harmonics_that_the_samples_cannot_tell_are_refused() -> None:
    t = np.linspace(0.0, 1.0, 101)
    with pytest.raises(TraceError, match="1 s hold less than a period"):
        harmonic_amplitudes(t, np.sin(t), 1.0, 3)
    with pytest.raises(TraceError, match="there are 4 below half the sampling rate"):
        harmonic_amplitudes(t, np.sin(t), 2 * math.pi * 10, 5)
    with pytest.raises(TraceError, match="there is no fundamental"):
        total_harmonic_distortion(t, np.sin(4 * math.pi * t), 2 * math.pi)
