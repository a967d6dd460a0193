"""Candidates ranked: what predicts recordings that were not fitted no worse than the best, and then by criteria.

A candidate is out where its prediction of the windows held out is worse than the best one's by more than scatters from
window to window; of the others the one of least BIC is chosen. (The one-standard-error rule of cross-validation, with
paired differences and Student's t in its place: Hastie, Tibshirani and Friedman 2009, Section 7.10.)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from identification.output_error.choice.criteria import Criteria, Misfit, criteria
from orchestrator.trace import FloatArray

LEVEL = 0.99  # of Student's t, from which on a prediction is worse
TELLING = 6.0  # difference of BIC from which on it tells ("strong": Kass and Raftery 1995)


@dataclass(frozen=True)
class Ranked:
    """How one candidate stands.

    Attributes:
        unseen: mean square of its prediction error over that of what was recorded, in the windows held out; None
            without any.
        worse: by how much that is more than the chosen one's; less is negative.
        scatter: within which such a difference tells nothing; infinite with one window.
        apart: whether the recordings tell it from the chosen one.
    """

    criteria: Criteria
    unseen: float | None
    worse: float | None
    scatter: float | None
    apart: bool


@dataclass(frozen=True)
class CandidateRanking:
    """Candidates in their order, the chosen one first.

    Attributes:
        windows: held out.
        contested: whom the criteria prefer although its prediction is worse; nobody where they agree.
    """

    rows: Mapping[str, Ranked]
    windows: int
    contested: str | None

    @property
    def chosen(self) -> str:
        """The name of the best one."""
        return next(iter(self.rows))

    @property
    def alike(self) -> tuple[str, ...]:
        """Those that the recordings do not tell from the chosen one."""
        return tuple(name for name, row in self.rows.items() if not row.apart and name != self.chosen)


def ranked(misfits: Mapping[str, Misfit], unseen: Mapping[str, FloatArray]) -> CandidateRanking:
    """The ranking.

    Args:
        unseen: name -> (W,) mean square of the prediction error in each window held out; empty without any.
    """
    known = criteria(misfits)
    windows = len(next(iter(unseen.values()))) if unseen else 0
    best = min(unseen, key=lambda name: float(np.mean(unseen[name]))) if windows else None
    predicts = {name: best is None or _no_worse(unseen[name], unseen[best]) for name in misfits}
    order = sorted(misfits, key=lambda name: (not predicts[name], known[name].bic))
    chosen = order[0]
    preferred = min(misfits, key=lambda name: known[name].bic)
    rows = {}
    for name in order:
        worse, scatter = _difference(unseen[name], unseen[chosen]) if windows else (None, None)
        alike = worse is None or scatter is None or abs(worse) <= scatter
        apart = name != chosen and not (alike and known[name].bic - known[chosen].bic < TELLING)
        mean = float(np.mean(unseen[name])) if windows else None
        rows[name] = Ranked(known[name], mean, worse, scatter, apart)
    return CandidateRanking(rows, windows, None if preferred == chosen else preferred)


def _difference(errors: FloatArray, others: FloatArray) -> tuple[float, float]:
    """By how much the mean of (W,) errors is above that of others, and within which that tells nothing."""
    windows, paired = len(errors), errors - others
    if windows < 2:
        return float(np.mean(paired)), math.inf
    spread = float(np.std(paired, ddof=1)) / math.sqrt(windows)
    return float(np.mean(paired)), float(stdtrit(windows - 1, LEVEL)) * spread


def _no_worse(errors: FloatArray, others: FloatArray) -> bool:
    worse, scatter = _difference(errors, others)
    return worse <= scatter
