"""Sine fits and frequency responses: exact on clean data, with honest standard errors on noisy ones."""

from __future__ import annotations

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import IdentificationError
from identification.signals.frequency_response import (
    FreeDecay,
    SineFit,
    fit_sine,
    frequency_point,
    quadrature_amplitude,
)

OMEGA = 4.3


def uneven(seed: int = 0, samples: int = 600) -> np.ndarray:
    return 5 + np.cumsum(np.random.default_rng(seed).uniform(0.005, 0.035, samples))


def wave(t: np.ndarray, omega: float = OMEGA, phase: float = 0.8) -> np.ndarray:
    return 1.0 + 0.2 * np.sin(omega * t + phase)


@given(st.floats(1e-3, 10), st.floats(-3.1, 3.1), st.floats(-5, 5), st.floats(1, 50))
def test_the_sine_fit_is_exact_without_noise(amplitude: float, phase: float, offset: float, omega: float) -> None:
    t = uneven()
    fit = fit_sine(t, offset + amplitude * np.sin(omega * t + phase), omega)
    assert (fit.amplitude, fit.phase, fit.offset) == pytest.approx((amplitude, phase, offset), abs=1e-8)
    assert fit.frequency_std == 0


def test_the_refined_fit_finds_the_frequency() -> None:
    t = uneven()
    fit = fit_sine(t, wave(t), OMEGA + 0.2, refine=True)
    assert (fit.frequency, fit.amplitude, fit.phase) == pytest.approx((OMEGA, 0.2, 0.8))
    assert fit(t) == pytest.approx(wave(t))


def test_a_refinement_that_runs_away_is_refused() -> None:
    t = uneven()
    with pytest.raises(IdentificationError, match="near"):
        fit_sine(t, wave(t), OMEGA + 5, refine=True)


def test_a_free_decay_is_left_out() -> None:
    t = uneven()
    decay = FreeDecay(0.15, 3.9)
    ringing = 0.1 * np.exp(-0.15 * (t - t[0])) * np.cos(3.9 * t + 1)
    assert fit_sine(t, wave(t) + ringing, OMEGA, decay=decay).amplitude == pytest.approx(0.2)
    assert abs(fit_sine(t, wave(t) + ringing, OMEGA).amplitude - 0.2) > 5e-4


@pytest.mark.parametrize(("refine", "name"), [(False, "given"), (True, "refined")])
def test_standard_errors_match_the_scatter_of_200_draws(refine: bool, name: str) -> None:
    t, rng = uneven(), np.random.default_rng(11)
    fits = [fit_sine(t, wave(t) + rng.normal(0, 0.05, len(t)), OMEGA, refine=refine) for _ in range(200)]
    fields = ["amplitude", "phase", "offset"] + ["frequency"] * refine
    for field in fields:
        scatter = np.std([getattr(fit, field) for fit in fits], ddof=1)
        promised = np.mean([getattr(fit, f"{field}_std") for fit in fits])
        assert scatter == pytest.approx(promised, rel=0.15), f"{field}, frequency {name}"


def test_the_residual_std_is_the_noise() -> None:
    t = uneven(samples=5000)
    fit = fit_sine(t, wave(t) + np.random.default_rng(2).normal(0, 0.05, len(t)), OMEGA)
    assert fit.residual_std == pytest.approx(0.05, rel=0.03)


@pytest.mark.parametrize(
    ("t", "values", "problem"),
    [
        (np.linspace(0, 1, 100), np.ones(100), "less than one period"),
        (np.linspace(0, 10, 100), np.full(100, np.nan), "not finite"),
        (np.linspace(0, 10, 100), np.zeros(99), "stamps for"),
        (np.linspace(0, 10, 100), np.zeros(100), "no sine"),
        (2 * np.pi / OMEGA * np.arange(30), np.ones(30), "do not determine"),
    ],
)
def test_data_that_cannot_carry_a_sine_are_refused(t: np.ndarray, values: np.ndarray, problem: str) -> None:
    with pytest.raises(IdentificationError, match=problem):
        fit_sine(t, values, OMEGA)


def test_eq_71_is_the_amplitude_where_the_sampling_is_its_own() -> None:
    t = np.arange(1, 3001) * 0.01
    samples = 0.7 * np.sin(2 * np.pi * t)
    assert quadrature_amplitude(samples, 0.01, 30) == pytest.approx(0.7)


def test_the_undecimated_step_scales_the_published_amplitude_by_its_root() -> None:
    t = np.arange(1, 3001) * 0.01
    samples = 0.7 * np.sin(2 * np.pi * t)
    assert quadrature_amplitude(samples[::25], 0.01, 30) == pytest.approx(0.7 / 5)


def driven(omega: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, complex]:
    """Steady state of a known continuous system, sampled, and its response at omega."""
    system = control.tf([3.0], [1.0, 0.4, 15.0])
    response = complex(system(1j * omega))
    t = np.arange(1, 2001) * 2 * np.pi / omega / 50
    return t, np.sin(omega * t), abs(response) * np.sin(omega * t + np.angle(response)), response


@pytest.mark.parametrize("omega", [1.0, 3.8, 9.0])
def test_the_frequency_point_is_that_of_the_system(omega: float) -> None:
    t, u, y, response = driven(omega)
    point = frequency_point(t, 2 * u, 2 * y + 0.5, omega)
    assert point.response == pytest.approx(response)
    assert (point.gain, point.phase) == pytest.approx((abs(response), np.angle(response)))


def test_the_gain_std_matches_the_scatter_of_200_draws() -> None:
    t, u, y, _ = driven(3.8)
    rng = np.random.default_rng(5)
    points = [
        frequency_point(t, u + rng.normal(0, 0.3, len(t)), y + rng.normal(0, 0.4, len(t)), 3.8) for _ in range(200)
    ]
    assert np.std([p.gain for p in points]) == pytest.approx(np.mean([p.gain_std for p in points]), rel=0.15)
    assert np.std([p.phase for p in points]) == pytest.approx(np.mean([p.phase_std for p in points]), rel=0.15)


def test_an_input_without_the_frequency_is_refused() -> None:
    t, _, y, _ = driven(3.8)
    with pytest.raises(IdentificationError, match="the input holds no sine"):
        frequency_point(t, np.random.default_rng(0).normal(size=len(t)), y, 3.8)


def test_a_fit_evaluates_to_its_formula() -> None:
    fit = SineFit(2.0, 3.0, 0.5, 1.0, 0, 0, 0, 0, 0)
    assert fit(0.25) == pytest.approx(1 + 3 * np.sin(1.0))
