"""Gains of state feedback and of an observer by quadratic weights, in discrete time."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve, solve_discrete_are

from orchestrator.trace import ComplexArray, FloatArray

HIDDEN = 1e-8  # singular value, of the largest, below which a mode is not reached or not seen


def regulator(a: FloatArray, b: FloatArray, q: FloatArray, r: FloatArray) -> FloatArray:
    """(m, n) K of u = -K x, which makes the sum of x' Q x + u' R u least.

    Args:
        q, r: (n, n) and (m, m), symmetric, semidefinite and definite.

    Raises:
        np.linalg.LinAlgError: no such gain makes all that `q` sees fade.
    """
    p = solve_discrete_are(a, b, q, r)
    return np.asarray(solve(r + b.T @ p @ b, b.T @ p @ a, assume_a="pos"))


def observer(a: FloatArray, c: FloatArray, q: FloatArray, r: FloatArray) -> FloatArray:
    """(n, p) L of x[k+1] = A x[k] + L (y[k] - C x[k]), the regulator's dual: a Kalman filter's gain for noise of the
    covariances `q` on the states and `r` on the outputs.

    Raises:
        np.linalg.LinAlgError: no such gain makes the estimate's error fade.
    """
    return regulator(a.T, c.T, q, r).T


def unreached(a: FloatArray, b: FloatArray) -> ComplexArray:
    """The poles that columns of `b` do not reach (the test of Popov, Belevitch and Hautus)."""
    found = []
    for pole in np.linalg.eigvals(a):
        values = np.linalg.svd(np.hstack([pole * np.eye(len(a)) - a, b]), compute_uv=False)
        if values[-1] <= HIDDEN * values[0]:
            found.append(pole)
    return np.array(found, dtype=complex)


def unseen(a: FloatArray, c: FloatArray) -> ComplexArray:
    """The poles that rows of `c` do not show."""
    return unreached(a.T, c.T)
