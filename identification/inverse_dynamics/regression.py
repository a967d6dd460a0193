"""Linear regression with instruments, with intervals for correlated residuals, and what is physically feasible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import orth
from scipy.optimize import lsq_linear

from fmus.errors import IdentificationError
from identification.estimation.noise import coloured
from orchestrator.trace import FloatArray

INDISTINCT = 1e-8  # singular value of columns of length 1, over the largest, below which they are not told apart


@dataclass(frozen=True, eq=False)
class RegressionRows:
    """Equations y = X theta + e of one record, evenly sampled.

    Attributes:
        y: (K,) left sides.
        x: (K, n) columns.
        z: (K, n) instruments, which have nothing to do with e; the columns themselves for least squares.
    """

    y: FloatArray
    x: FloatArray
    z: FloatArray


@dataclass(frozen=True, eq=False)
class Regression:
    """What rows gave.

    Attributes:
        values: (n,), covariance: (n, n) of them.
        freedom: rows less values.
        bound: (n,) which values lie at the least that is feasible; these have no interval.
    """

    values: FloatArray
    covariance: FloatArray
    freedom: int
    bound: tuple[bool, ...]


def regress(rows: Sequence[RegressionRows], least: FloatArray) -> Regression:
    """theta = (Z^T X)^-1 Z^T y over all records, and where that is below `least` (n,) the most likely that is not.

    The covariance is (Z^T X)^-1 Z^T N Z (X^T Z)^-1, N that of an autoregression fitted to the residuals.

    Raises:
        IdentificationError: the columns cannot be told apart, or there are too few rows.

    Source: Soderstrom and Stoica 1983.
    """
    count = len(least)
    total = sum(len(one.y) for one in rows)
    if total < 10 * count:
        raise IdentificationError(
            "traces", f"leave {total} rows for {count} parameters", "record longer, or raise `rows_per_second`"
        )
    crossed = sum(one.z.T @ one.x for one in rows)
    size = np.sqrt(sum(np.sum(one.x**2, axis=0) for one in rows))
    if not size.all() or _condition(rows, size) < INDISTINCT or not np.isfinite(crossed).all():
        raise IdentificationError("write", "has terms that the motions do not tell apart", "write fewer")
    values = np.asarray(np.linalg.solve(crossed, sum(one.z.T @ one.y for one in rows)), np.float64)
    inverse = np.linalg.inv(crossed)
    covariance = inverse @ _scatter(rows, values) @ inverse.T
    return _feasible(Regression(values, covariance, total - count, (False,) * count), least)


def _condition(rows: Sequence[RegressionRows], size: FloatArray) -> float:
    """Smallest over largest singular value of the columns at length 1."""
    singular = np.linalg.svd(np.vstack([one.x for one in rows]) / size, compute_uv=False)
    return float(singular[-1] / singular[0])


def _scatter(rows: Sequence[RegressionRows], values: FloatArray) -> FloatArray:
    """(n, n) covariance of Z^T e, e an autoregression like the residuals."""
    noise = coloured([one.y - one.x @ values for one in rows], 1, [orth(one.x) for one in rows])
    return np.asarray(sum(one.z.T @ noise.times(one.z) for one in rows))


def _feasible(found: Regression, least: FloatArray) -> Regression:
    """The values from `least` up that are the nearest in the metric of the covariance."""
    if np.all(found.values >= least):
        return found
    scale = np.sqrt(np.diag(found.covariance))
    root = np.linalg.cholesky(np.linalg.pinv(found.covariance / np.outer(scale, scale), hermitian=True)).T
    nearest = lsq_linear(root, root @ (found.values / scale), (least / scale, np.inf), method="bvls").x * scale
    bound = tuple(bool(one) for one in nearest <= least + 1e-9 * scale)
    return Regression(np.maximum(nearest, least), found.covariance, found.freedom, bound)
