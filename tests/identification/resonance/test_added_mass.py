"""The added-mass regression: exact on clean resonances, with intervals that hold, and honest at its bounds."""

from __future__ import annotations

import numpy as np
import pytest

from fmus.errors import IdentificationError
from identification.resonance.added_mass import (
    AddedMassBounds,
    Resonances,
    fit_damped,
    resonances,
)
from tests.support.identification.pendulum_resonance import bounds_around, resonance_frequency

P1, P3 = 0.00325, 0.04905
MASS, LENGTH = np.linspace(0, 0.3, 12), 0.1
DAMPING = 0.0005
HELD = AddedMassBounds((0.002, DAMPING, 0.03), (0, DAMPING, 0), (0.03, DAMPING, 0.5))


def noisy(std: float, seed: int, p2: float = 0.0) -> Resonances:
    """Resonances whose w_opt^2 has this std."""
    squared = resonance_frequency(P1, p2, P3, MASS, LENGTH) ** 2
    return resonances(np.sqrt(squared + np.random.default_rng(seed).normal(0, std, len(MASS))), MASS, LENGTH)


def test_intervals_hold_the_truth_in_95_percent_of_runs() -> None:
    fits = [fit_damped(noisy(0.1, seed, DAMPING), HELD).parameters for seed in range(200)]
    for name, true in (("p1", P1), ("p3", P3)):
        inside = np.mean([fit[name].ci95[0] <= true <= fit[name].ci95[1] for fit in fits])
        assert 0.92 <= inside <= 0.985, name


def test_given_standard_errors_set_the_uncertainty() -> None:
    omega = resonance_frequency(P1, DAMPING, P3, MASS, LENGTH)
    one, two = (fit_damped(resonances(omega, MASS, LENGTH, std), HELD).parameters["p1"].std for std in (0.01, 0.02))
    assert two == pytest.approx(2 * one)


def test_eq_102_recovers_all_three_from_clean_resonances() -> None:
    data = resonances(resonance_frequency(P1, 0.004, P3, MASS, LENGTH), MASS, LENGTH)
    fit = fit_damped(data, bounds_around(0.003, 0.003, 0.05, 10))
    assert [fit.parameters[name].value for name in ("p1", "p2", "p3")] == pytest.approx([P1, 0.004, P3], rel=1e-5)
    assert fit.at_bound == ()


def test_a_parameter_on_its_bound_is_named_and_has_no_interval() -> None:
    data = resonances(resonance_frequency(P1, 0.015, P3, MASS, LENGTH), MASS, LENGTH)
    fit = fit_damped(data, AddedMassBounds((0.002, 0.001, 0.03), (0, 0, 0), (0.03, 0.01, 0.5)))
    assert fit.at_bound == ("p2",)
    assert fit.parameters["p2"].value == pytest.approx(0.01)
    assert not fit.parameters["p2"].known
    assert fit.parameters["p1"].known


def test_equal_bounds_hold_a_parameter() -> None:
    data = resonances(resonance_frequency(P1, 0.004, P3, MASS, LENGTH), MASS, LENGTH)
    fit = fit_damped(data, AddedMassBounds((0.002, 0.004, 0.03), (0, 0.004, 0), (0.03, 0.004, 0.5)))
    assert [fit.parameters[name].value for name in ("p1", "p2", "p3")] == pytest.approx([P1, 0.004, P3], rel=1e-6)


def test_as_many_resonances_as_parameters_leave_no_interval() -> None:
    data = resonances(resonance_frequency(P1, 0.004, P3, MASS[:3], LENGTH), MASS[:3], LENGTH)
    fit = fit_damped(data, bounds_around(0.003, 0.003, 0.05, 10))
    assert fit.dof == 0
    assert not fit.parameters["p1"].known


def test_bounds_that_exclude_the_start_are_refused() -> None:
    with pytest.raises(IdentificationError, match="exclude the start"):
        fit_damped(noisy(0, 0), AddedMassBounds((1, 1, 1), (0, 0, 0), (0.5, 2, 2)))


def test_resonances_that_say_nothing_are_refused() -> None:
    with pytest.raises(IdentificationError, match="2 resonances are too few"):
        fit_damped(resonances([4.0, 4.0], [0.1, 0.1], 0.1), bounds_around(0.003, 0.003, 0.05, 10))
    with pytest.raises(IdentificationError, match="different lengths"):
        resonances([4.0, 4.0], [0.1, 0.1, 0.2], 0.1)
    with pytest.raises(IdentificationError, match="not positive"):
        resonances([4.0, np.nan], [0.1, 0.2], 0.1)
