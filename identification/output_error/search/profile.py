"""Profile likelihood: one parameter is held beside its estimate, all others are fitted anew, and the cost says how far.

A value belongs to the 95 % interval while the best cost with it lies so little above the least one that noise explains
it. How much that is follows from the covariance: where the outputs go along linearly, profiles give its intervals, and
their threshold is that of F(1, degrees of freedom) under white noise, stretched where noise is coloured, outputs differ
in it or windows scatter (Chandler and Bate 2007).

Source: Venzon and Moolgavkar 1988; Raue et al. 2009.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from identification.estimation.arrow_least_squares import Iterate, Point, evaluated
from identification.estimation.parameters import Parameter
from identification.estimation.uncertainty import Covariance
from identification.output_error.search.estimate import Reached
from identification.output_error.search.profile_curve import CostProfile, ProfileSide
from identification.output_error.search.work import Work, search

_FIRST = 0.02  # scaled: the first step of a parameter whose local interval is not known
_FAR, _FAR_LOG = 100.0, math.log(1e3)  # scaled: how far an open side is followed
_MOST = 20  # fits on one side
_LOWER = 0.1  # of the rise for one parameter: by so much a point has to be better to be another minimum
_TIGHT = 1e-3  # of the rise at an interval's end: to what the other parameters are fitted


@dataclass(frozen=True, eq=False)
class Profiled:
    """The profiles of parameters by name; and a better point than the estimate, where one was met on the way."""

    curves: Mapping[str, CostProfile]
    better: Iterate | None = None


def profiled(work: Work, found: Iterate, uncertainty: Covariance, columns: Iterable[int]) -> Profiled:
    """The profiles of these columns of the free parameters, from the least cost at `found`.

    It stops where a better point is met, as profiles and intervals are those of the least cost.
    """
    work = _tightened(work, found, uncertainty)
    windows = work.all_windows
    found = search(work, windows, found, "profile", work.options.max_evaluations).at
    curves: dict[str, CostProfile] = {}
    columns = list(columns)
    for number, column in enumerate(columns):
        tracing = _Tracing(work.at_share(number / len(columns)), column, found, uncertainty)
        curves[tracing.parameter.name] = tracing.profile()
        if tracing.better is not None:
            return Profiled(curves, tracing.better)
    return Profiled(curves)


def _tightened(work: Work, found: Iterate, uncertainty: Covariance) -> Work:
    """Searches that end where they change the rise at an interval's end by little."""
    scale = float(np.min(uncertainty.stretch, initial=math.inf))
    rise = 0.5 * scale * uncertainty.quantile**2
    relative = _TIGHT * rise / found.cost if found.cost > 0 and math.isfinite(rise) else math.inf
    widths = np.sqrt(np.diag(uncertainty.matrix))
    step = _TIGHT * float(np.min(widths[widths > 0], initial=math.inf))
    options = replace(
        work.options,
        cost_tolerance=max(1e-14, min(work.options.cost_tolerance, relative)),
        step_tolerance=max(1e-14, min(work.options.step_tolerance, step)),
    )
    return replace(work, options=options)


