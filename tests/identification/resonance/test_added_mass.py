"""The added-mass regressions: consistent where they claim to be, biased where the thesis' shortcut is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize

from fmus.errors import IdentificationError
from identification.resonance.added_mass import (
    Bounds,
    Resonances,
    bounds_around,
    fit_damped,
    fit_errors_in_variables,
    fit_linear_as_published,
    fit_ratio,
    resonances,
)
from identification.resonance.resonance import resonance_frequency

P1, P3 = 0.00325, 0.04905
MASS, LENGTH = np.linspace(0, 0.3, 12), 0.1


def noisy(std: float, seed: int, p2: float = 0.0) -> Resonances:
    """Resonances whose w_opt^2 has this std."""
    squared = resonance_frequency(P1, p2, P3, MASS, LENGTH) ** 2
    return resonances(np.sqrt(squared + np.random.default_rng(seed).normal(0, std, len(MASS))), MASS, LENGTH)


def test_all_three_regressions_are_exact_without_noise_and_damping() -> None:
    data = noisy(0, 0)
    assert fit_linear_as_published(data) == pytest.approx([P1, P3])
    for fit in (fit_ratio(data), fit_errors_in_variables(data)):
        assert [fit.parameters[name].value for name in ("p1", "p3")] == pytest.approx([P1, P3])


@pytest.mark.parametrize("seed", range(5))
def test_errors_in_variables_and_eq_82_share_their_optimum(seed: int) -> None:
    direct, linear = fit_ratio(noisy(1.0, seed)), fit_errors_in_variables(noisy(1.0, seed))
    for name in ("p1", "p3"):
        assert direct.parameters[name].value == pytest.approx(linear.parameters[name].value, rel=1e-5)
        assert direct.parameters[name].std == pytest.approx(linear.parameters[name].std, rel=1e-4)


def test_errors_in_variables_is_the_maximum_over_the_unseen_true_values() -> None:
    data = noisy(1.0, 3)

    def with_latent(log_p: np.ndarray) -> np.ndarray:
        p1, p3 = np.exp(log_p)
        true_squared = (p3 + data.torque) / (p1 + data.inertia)
        return data.squared - true_squared

    best = np.exp(optimize.least_squares(with_latent, np.log([P1, P3]), xtol=1e-15).x)
    fit = fit_errors_in_variables(data)
    assert [fit.parameters["p1"].value, fit.parameters["p3"].value] == pytest.approx(best, rel=1e-5)


def test_ordinary_least_squares_on_eq_84_is_biased_and_errors_in_variables_is_not() -> None:
    draws = [noisy(2.0, seed) for seed in range(200)]
    ordinary = np.array([fit_linear_as_published(data)[0] for data in draws])
    consistent = np.array([fit_errors_in_variables(data).parameters["p1"].value for data in draws])
    assert abs(consistent.mean() - P1) < 3 * consistent.std() / np.sqrt(200)
    assert abs(ordinary.mean() - P1) > 5 * ordinary.std() / np.sqrt(200)


def test_intervals_hold_the_truth_in_95_percent_of_runs() -> None:
    fits = [fit_ratio(noisy(0.1, seed)).parameters for seed in range(200)]
    for name, true in (("p1", P1), ("p3", P3)):
        inside = np.mean([fit[name].ci95[0] <= true <= fit[name].ci95[1] for fit in fits])
        assert 0.92 <= inside <= 0.985, name


def test_given_standard_errors_set_the_uncertainty() -> None:
    omega = resonance_frequency(P1, 0, P3, MASS, LENGTH)
    one, two = (fit_ratio(resonances(omega, MASS, LENGTH, std)).parameters["p1"].std for std in (0.01, 0.02))
    assert two == pytest.approx(2 * one)


def test_eq_102_recovers_all_three_from_clean_resonances() -> None:
    data = resonances(resonance_frequency(P1, 0.004, P3, MASS, LENGTH), MASS, LENGTH)
    fit = fit_damped(data, bounds_around(0.003, 0.003, 0.05, 10))
    assert [fit.parameters[name].value for name in ("p1", "p2", "p3")] == pytest.approx([P1, 0.004, P3], rel=1e-5)
    assert fit.at_bound == ()


def test_a_parameter_on_its_bound_is_named_and_has_no_interval() -> None:
    data = resonances(resonance_frequency(P1, 0.015, P3, MASS, LENGTH), MASS, LENGTH)
    fit = fit_damped(data, Bounds((0.002, 0.001, 0.03), (0, 0, 0), (0.03, 0.01, 0.5)))
    assert fit.at_bound == ("p2",)
    assert fit.parameters["p2"].value == pytest.approx(0.01)
    assert not fit.parameters["p2"].known
    assert fit.parameters["p1"].known


def test_equal_bounds_hold_a_parameter() -> None:
    data = resonances(resonance_frequency(P1, 0.004, P3, MASS, LENGTH), MASS, LENGTH)
    fit = fit_damped(data, Bounds((0.002, 0.004, 0.03), (0, 0.004, 0), (0.03, 0.004, 0.5)))
    assert [fit.parameters[name].value for name in ("p1", "p2", "p3")] == pytest.approx([P1, 0.004, P3], rel=1e-6)


def test_as_many_resonances_as_parameters_leave_no_interval() -> None:
    data = resonances(resonance_frequency(P1, 0.004, P3, MASS[:3], LENGTH), MASS[:3], LENGTH)
    fit = fit_damped(data, bounds_around(0.003, 0.003, 0.05, 10))
    assert fit.dof == 0
    assert not fit.parameters["p1"].known


def test_bounds_that_exclude_the_start_are_refused() -> None:
    with pytest.raises(IdentificationError, match="exclude the start"):
        fit_damped(noisy(0, 0), Bounds((1, 1, 1), (0, 0, 0), (0.5, 2, 2)))


def test_resonances_that_say_nothing_are_refused() -> None:
    with pytest.raises(IdentificationError, match="fewer than two different"):
        fit_ratio(resonances([4.0, 4.0], [0.1, 0.1], 0.1))
    with pytest.raises(IdentificationError, match="different lengths"):
        resonances([4.0, 4.0], [0.1, 0.1, 0.2], 0.1)
    with pytest.raises(IdentificationError, match="not positive"):
        resonances([4.0, np.nan], [0.1, 0.2], 0.1)
