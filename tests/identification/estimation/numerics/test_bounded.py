"""Bounded least squares find what SciPy's find, whatever the bounds, scales and ranks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from identification.estimation.numerics.bounded import bounded_least_squares
from orchestrator.trace import FloatArray

Question = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def asked(seed: int, unknowns: int, more: int, open_share: float) -> Question:
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(unknowns + more, unknowns)) * 10.0 ** rng.uniform(-3, 3, unknowns)
    target = rng.normal(size=len(matrix))
    size = 1 / np.linalg.norm(matrix, axis=0)
    low, high = -size * 10.0 ** rng.uniform(-2, 1, unknowns), size * 10.0 ** rng.uniform(-2, 1, unknowns)
    low[rng.random(unknowns) < open_share] = -np.inf
    high[rng.random(unknowns) < open_share] = np.inf
    at = rng.random(unknowns)  # some begin at a bound, as steps of a search do, and some cannot move
    low[at < 0.15], high[at > 0.85] = 0.0, 0.0
    high[at < 0.05] = 0.0
    return matrix, target, low, high


questions = st.builds(asked, st.integers(0, 2**32), st.integers(1, 9), st.integers(0, 6), st.floats(0, 0.6))


@given(questions)
def test_they_are_those_of_scipy(question: Question) -> None:
    matrix, target, lower, upper = question
    low, high = np.where(lower == upper, lower - 1e-300, lower), upper  # SciPy refuses bounds that meet
    wanted = lsq_linear(matrix, target, (low, high), method="bvls", tol=1e-15).x
    found = bounded_least_squares(matrix, target, lower, upper)
    assert np.all((found >= lower) & (found <= upper))
    costs = [float(np.linalg.norm(matrix @ x - target)) for x in (found, wanted)]
    assert costs[0] <= costs[1] * (1 + 1e-9) + 1e-9 * float(np.linalg.norm(target))


@given(questions)
def test_no_slope_leads_inwards_from_where_they_end(question: Question) -> None:
    """Karush, Kuhn and Tucker: 0 where free, outwards at a bound."""
    matrix, target, lower, upper = question
    found = bounded_least_squares(matrix, target, lower, upper)
    pull = matrix.T @ (target - matrix @ found) / np.linalg.norm(matrix, axis=0) / np.linalg.norm(target)
    at_low, at_high = found <= lower, found >= upper
    assert np.all(pull[~at_low & ~at_high & np.isfinite(pull)] ** 2 < 1e-14)
    assert np.all(pull[at_low & ~at_high] < 1e-8) and np.all(pull[at_high & ~at_low] > -1e-8)


def test_unknowns_that_no_row_knows_stay_within_their_bounds() -> None:
    matrix = np.array([[1.0, 0.0, 1.0], [2.0, 0.0, 2.0]])  # the second counts nowhere, the first and third together
    found = bounded_least_squares(matrix, np.array([3.0, 6.0]), np.full(3, -1.0), np.full(3, 1.0))
    assert found[0] + found[2] == pytest.approx(2.0) and abs(found[1]) <= 1
