"""Second-order fits of log|G|: exact on the model, honest about their uncertainty off it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus.errors import IdentificationError
from identification.resonance.log_gain import GainData, fit_magnitude, fit_pendulum, gain_data
from tests.support.identification.pendulum_resonance import resonance_frequency

TRUE = {"p1": 0.00325, "p2": 0.001, "p3": 0.04905, "p4": 10.0}
MASS, LENGTH = np.repeat([0.0, 0.05, 0.1], 9), 0.05
OMEGA = np.tile(np.linspace(2, 7, 9), 3)


def second_order(omega: np.ndarray, a0: float, a1: float, b0: float) -> np.ndarray:
    return b0 / np.abs(a0 - omega**2 + 1j * a1 * omega)


def pendulum(p1: float, p2: float, p3: float, p4: float) -> np.ndarray:
    inertia, torque = p1 + MASS * LENGTH**2, p3 + MASS * 9.81 * LENGTH
    return p4 / np.abs(torque - inertia * OMEGA**2 + 1j * p2 * OMEGA)


@pytest.mark.slow
@settings(deadline=None)
@given(st.floats(0.5, 200), st.floats(0.01, 0.4), st.floats(0.01, 1e4))
def test_the_magnitude_fit_is_exact_for_a_second_order_system(a0: float, psi: float, b0: float) -> None:
    a1 = 2 * psi * np.sqrt(a0)
    omega = np.sqrt(a0) * np.linspace(0.4, 1.8, 9)
    fit = fit_magnitude(omega, second_order(omega, a0, a1, b0))
    assert (fit.a0.value, fit.a1.value, fit.b0.value) == pytest.approx((a0, a1, b0), rel=1e-6)
    assert fit.omega_opt.value == pytest.approx(float(resonance_frequency(1, a1, a0)), rel=1e-6)


@settings(deadline=None, max_examples=30)
@given(st.floats(1e-3, 1e-2), st.floats(3e-4, 2e-3), st.floats(-0.005, 0.1), st.floats(0.1, 100))
def test_the_pendulum_fit_is_exact_for_a_pendulum(p1: float, p2: float, p3: float, p4: float) -> None:
    fit = fit_pendulum(gain_data(OMEGA, pendulum(p1, p2, p3, p4), None, MASS, LENGTH))
    found = [fit.parameters[name].value for name in TRUE]
    assert found == pytest.approx([p1, p2, p3, p4], rel=1e-5, abs=1e-8)


def coverage(std: float, relative_model_error: float, draws: int = 200) -> dict[str, float]:
    """Share of draws in which the 95 % interval holds the truth."""
    rng, inside = np.random.default_rng(7), dict.fromkeys(TRUE, 0)
    gains = pendulum(**TRUE)
    for _ in range(draws):
        bent = gains * np.exp(rng.normal(0, relative_model_error, len(gains))) if relative_model_error else gains
        noisy = bent + rng.normal(0, std, len(gains))
        fit = fit_pendulum(GainData(OMEGA, noisy, np.full(len(gains), std), MASS, np.full(len(gains), LENGTH)))
        for name, true in TRUE.items():
            low, high = fit.parameters[name].ci95
            inside[name] += low <= true <= high
    return {name: count / draws for name, count in inside.items()}


@pytest.mark.slow
@pytest.mark.parametrize(("std", "model_error"), [(1.0, 0.0), (0.5, 0.05)])
def test_the_interval_holds_the_truth_in_95_percent_of_runs(std: float, model_error: float) -> None:
    for name, share in coverage(std, model_error).items():
        assert 0.92 <= share <= 0.985, name


def test_the_model_error_is_zero_for_noise_as_large_as_stated() -> None:
    omega = np.linspace(2, 7, 40)
    gains = second_order(omega, 15.0, 0.5, 100.0)
    noise = np.random.default_rng(4).normal(0, 1, 40)
    fit = fit_magnitude(omega, gains * np.exp(0.01 * noise / noise.std()), 0.02 * gains)
    assert fit.model_error == 0
    assert fit_magnitude(omega, gains * np.exp(0.01 * noise / noise.std())).model_error == pytest.approx(0.01, rel=0.1)


def test_the_std_of_the_resonance_matches_the_scatter_of_200_draws() -> None:
    omega, rng = np.linspace(2, 7, 13), np.random.default_rng(9)
    gains = second_order(omega, 15.0, 0.5, 100.0)
    fits = [fit_magnitude(omega, gains * (1 + 0.02 * rng.normal(size=13)), 0.02 * gains) for _ in range(200)]
    scatter = np.std([fit.omega_opt.value for fit in fits])
    assert scatter == pytest.approx(np.mean([fit.omega_opt.std for fit in fits]), rel=0.2)


@pytest.mark.parametrize(
    ("omega", "gains", "problem"),
    [
        ([1.0, 2.0, 3.0], [1.0, 2.0, 1.0], "3 gains for 3 parameters"),
        ([1.0, 2.0, 3.0, 4.0], [1.0, -2.0, 1.0, 1.0], "not positive"),
        ([1.0, 2.0, 3.0], [1.0, 2.0], "different lengths"),
    ],
)
def test_gains_that_cannot_be_fitted_are_refused(omega: list[float], gains: list[float], problem: str) -> None:
    with pytest.raises(IdentificationError, match=problem):
        fit_magnitude(omega, gains)


def test_an_overdamped_response_has_no_resonance_to_report() -> None:
    omega = np.linspace(0.2, 5, 12)
    with pytest.raises(IdentificationError, match="no resonance"):
        fit_magnitude(omega, second_order(omega, 1.0, 3.0, 1.0))


def test_one_added_mass_alone_is_refused() -> None:
    with pytest.raises(IdentificationError, match="only ratios"):
        fit_pendulum(gain_data(OMEGA, pendulum(**TRUE), None, 0.1, LENGTH))
