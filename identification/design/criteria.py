"""What information says about intervals, and the one figure that a design makes small."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from identification.design.study import Criterion
from orchestrator.trace import FloatArray

QUANTILE = 1.959963984540054  # of a two-sided 95 % interval under normal errors
UNSEEN = 1e-8  # eigenvalue of the information in columns of length 1, of the largest, below which nothing is seen


def covariance(information: FloatArray) -> FloatArray | None:
    """(n, n) the inverse; None where a combination of parameters is not seen."""
    size = np.sqrt(np.diag(information))
    if not (size > 0).all():
        return None
    scaled = information / np.outer(size, size)
    values, vectors = np.linalg.eigh(scaled)
    if values[0] < UNSEEN * values[-1]:
        return None
    found: FloatArray = np.asarray((vectors / values) @ vectors.T / np.outer(size, size))
    return found


def unseen(information: FloatArray) -> int:
    """The parameter that takes the largest part in what is seen least."""
    size = np.sqrt(np.diag(information))
    if not (size > 0).all():
        return int(np.argmin(size))
    _, vectors = np.linalg.eigh(information / np.outer(size, size))
    return int(np.argmax(np.abs(vectors[:, 0])))


def figure(information: FloatArray, criterion: Criterion, chosen: Sequence[int]) -> float:
    """The figure of a criterion, of these parameters; infinite where one of them is not determined.

    Args:
        information: (n, n) in z, whose entries are relative changes.
    """
    whole = covariance(information)
    if whole is None:
        return math.inf
    of = whole[np.ix_(chosen, chosen)]
    if criterion == "D":
        return float(np.exp(np.linalg.slogdet(of)[1] / (2 * len(chosen))))
    if criterion == "A":
        return float(np.sqrt(np.trace(of) / len(chosen)))
    if criterion == "E":
        return float(np.sqrt(np.linalg.eigvalsh(of)[-1]))
    return float(np.sqrt(np.diag(of).max()))


def half_widths(information: FloatArray) -> FloatArray:
    """(n,) of the 95 % intervals in z; infinite where there are none."""
    whole = covariance(information)
    return np.full(len(information), math.inf) if whole is None else QUANTILE * np.sqrt(np.diag(whole))
