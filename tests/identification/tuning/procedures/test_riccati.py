"""Gains by quadratic weights: those of SciPy's Riccati equation, of python-control, and of a plain recursion."""

from __future__ import annotations

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are

from identification.tuning.procedures.riccati import observer, regulator, unreached, unseen
from orchestrator.trace import FloatArray

SEEDS = st.integers(0, 2**32 - 1)


def system(seed: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """A, B, C of a random system, stable or not, and weights Q, R of the right sizes."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 7)), int(rng.integers(1, 3))
    a = rng.standard_normal((n, n))
    a *= rng.uniform(0.3, 1.2) / np.abs(np.linalg.eigvals(a)).max()
    half, other = rng.standard_normal((n, n)), rng.standard_normal((m, m))
    q, r = half @ half.T + 0.1 * np.eye(n), other @ other.T + 0.1 * np.eye(m)
    return a, rng.standard_normal((n, m)), rng.standard_normal((m, n)), q, r


@pytest.mark.slow
@settings(deadline=None, max_examples=60)
@given(SEEDS)
def test_feedback_and_observer_are_those_of_scipys_riccati_and_python_controls(seed: int) -> None:
    a, b, c, q, r = system(seed)
    p = solve_discrete_are(a, b, q, r)
    k = regulator(a, b, q, r)
    assert k == pytest.approx(np.linalg.inv(r + b.T @ p @ b) @ b.T @ p @ a, rel=1e-9, abs=1e-9)
    assert k == pytest.approx(control.dlqr(a, b, q, r)[0], rel=1e-9, abs=1e-9)
    found = observer(a, c, q, r)
    p = solve_discrete_are(a.T, c.T, q, r)
    assert found == pytest.approx(a @ p @ c.T @ np.linalg.inv(c @ p @ c.T + r), rel=1e-9, abs=1e-9)
    assert found == pytest.approx(control.dlqe(a, np.eye(len(a)), c, q, r)[0], rel=1e-9, abs=1e-9)


@pytest.mark.slow
@settings(deadline=None, max_examples=30)
@given(SEEDS)
def test_a_long_horizon_comes_to_the_same_feedback(seed: int) -> None:
    """Bellman's recursion from the end, without the algebraic equation."""
    a, b, _, q, r = system(seed)
    p = q
    for _ in range(3000):
        k = np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)
        p = q + a.T @ p @ (a - b @ k)
    assert regulator(a, b, q, r) == pytest.approx(k, rel=1e-6, abs=1e-7)


def test_a_mode_without_an_input_is_found_and_no_other() -> None:
    a = np.diag([0.9, 1.0, 0.5])
    assert unreached(a, np.array([[1.0], [0.0], [1.0]])) == pytest.approx([1.0])
    assert unseen(a, np.array([[1.0, 1.0, 0.0]])) == pytest.approx([0.5])
    assert not len(unreached(a, np.ones((3, 1))))
