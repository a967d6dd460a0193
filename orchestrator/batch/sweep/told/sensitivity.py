"""What the figures of a sweep depend on: rank correlations, and indices of points that were chosen for them.

The indices are SALib's (an extra); groups of points in which a run has no figure are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from orchestrator.batch.sweep.points.designs import Morris, PointDesign, SobolIndices
from orchestrator.trace import FloatArray

RESAMPLES = 200  # of bootstrapped intervals
MISSING = "SALib is not installed: pip install 'servotwin[sensitivity]'"


@dataclass(frozen=True)
class Index:
    """A sensitivity of a figure to a factor.

    Attributes:
        kind: "S1" and "ST" of Sobol', "S2" of a pair (`factor` has both names); "mu*" and "sigma" of Morris.
        confidence: half the width of its 95 % interval, None where it has none.
    """

    factor: str
    kind: str
    value: float
    confidence: float | None


@dataclass(frozen=True)
class Indices:
    """All indices of a figure.

    Attributes:
        groups: base samples or trajectories that they are made of.
        left_out: those in which a run has no figure.
    """

    entries: Sequence[Index]
    groups: int
    left_out: int


def rank_correlations(values: FloatArray, figures: FloatArray) -> FloatArray:
    """(d,) Spearman's coefficients of figures (N,) with each column of values (N, d); NaN where one never changes."""
    known = np.isfinite(figures)
    ranked = stats.rankdata(figures[known])
    found = np.full(values.shape[1], np.nan)
    for place, column in enumerate(values[known].T):
        if len(ranked) > 2 and np.ptp(column) > 0 and np.ptp(ranked) > 0:
            found[place] = np.corrcoef(stats.rankdata(column), ranked)[0, 1]
    return found


def indices(design: PointDesign, points: FloatArray, figures: FloatArray, names: Sequence[str]) -> Indices | None:
    """The indices of figures (N,) at all points (N, d) of a design; None where it has none, or no group is whole.

    Raises:
        ImportError: SALib is not there.
    """
    if not isinstance(design, SobolIndices | Morris):
        return None
    groups = figures.reshape(-1, design.size)
    whole = np.isfinite(groups).all(axis=1)
    kept, places = groups[whole], points.reshape(-1, design.size, points.shape[1])[whole]
    if len(kept) < 2 or np.ptp(kept) == 0:
        return None
    problem = {"num_vars": len(names), "names": list(names), "bounds": [[0.0, 1.0]] * len(names)}
    if isinstance(design, SobolIndices):
        entries = _sobol(problem, kept.ravel(), design)
    else:
        entries = _morris(problem, places.reshape(-1, len(names)), kept.ravel(), design)
    return Indices(entries, len(kept), int((~whole).sum()))


def _sobol(problem: dict[str, Any], figures: FloatArray, design: SobolIndices) -> list[Index]:
    from SALib.analyze import sobol  # noqa: PLC0415 (an extra)

    spread = (figures - figures.mean()) / figures.std()  # as SALib asks for
    found = sobol.analyze(
        problem, spread, calc_second_order=design.second_order, num_resamples=RESAMPLES, seed=design.seed
    )
    names = problem["names"]
    entries = [
        Index(name, kind, float(found[kind][place]), float(found[f"{kind}_conf"][place]))
        for kind in ("S1", "ST")
        for place, name in enumerate(names)
    ]
    if design.second_order:
        entries += [
            Index(f"{names[i]}, {names[j]}", "S2", float(found["S2"][i, j]), float(found["S2_conf"][i, j]))
            for i in range(len(names))
            for j in range(i + 1, len(names))
        ]
    return entries


def _morris(problem: dict[str, Any], points: FloatArray, figures: FloatArray, design: Morris) -> list[Index]:
    from SALib.analyze import morris  # noqa: PLC0415 (an extra)

    found = morris.analyze(
        problem, points, figures, num_levels=design.levels, num_resamples=RESAMPLES, seed=design.seed
    )
    effects = [
        Index(name, "mu*", float(found["mu_star"][place]), float(found["mu_star_conf"][place]))
        for place, name in enumerate(problem["names"])
    ]
    return effects + [
        Index(name, "sigma", float(found["sigma"][place]), None) for place, name in enumerate(problem["names"])
    ]
