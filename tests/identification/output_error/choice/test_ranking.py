"""Criteria and ranking: by closed forms, and by what they are for."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from identification.output_error.choice.criteria import Misfit, criteria
from identification.output_error.choice.ranking import TELLING, ranked
from orchestrator.trace import FloatArray

TIME = np.linspace(-1, 1, 40)


def polynomial(degree: int, measured: FloatArray) -> tuple[Misfit, float]:
    """Least squares by a polynomial: what is left over, and its greatest log-likelihood by SciPy."""
    left = measured - np.polyval(np.polyfit(TIME, measured, degree), TIME)
    deviation = float(np.sqrt(np.mean(left**2)))
    power = np.array([np.mean(left**2) / np.var(measured)])
    misfit = Misfit(power, np.array([len(TIME)]), np.ones(1), degree + 1)
    return misfit, float(np.sum(stats.norm.logpdf(left, scale=deviation)))


def test_differences_are_those_of_the_likelihood() -> None:
    measured = 1 + 2 * TIME + np.random.default_rng(1).normal(0, 0.3, len(TIME))
    both = {degree: polynomial(degree, measured) for degree in (1, 3)}
    found = criteria({str(degree): misfit for degree, (misfit, _) in both.items()})
    n, k = len(TIME), {1: 3, 3: 5}
    bic = {degree: -2 * likelihood + k[degree] * math.log(n) for degree, (_, likelihood) in both.items()}
    aicc = {d: -2 * both[d][1] + 2 * k[d] + 2 * k[d] * (k[d] + 1) / (n - k[d] - 1) for d in both}
    assert found["3"].bic - found["1"].bic == pytest.approx(bic[3] - bic[1], abs=1e-9)
    assert found["3"].aicc - found["1"].aicc == pytest.approx(aicc[3] - aicc[1], abs=1e-9)


def misfit(power: float, unknowns: int, samples_each: float = 1.0, samples: int = 1000) -> Misfit:
    return Misfit(np.array([power]), np.array([samples]), np.array([samples_each]), unknowns)


def test_correlated_samples_count_by_how_many_tell_as_much_as_one() -> None:
    plain = criteria({"a": misfit(0.01, 2), "b": misfit(0.02, 2)})
    tenth = criteria({"a": misfit(0.01, 2, 10.0), "b": misfit(0.02, 2, 500.0)})
    assert tenth["b"].samples == 100
    assert 10 * (tenth["b"].bic - tenth["a"].bic) == pytest.approx(plain["b"].bic - plain["a"].bic)


def test_more_unknowns_than_samples_leave_aicc_infinite() -> None:
    assert criteria({"a": misfit(0.01, 9, samples=10)})["a"].aicc == math.inf


def windows(*errors: float) -> FloatArray:
    return np.array(errors)


def test_what_predicts_worse_is_out_although_it_fits_better() -> None:
    fits = {"bent": misfit(0.001, 5), "plain": misfit(0.002, 2)}
    unseen = {"bent": windows(0.9, 1.1, 0.8, 1.0), "plain": windows(0.1, 0.12, 0.11, 0.1)}
    found = ranked(fits, unseen)
    assert found.chosen == "plain"
    assert found.contested == "bent"
    assert found.rows["bent"].apart


def test_where_predictions_scatter_as_much_as_they_differ_criteria_decide() -> None:
    fits = {"bent": misfit(0.01, 5), "plain": misfit(0.01, 2)}
    unseen = {"bent": windows(0.1, 0.3, 0.1, 0.28), "plain": windows(0.3, 0.1, 0.3, 0.1)}
    found = ranked(fits, unseen)
    assert found.chosen == "plain"
    assert found.contested is None


@pytest.mark.parametrize(("power", "apart"), [(math.exp(-TELLING / 2 / 1000), False), (math.exp(TELLING / 500), True)])
def test_little_difference_of_criteria_and_predictions_is_told_as_none(power: float, apart: bool) -> None:
    fits = {"one": misfit(0.01, 2), "other": misfit(0.01 * power, 2)}
    unseen = {"one": windows(0.1, 0.2, 0.15), "other": windows(0.11, 0.19, 0.16)}
    found = ranked(fits, unseen)
    assert (found.alike == ()) == apart


def test_predictions_that_differ_tell_candidates_apart_whatever_criteria_say() -> None:
    fits = {"one": misfit(0.01, 2), "other": misfit(0.01, 2)}
    unseen = {"one": windows(0.1, 0.2, 0.15), "other": windows(0.2, 0.3, 0.25)}
    found = ranked(fits, unseen)
    assert (found.chosen, found.alike) == ("one", ())


@pytest.mark.parametrize("unseen", [{}, {"one": windows(9.0), "other": windows(0.1)}])
def test_without_scatter_criteria_decide_alone(unseen: dict[str, FloatArray]) -> None:
    found = ranked({"one": misfit(0.01, 2), "other": misfit(0.02, 2)}, unseen)
    assert found.chosen == "one"