@dataclass
class _Tracing:
    """One parameter's profile, being followed.

    Attributes:
        origin: where the cost is least.
        better: a point of less cost that was met.
        known: z -> rise of the points that were fitted.
        held_by: "lower" or "upper" -> parameters that come to a bound on the way there.
    """

    work: Work
    column: int
    origin: Iterate
    uncertainty: Covariance
    better: Iterate | None = None
    known: dict[float, float] = field(default_factory=dict)
    held_by: dict[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def parameter(self) -> Parameter:
        return self.work.problem.parameters.free[self.column]

    @property
    def centre(self) -> float:
        """z of the estimate."""
        return float(self.origin.point.parameters[self.column])

    def profile(self) -> CostProfile:
        """To both sides, from the estimate until the threshold, a bound, or where it cannot be followed."""
        self.known[self.centre] = 0.0
        sides = [self._side(sign) for sign in (-1.0, 1.0) if self.better is None]
        ends = [side.end(self.parameter) for side in sides]
        reasons = {name: s.reason for name, s in zip(("lower", "upper"), sides, strict=False) if s.reason}
        points = sorted(self.known.items())
        return CostProfile(
            name=self.parameter.name,
            values=np.array([self.parameter.value(z) for z, _ in points]),
            rise=np.array([rise for _, rise in points]),
            threshold=self.uncertainty.quantile**2,
            ends=(ends[0], ends[1]) if len(ends) == 2 else (-math.inf, math.inf),
            open=reasons,
            held_by={name: at for name, at in self.held_by.items() if name not in reasons},
        )

    def _side(self, sign: float) -> ProfileSide:
        lower, upper = self.parameter.z_bounds
        far = _FAR_LOG if self.parameter.scale == "log" else _FAR
        room = min(far, (upper - self.centre) if sign > 0 else (self.centre - lower))
        side = ProfileSide(sign, self.centre, room, self.uncertainty.quantile, self._first(room), at_bound=room < far)
        at = last = self.origin
        for _ in range(_MOST):
            if side.ended or self.better is not None:
                break
            z = self.centre + sign * side.next
            there = self._fitted(z, self._ahead(last, at, z)) or self._fitted(z, at.point)
            if there is None:
                side.failed()
                continue
            rise = self._rise(there)
            self.known[z] = max(rise, 0.0)
            if others := self._at_bounds(there):
                self.held_by["lower" if sign < 0 else "upper"] = others
            if side.reached(math.sqrt(max(rise, 0.0))):
                last, at = at, there
        return side

    def _at_bounds(self, there: Iterate) -> tuple[str, ...]:
        """The other parameters that have come to a bound, and were not at the estimate."""
        lower, upper = self.work.problem.parameters.z_bounds
        now, before = ((z <= lower) | (z >= upper) for z in (there.point.parameters, self.origin.point.parameters))
        free = self.work.problem.parameters.free
        return tuple(free[c].name for c in np.flatnonzero(now & ~before) if c != self.column)

    def _first(self, room: float) -> float:
        """How far the first fit is from the estimate: half of a local interval's half."""
        reach = 0.5 * self.uncertainty.quantile * math.sqrt(float(self.uncertainty.matrix[self.column, self.column]))
        return min(room, reach if 0 < reach < room else _FIRST)

    def _ahead(self, last: Iterate, at: Iterate, z: float) -> Point:
        """Where the others are to be expected: along the line through the last two fits, at first by the covariance."""
        way = float(at.point.parameters[self.column] - last.point.parameters[self.column])
        step = z - float(at.point.parameters[self.column])
        if way:
            share = step / way
            moved = at.point - last.point
            return Point(at.point.parameters + share * moved.parameters, at.point.states + share * moved.states)
        row = self.uncertainty.curvature[self.column]
        own = float(row[self.column])
        slopes = np.where(np.isfinite(row), row, 0.0) / own if 0 < own < math.inf else np.zeros_like(row)
        return replace(at.point, parameters=at.point.parameters + step * slopes)

    def _fitted(self, z: float, start: Point) -> Iterate | None:
        """The least cost with the parameter held there; None where no run succeeds."""
        held, windows = _held(self.work, self.column, z), self.work.all_windows
        begin = Point(np.delete(start.parameters, self.column), start.states).clipped(held.problem.box(windows))
        there = evaluated(held.over(windows), begin, held.problem.loss)
        if there is None:
            return None
        if held.problem.unknowns:
            there = search(held, windows, there, "profile", held.options.max_evaluations).at
        return replace(there, point=replace(there.point, parameters=np.insert(there.point.parameters, self.column, z)))

    def _rise(self, there: Iterate) -> float:
        """By how much the cost lies above the least, in units of what one parameter explains of noise."""
        scale = float(self.uncertainty.stretch[self.column])
        rise = 2.0 * (there.cost - self.origin.cost) / scale
        if rise < -_LOWER:
            self.better = there
        return rise


def _held(work: Work, column: int, z: float) -> Work:
    """The same work with one parameter held."""
    parameters = work.problem.parameters
    one = parameters.free[column]
    problem = replace(work.problem, parameters=parameters.held(one.name, one.value(z)))
    wide = {c - (c > column): width for c, width in work.reached.wide.items() if c != column}
    rough = {c - (c > column): one for c, one in work.reached.rough.items() if c != column}
    return replace(work, problem=problem, reached=Reached(work.tally, wide=wide, rough=rough, noise=work.reached.noise))
