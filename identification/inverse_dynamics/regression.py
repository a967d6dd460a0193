"""Linear regression with instruments, with intervals for correlated residuals, and what is physically feasible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from fmus.errors import IdentificationError
from orchestrator.trace import FloatArray

INDISTINCT = 1e-8  # singular value of columns of length 1, over the largest, below which they are not told apart
LAGS = 40  # places over which residuals are taken to be correlated


@dataclass(frozen=True, eq=False)
class RegressionRows:
    """Equations y = X theta + e of one record.

    Attributes:
        y: (K,) left sides.
        x: (K, n) columns.
        z: (K, n) instruments, which have nothing to do with e; the columns themselves for least squares.
        places: (K,) ascending numbers of the equations, between which there may be others that are left out.
    """

    y: FloatArray
    x: FloatArray
    z: FloatArray
    places: NDArray[np.intp]

    def laid_out(self, values: FloatArray) -> FloatArray:
        """Values (K,) or (K, n) at their places from the first on, 0 between."""
        out = np.zeros((int(self.places[-1] - self.places[0]) + 1, *values.shape[1:]))
        out[self.places - self.places[0]] = values
        return out


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

    The covariance is (Z^T X)^-1 Z^T N Z (X^T Z)^-1, N that of noise which is correlated like the
    residuals over `LAGS` places.

    Raises:
        IdentificationError: the columns cannot be told apart, or there are too few rows.

    Source: Soderstrom and Stoica 1983; Newey and West 1987.
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
    unbiased, tapered = (inverse @ scatter @ inverse.T for scatter in _scatters(rows, values))
    covariance = unbiased if np.all(np.diag(unbiased) > 0) else tapered
    return _feasible(Regression(values, covariance, total - count, (False,) * count), tapered, least)


def _condition(rows: Sequence[RegressionRows], size: FloatArray) -> float:
    """Smallest over largest singular value of the columns at length 1."""
    singular = np.linalg.svd(np.vstack([one.x for one in rows]) / size, compute_uv=False)
    return float(singular[-1] / singular[0])


def _scatters(rows: Sequence[RegressionRows], values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, n) covariances of Z^T e, e correlated like the residuals.

    By correlations that are means over pairs that are there, which is unbiased, but may leave variances negative; and
    by tapered ones, which does not.
    """
    left = [one.laid_out(one.y - one.x @ values) for one in rows]
    there = [one.laid_out(np.ones(len(one.y))) for one in rows]
    instruments = [one.laid_out(one.z) for one in rows]
    total, count = sum(len(one.y) for one in rows), len(values)
    pairs = np.array([_lagged(there, there, k) for k in range(LAGS)])
    sums = np.array([_lagged(left, left, k) for k in range(LAGS)])
    crossed = np.array([_lagged(instruments, instruments, k) for k in range(LAGS)])
    crossed[1:] += crossed[1:].transpose(0, 2, 1)
    correlations = np.divide(sums, pairs, out=np.zeros(LAGS), where=pairs > 0) * total / (total - count)
    tapered = sums / (total - count) * (1 - np.arange(LAGS) / LAGS)
    unbiased, positive = (np.asarray(np.tensordot(one, crossed, 1)) for one in (correlations, tapered))
    return unbiased, positive


def _lagged(some: Sequence[FloatArray], others: Sequence[FloatArray], lag: int) -> FloatArray:
    """Sum over records of products of what is so many places apart."""
    return np.asarray(sum(a[: max(len(a) - lag, 0)].T @ b[lag:] for a, b in zip(some, others, strict=True)))


def _feasible(found: Regression, covariance: FloatArray, least: FloatArray) -> Regression:
    """The values from `least` up that are the nearest in the metric of this covariance (n, n)."""
    if np.all(found.values >= least):
        return found
    scale = np.sqrt(np.diag(covariance))
    root = np.linalg.cholesky(np.linalg.pinv(covariance / np.outer(scale, scale), hermitian=True)).T
    nearest = lsq_linear(root, root @ (found.values / scale), (least / scale, np.inf), method="bvls").x * scale
    bound = tuple(bool(one) for one in nearest <= least + 1e-9 * scale)
    return Regression(np.maximum(nearest, least), found.covariance, found.freedom, bound)
