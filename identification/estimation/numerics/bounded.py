"""Least squares between bounds, without the half second that SciPy's optimizers take to load.

Source: Stark and Parker 1995 (active sets, entered and left by one unknown at a time).
"""

from __future__ import annotations

import numpy as np

from orchestrator.trace import FloatArray

_ROUNDING = 1e-12  # of the longest possible pull
_ROUNDS = 20  # for each unknown; a few are what it takes


def bounded_least_squares(matrix: FloatArray, target: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """(n,) x between the bounds (n,) of the least |matrix x - target|.

    Args:
        matrix: (N, n).
        target: (N,).
    """
    x = np.linalg.lstsq(matrix, target, rcond=None)[0]
    if np.all((x >= lower) & (x <= upper)):
        return np.asarray(x)
    x = np.clip(x, lower, upper)
    free, barred = (x > lower) & (x < upper), lower == upper
    pulls = np.linalg.norm(matrix, axis=0) * float(np.linalg.norm(target))
    for _ in range(_ROUNDS * (len(x) + 1)):
        there = x.copy()
        rest = target - matrix[:, ~free] @ x[~free]
        there[free] = np.linalg.lstsq(matrix[:, free], rest, rcond=None)[0] if free.any() else there[free]
        move = there - x
        room = np.where(move > 0, upper - x, lower - x)
        shares = np.divide(room, move, out=np.full(len(x), np.inf), where=free & (move != 0))
        first = int(np.argmin(shares))
        if shares[first] < 1:  # what meets its bound first stays there
            barred = lower == upper if shares[first] > 0 else barred | (np.arange(len(x)) == first)
            x = np.clip(x + shares[first] * move, lower, upper)
            x[first], free[first] = (upper if move[first] > 0 else lower)[first], False
            continue
        x, pull = there, matrix.T @ (target - matrix @ there)
        inwards = np.where(x <= lower, pull, 0.0) - np.where(x >= upper, pull, 0.0)
        inwards = np.where(free | barred, 0.0, inwards) / np.where(pulls > 0, pulls, 1.0)
        if inwards.max() <= _ROUNDING:
            return np.asarray(x)
        free[int(np.argmax(inwards))] = True
    from scipy.optimize import lsq_linear  # noqa: PLC0415 - loads slowly

    return np.asarray(lsq_linear(matrix, target, bounds=(lower, upper), method="bvls").x)
