"""Regression with instruments: exact on exact rows, feasible whatever the rows ask for, told apart or refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from fmus.errors import IdentificationError
from identification.inverse_dynamics.regression import RegressionRows, regress
from orchestrator.trace import FloatArray

FREE = np.full(3, -np.inf)
PLACES = np.arange(400)


def rows(values: FloatArray, noise: float, seed: int, columns: int = 3) -> RegressionRows:
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((400, columns))
    return RegressionRows(
        x @ values + noise * rng.standard_normal(400), x, x + 0.3 * rng.standard_normal(x.shape), PLACES
    )


def test_exact_rows_give_their_values_exactly_whatever_the_instruments() -> None:
    values = np.array([3.0, -2.0, 0.5])
    found = regress([rows(values, 0.0, 1), rows(values, 0.0, 2)], FREE)
    assert found.values == pytest.approx(values, abs=1e-12)
    assert found.freedom == 797
    assert found.bound == (False, False, False)


def test_a_value_that_would_not_be_feasible_lies_at_the_least_and_the_others_are_the_best_beside_it() -> None:
    one = rows(np.array([3.0, -0.4, 0.5]), 0.1, 3)
    plain = RegressionRows(one.y, one.x, one.x, PLACES)
    found = regress([plain], np.array([0.0, 0.0, -np.inf]))
    bounded = lsq_linear(one.x, one.y, ([0.0, 0.0, -np.inf], np.inf)).x
    assert found.bound == (False, True, False)
    assert found.values == pytest.approx(bounded, abs=0.02)


@pytest.mark.parametrize("twice", [1.0, -2.5])
def test_columns_that_say_the_same_are_refused(twice: float) -> None:
    one = rows(np.array([3.0, 1.0, 0.5]), 0.1, 4)
    x = one.x.copy()
    x[:, 2] = twice * x[:, 1]
    with pytest.raises(IdentificationError, match="do not tell apart"):
        regress([RegressionRows(one.y, x, x, PLACES)], FREE)


def test_too_few_rows_are_refused() -> None:
    one = rows(np.ones(3), 0.1, 5)
    with pytest.raises(IdentificationError, match="leave 20 rows for 3 parameters"):
        regress([RegressionRows(one.y[:20], one.x[:20], one.z[:20], PLACES[:20])], FREE)


def test_of_white_noise_on_ones_the_variance_is_that_of_a_mean_whatever_is_left_out() -> None:
    """And of noise that is the difference of neighbours hardly any is left of a mean over all of them."""
    rng = np.random.default_rng(6)
    places = np.flatnonzero(rng.random(20_000) < 0.5)
    shocks, ones = rng.standard_normal(20_001), np.ones((len(places), 1))
    white, differences = shocks[places], np.diff(shocks)
    own = regress([RegressionRows(white, ones, ones, places)], FREE[:1])
    assert own.covariance[0, 0] == pytest.approx(1 / len(places), rel=0.5)
    whole = np.ones((20_000, 1))
    steady = regress([RegressionRows(differences, whole, whole, np.arange(20_000))], FREE[:1])
    assert 0 < steady.covariance[0, 0] < 0.2 * np.var(differences) / 20_000
