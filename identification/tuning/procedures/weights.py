"""Quadratic weights as a study writes them: one for all, a diagonal, a matrix, or of signals by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fmus.errors import IdentificationError
from orchestrator.trace import FloatArray

ROUNDING = 1e-10  # of the largest eigenvalue, by which one may be negative
Given = float | Sequence[float] | Sequence[Sequence[float]] | Mapping[str, float]


@dataclass(frozen=True)
class Weights:
    """Of the states (Q) and of what acts on them (R)."""

    q: Given = 1.0
    r: Given = 1.0


def weight(place: str, given: Given, size: int, named: Mapping[str, FloatArray], definite: bool = False) -> FloatArray:
    """(size, size) the symmetric matrix that is meant.

    Args:
        given: a number times the identity, a diagonal, a matrix, or name -> the weight of what stands under it.
        named: signal -> (size,) what it is of that which is weighted.
        definite: whether it has to be definite, or may be only semidefinite.

    Raises:
        IdentificationError: it is of another size, not symmetric or not (semi)definite, or names what is not there.
    """
    matrix = _of_signals(place, given, size, named) if isinstance(given, Mapping) else _of_numbers(place, given, size)
    if not np.isfinite(matrix).all():
        raise IdentificationError(place, "is not finite", "give numbers")
    if np.abs(matrix - matrix.T).max(initial=0.0) > ROUNDING * np.abs(matrix).max(initial=0.0):
        raise IdentificationError(place, "is not symmetric", "give it the same numbers on both sides of its diagonal")
    values = np.linalg.eigvalsh(matrix)
    lowest, wanted = float(values[0]), "definite" if definite else "semidefinite"
    if lowest < -ROUNDING * np.abs(values).max() or (definite and lowest <= 0):
        problem = f"is not positive {wanted}: it has the eigenvalue {lowest:.4g}"
        raise IdentificationError(place, problem, f"give weights {'above 0' if definite else 'of 0 and above'}")
    return matrix


def _of_signals(place: str, given: Mapping[str, float], size: int, named: Mapping[str, FloatArray]) -> FloatArray:
    matrix = np.zeros((size, size))
    for name, number in given.items():
        if name not in named:
            raise IdentificationError(f"{place}.{name}", "is no signal of the plant here", f"name {', '.join(named)}")
        if number < 0:
            raise IdentificationError(f"{place}.{name}", f"is {number:g}, not semidefinite", "give 0 or more")
        matrix += number * np.outer(named[name], named[name])
    return matrix


def _of_numbers(place: str, given: float | Sequence[float] | Sequence[Sequence[float]], size: int) -> FloatArray:
    found = np.asarray(given, dtype=float)
    if found.ndim == 0:
        return float(found) * np.eye(size)
    if found.shape == (size,):
        return np.diag(found)
    if found.shape == (size, size):
        return found
    problem = f"is {' x '.join(map(str, found.shape))}, and there are {size} to be weighted"
    raise IdentificationError(place, problem, f"give one number, {size} of them, a {size} x {size} matrix or names")
