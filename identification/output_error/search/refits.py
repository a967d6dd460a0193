"""What is said of an estimate where the search ended: covariance, what is seen, and intervals by fits of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.estimation.arrow_least_squares import Iterate, Minimum, WindowBlock
from identification.estimation.identifiability import Identifiability, identifiability
from identification.estimation.information import Information, information
from identification.estimation.uncertainty import Covariance, covariance, growth
from identification.output_error.search.bootstrap import bootstrapped
from identification.output_error.search.intervals import LOCAL, Intervals
from identification.output_error.search.profile import profiled
from identification.output_error.search.profile_curve import CostProfile
from identification.output_error.search.work import PERFECT, Work, is_perfect
from identification.output_error.times.lateness import OutputLateness, lateness

GROWN = 1e6  # what a free run makes of a deviation of its start from where on too few digits are left


@dataclass(frozen=True)
class Spoken:
    """What is said of an estimate.

    Attributes:
        blocks: the windows linearised there.
        told: which samples inform which parameter.
        late: how late outputs seem to be recorded, where residuals speak for it.
        better: a point of less cost, met while profiles were followed.
    """

    blocks: Sequence[WindowBlock]
    uncertainty: Covariance
    seen: Identifiability
    told: Information
    intervals: Intervals = LOCAL
    late: OutputLateness | None = None
    better: Iterate | None = None


def spoken(work: Work, found: Minimum) -> Spoken:
    """All that is asked for, by the derivatives at the estimate and further fits."""
    work.tell("uncertainty")(found.iterations, found.at)
    problem, run = work.problem, work.over(work.all_windows)
    blocks, remarks = _linearised(work, found.at)
    before = run.before(found.at.point) if problem.parameters.is_known_of else None
    uncertainty = covariance(blocks, problem.loss, len(problem.outputs), problem.rounding, before, work.reached.noise)
    uncertainty = uncertainty.repeated(problem.counted)
    seen = _seen(work, found.at, blocks)
    told = information(blocks, uncertainty.curvature, len(problem.outputs))
    by, perfect = work.options.intervals.by, is_perfect(work, found)
    late = None if perfect else lateness(problem, blocks, uncertainty, before, work.reached.noise)
    said = Spoken(blocks, uncertainty, seen, told, late=late)
    if remarks:
        return replace(said, intervals=Intervals(remarks=remarks))
    if by == "local" or not problem.parameters.free:
        return said
    if perfect:
        remark = f"intervals are local, no {by}s: {PERFECT}, so that there is no noise to hold values against"
        return replace(said, intervals=Intervals(remarks=(remark,)))
    if by == "bootstrap":
        return replace(said, intervals=bootstrapped(work, found.at, blocks, uncertainty))
    silent = {column for column, range_ in work.reached.flats.items() if range_.silent}
    columns = [column for column in range(len(problem.parameters.free)) if column not in silent]
    found_curves = profiled(work, found.at, uncertainty, columns)
    return replace(said, intervals=_by_profiles(found_curves.curves), better=found_curves.better)


def _linearised(work: Work, at: Iterate) -> tuple[Sequence[WindowBlock], tuple[str, ...]]:
    """The windows linearised, and what is to be said of that.

    Where free runs make so much of their start values that rounding is all that is left of other columns beside theirs,
    it is by their joined segments.
    """
    shot, how, kind = work.reached.shot, work.options.intervals.by, work.problem.loss.kind
    if shot is not None and shot.growth >= GROWN:
        said = [f"intervals are local, by segments, and not by {how}"] if how != "local" else []
        said += ["segments are joined by least squares, without the study's loss"] if kind != "linear" else []
        return shot.blocks, tuple(f"{one}: {_grown(shot.growth)}" for one in said)
    residuals = work.problem.measured_only(at.residuals, work.all_windows)
    blocks = work.over(work.all_windows).linearised(at.point, residuals, central=True)
    most = max(growth(block.states) for block in blocks)
    return blocks, (f"intervals are rounding: {_grown(most)}; use `shooting`",) if most >= GROWN else ()


def _grown(times: float) -> str:
    return f"free runs make {times:.1g} times as much of a deviation at their start"


def _seen(work: Work, at: Iterate, blocks: Sequence[WindowBlock]) -> Identifiability:
    parameters, z = work.problem.parameters, at.point.parameters
    values = parameters.values(z)
    return identifiability(
        blocks, parameters.free, np.array([values[p.name] for p in parameters.free]), parameters.slopes(z)
    )


def _by_profiles(curves: Mapping[str, CostProfile]) -> Intervals:
    said = [
        f"{name}: its 95 % interval has no {side} end, {reason}"
        for name, curve in curves.items()
        for side, reason in curve.open.items()
    ]
    said += [
        f"{name}: the {side} end of its 95 % interval is where {' and '.join(others)} cannot go on beyond their bounds"
        for name, curve in curves.items()
        for side, others in curve.held_by.items()
    ]
    return Intervals("profile", {name: curve.ends for name, curve in curves.items()}, curves, remarks=tuple(said))
