"""Intervals by bootstrap: all is fitted anew to windows drawn with replacement, so that windows are what scatters.

Nothing is assumed of what happens inside a window. Levels are those of few blocks: percentiles of B estimates are too
narrow by sqrt((W - 1) / W) and by the normal distribution in the place of Student's t (Hesterberg 2015).

Source: Efron 1987 (BCa), with windows as blocks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr, ndtri, stdtrit

from fmus.errors import IdentificationError
from identification.estimation.arrow_least_squares import ArrowModel, Iterate, Point, WindowBlock, evaluated
from identification.estimation.uncertainty import Covariance, fewest_windows
from identification.output_error.search.intervals import Bootstrap, Intervals
from identification.output_error.search.work import Work, search
from orchestrator.trace import FloatArray

_MOST_FAILED = 0.1  # of the fits, from which their rest says nothing any more


def require_windows(windows: int, free: int) -> None:
    """See that there are windows enough to be drawn from.

    Raises:
        IdentificationError: there are not.
    """
    if windows < fewest_windows(free):
        raise IdentificationError(
            "uncertainty",
            f"{windows} windows are too few to be drawn from for {free} parameters",
            f"cut {fewest_windows(free)} or more, or use `uncertainty: profile`",
        )


def bootstrapped(work: Work, found: Iterate, blocks: Sequence[WindowBlock], uncertainty: Covariance) -> Intervals:
    """The intervals of all free parameters.

    Args:
        blocks: the windows linearised at `found`.
    """
    options, free = work.options.intervals, work.problem.parameters.free
    count = len(blocks)
    draws = np.random.default_rng(options.seed).integers(count, size=(options.resamples, count))
    fits = [
        _refitted(work.at_share(number / len(draws)), found, blocks, tuple(int(w) for w in np.sort(draw)))
        for number, draw in enumerate(draws)
    ]
    z = np.array([fit for fit in fits if fit is not None]).reshape(-1, len(free))
    failed = len(fits) - len(z)
    names, deleted = tuple(parameter.name for parameter in free), uncertainty.deleted
    kind = options.kind if deleted is not None else "percentile"
    values = np.array([[p.value(float(one)) for p, one in zip(free, row, strict=True)] for row in z])
    made = Bootstrap(names, values.reshape(-1, len(free)), failed, options.seed, kind)
    remarks = [f"{failed} of {len(fits)} fits of the bootstrap failed and are left out"] if failed else []
    if kind != options.kind:
        remarks.append("bootstrap intervals are percentiles, as leaving out single windows leaves parameters unseen")
    ends, known = dict.fromkeys(names, (-math.inf, math.inf)), np.isfinite(np.diag(uncertainty.matrix))
    if failed > _MOST_FAILED * len(fits):
        return Intervals("bootstrap", ends, {}, made, tuple(remarks))
    for column, parameter in enumerate(free):
        if not known[column]:
            continue
        estimate = float(found.point.parameters[column])
        left_out = deleted[:, column] if deleted is not None and kind == "bca" else None
        low, high = np.quantile(z[:, column], _levels(z[:, column], estimate, left_out, count))
        ends[parameter.name] = (parameter.value(float(low)), parameter.value(float(high)))
    return Intervals("bootstrap", ends, {}, made, tuple(remarks))


def _refitted(work: Work, found: Iterate, blocks: Sequence[WindowBlock], windows: tuple[int, ...]) -> FloatArray | None:
    """(n,) z of the parameters that match these windows best; None where no run succeeds."""
    problem, rows = work.problem, list(windows)
    point = Point(found.point.parameters, found.point.states[rows])
    own = work.over(windows).with_before([blocks[w] for w in windows], point)
    model = ArrowModel([problem.loss.scaled(block) for block in own])
    room = problem.box(windows).around(point)
    start = (point + model.step(1e-9, model.norms(), room)).clipped(problem.box(windows))
    begin = evaluated(work.over(windows), start, problem.loss) or evaluated(work.over(windows), point, problem.loss)
    if begin is None:
        return None
    end = search(work, windows, begin, "bootstrap", work.options.max_evaluations)
    return end.at.point.parameters if end.converged else None


def _levels(z: FloatArray, estimate: float, left_out: FloatArray | None, windows: int) -> tuple[float, float]:
    """The two levels whose quantiles are the interval's ends.

    Args:
        left_out: (W,) change of the estimate as each window is left out; percentiles without.
    """
    wide = math.sqrt(windows / (windows - 1)) * float(stdtrit(windows - 1, 0.975))
    if left_out is None or not np.any(left_out):
        return float(ndtr(-wide)), float(ndtr(wide))
    below = (np.sum(z < estimate) + 0.5 * np.sum(z == estimate)) / len(z)
    bias = float(ndtri(np.clip(below, 1 / len(z), 1 - 1 / len(z))))
    centred = left_out - left_out.mean()
    skewness = float(-np.sum(centred**3) / (6 * np.sum(centred**2) ** 1.5))
    low, high = (float(ndtr(bias + (bias + w) / (1 - skewness * (bias + w)))) for w in (-wide, wide))
    return low, high
