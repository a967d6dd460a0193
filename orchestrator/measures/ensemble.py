"""Whether a signal is one more of several that differ by their noise alone, with a stated chance of a false answer.

The rank test of exchangeable draws: scored among all others by a rule that treats all alike, a signal of the same kind
is as likely to have any rank, whatever the noise (Barnard 1963; conformal prediction: Vovk, Gammerman, Shafer 2005).
The score is that of a band: how far a signal leaves the quantiles of all, at the instant where it does so most.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fmus.errors import TraceError
from orchestrator.trace import FloatArray

LEAST_WIDTH = 1e-3  # of the range of all: half a band is never narrower, where the noise has not begun, say
_INSTANTS = 1 << 14  # that are sorted at a time


@dataclass(frozen=True)
class Membership:
    """How a signal stands among draws.

    Attributes:
        chance: that one more draw stands as far out or farther [1]: of the signals, itself included, the share that do.
        score: of the signal: farthest distance from the median, in half widths of the band.
        median_score: of the draws.
        at: row of the instant where it is farthest out.
    """

    chance: float
    score: float
    median_score: float
    at: int


def membership(values: ArrayLike, draws: ArrayLike, low: float = 0.05, high: float = 0.95) -> Membership:
    """How values (K,) stand among draws (N, K) at the same instants.

    Args:
        low, high: quantiles of all that make the band.

    Raises:
        TraceError: there is no draw, shapes do not fit, a value is not finite, or the quantiles do not hold the median.
    """
    pool = _pooled(values, draws, low, high)
    scores, at = _farthest(pool, low, high)
    chance = float(np.mean(scores >= scores[0]))
    return Membership(chance, float(scores[0]), float(np.median(scores[1:])), at)


def band(values: ArrayLike, draws: ArrayLike, low: float, high: float, rank: int) -> tuple[FloatArray, FloatArray]:
    """(K,) lower and upper bounds that values (K,) keep to just where at least so many draws (N, K) stand as far out.

    Args:
        low, high: as in `membership`, which raises the same errors.
        rank: of the draw, from outside, up to which the band of all is widened.
    """
    pool = _pooled(values, draws, low, high)
    scores, _ = _farthest(pool, low, high)
    wide = float(np.sort(scores[1:])[-rank])
    bottom, middle, top = np.quantile(pool, [low, 0.5, high], axis=0)
    least = _least(pool)
    return middle - wide * np.maximum(middle - bottom, least), middle + wide * np.maximum(top - middle, least)


def _pooled(values: ArrayLike, draws: ArrayLike, low: float, high: float) -> FloatArray:
    """(N + 1, K) the signal and the draws, as they can be compared."""
    y, drawn = np.asarray(values, dtype=float), np.atleast_2d(np.asarray(draws, dtype=float))
    if y.ndim != 1 or not len(y) or not len(drawn) or drawn.shape[1:] != y.shape:
        raise TraceError("draws", f"have shape {drawn.shape}, the signal {y.shape}", "record both alike")
    if not (np.all(np.isfinite(y)) and np.all(np.isfinite(drawn))):
        raise TraceError("draws", "a value is not finite", "mend the run first")
    if not 0 <= low < 0.5 < high <= 1:
        raise TraceError("draws", f"the quantiles {low:g} and {high:g} do not hold the median", "give 0.05 and 0.95")
    return np.vstack([y, drawn])


def _least(pool: FloatArray) -> float:
    return LEAST_WIDTH * float(np.ptp(pool))


def _farthest(pool: FloatArray, low: float, high: float) -> tuple[FloatArray, int]:
    """(N + 1,) how far out each comes, and the row of the instant where the first does."""
    least = _least(pool)
    scores, at = np.zeros(len(pool)), 0
    for first in range(0, pool.shape[1], _INSTANTS):
        piece = _scores(pool[:, first : first + _INSTANTS], low, high, least)
        most = piece.max(axis=1)
        at = first + int(np.argmax(piece[0])) if most[0] > scores[0] else at
        scores = np.maximum(scores, most)
    return scores, at


def _scores(pool: FloatArray, low: float, high: float, least: float) -> FloatArray:
    """(N + 1, K) distance from the median in half widths of the band, above and below by themselves."""
    bottom, middle, top = np.quantile(pool, [low, 0.5, high], axis=0)
    away = pool - middle
    if least == 0:
        return np.zeros_like(pool)
    width = np.where(away > 0, np.maximum(top - middle, least), np.maximum(middle - bottom, least))
    return np.asarray(np.abs(away) / width)
