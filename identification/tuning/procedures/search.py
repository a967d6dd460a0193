"""A search for a controller's parameters: from several starts, within bounds, under hard goals (Eq. 4-3).

From each start a quadratic program is followed to its end, and a simplex goes on from there, since margins have kinks.
Where no point holds all hard goals the one that misses least is sought, and the goals that bind there are told.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from fmus.errors import IdentificationError
from identification.estimation.parameters import Scale
from identification.linear.model import LinearModel
from identification.tuning.procedures.problem import Judgement, Problem
from identification.tuning.procedures.procedure import HELD, Descent, Found
from orchestrator.assembly.assembly import ComponentSpec
from orchestrator.fmi.interface import Interface, Port
from orchestrator.progress import Progress
from orchestrator.trace import FloatArray

SLOPE = 1e-6  # width of differences, of the span between the bounds
FAR = 1e3  # what an unstable loop counts in place of an objective, of the start's
DEAR = 10.0  # of the simplex: what a missed goal counts beside the objective
MOST = 400  # evaluations on the way to a stable loop
ROUNDS = 12  # of a search with draws
AT_ONCE = 4  # draws that join it in a round
TOGETHER = 1e-3  # of the span between the bounds, within which two optima are one
Merit = Callable[[FloatArray], float]


@dataclass(frozen=True)
class Unknown:
    """A parameter of the controller that is sought.

    Attributes:
        low, high, start: in its unit, or like `5 V`; without a start that of the FMU.
        scale: in which steps are taken between the bounds.
    """

    low: float | str
    high: float | str
    start: float | str | None = None
    scale: Scale = "linear"

    def span(self, port: Port) -> Span:
        """In numbers.

        Raises:
            InputError: a unit of another quantity, or bounds that are none.
        """
        place = f"unknowns.{port.name}"
        low, high = (port.number(place, end) for end in (self.low, self.high))
        given = self.start if self.start is not None else float(port.start or 0.0)
        start = port.number(place, given)
        if not low < high:
            raise IdentificationError(place, f"has the bounds {low:g} and {high:g}", "give `min` below `max`")
        if self.scale == "log" and low <= 0:
            raise IdentificationError(place, f"is searched in a log scale from {low:g}", "give a `min` above 0")
        for name, limit, out in (("min", port.minimum, low), ("max", port.maximum, high)):
            if limit is not None and (out < limit if name == "min" else out > limit):
                raise IdentificationError(place, f"is searched to {out:g}, outside its {name} {limit:g}", "narrow it")
        if not low <= start <= high:
            raise IdentificationError(
                place, f"starts at {start:g}, outside [{low:g}, {high:g}]", "give another `start`"
            )
        return Span(port.name, low, high, start, self.scale)


@dataclass(frozen=True)
class Span:
    """An unknown in numbers, between its bounds."""

    name: str
    low: float
    high: float
    start: float
    scale: Scale

    def value(self, part: float) -> float:
        """Between the bounds, from 0 to 1."""
        inside = (
            self.low * (self.high / self.low) ** part
            if self.scale == "log"
            else self.low + part * (self.high - self.low)
        )
        return float(min(max(inside, self.low), self.high))

    def part(self, value: float) -> float:
        """Where a value lies, 0 at the lower and 1 at the upper bound."""
        if self.scale == "log":
            return float(np.log(value / self.low) / np.log(self.high / self.low))
        return float((value - self.low) / (self.high - self.low))


@dataclass(frozen=True)
class Search:
    """A search over parameters of the controller.

    Attributes:
        unknowns: by the parameter's name.
        starts: points, each parameter -> value; without any the unknowns' own starts.
        more: how many further ones are drawn between the bounds, by `seed`.
        evaluations: the most that a simplex may take.
    """

    unknowns: Mapping[str, Unknown]
    starts: tuple[Mapping[str, float | str], ...] = ()
    more: int = 0
    seed: int = 0
    evaluations: int = 60

    def sized(self, controller: ComponentSpec, plants: Mapping[str, LinearModel]) -> ComponentSpec:
        """The controller as it is: its arrays are the study's."""
        return controller

    def check(self, interface: Interface) -> None:
        """See that the unknowns are parameters of the controller.

        Raises:
            InputError: one is not, or its bounds are none.
        """
        self._points(interface)

    def run(self, problem: Problem, interface: Interface, progress: Progress) -> Found:
        """The best of where all starts lead."""
        spans, points = self._points(interface)
        rng = np.random.default_rng(self.seed)
        points += [rng.uniform(0, 1, len(spans)) for _ in range(self.more)]
        descents = []
        for number, point in enumerate(points):
            progress(number / len(points), f"start {number + 1} of {len(points)}")
            descents.append(_descent(problem, spans, point, self.evaluations))
        best = min((descent.found for descent in descents), key=_rank)
        agreeing = _agreeing(spans, descents, best)
        starts = {span.name: descents[0].start[span.name] for span in spans}
        if problem.draws is None:
            return Found(best, starts, tuple(descents), agreeing)
        best, drawn = _with_draws(problem, spans, best, points, self.evaluations, progress)
        return Found(best, starts, tuple(descents), agreeing, (), drawn, problem.share)

    def _points(self, interface: Interface) -> tuple[list[Span], list[FloatArray]]:
        """The unknowns in numbers, and the given starts between their bounds."""
        ports = [_port(interface, name) for name in self.unknowns]
        spans = [unknown.span(port) for unknown, port in zip(self.unknowns.values(), ports, strict=True)]
        points = []
        for number, given in enumerate(self.starts or ({},)):
            values = []
            for span, port in zip(spans, ports, strict=True):
                place = f"starts.{number}.{span.name}"
                value = port.number(place, given[span.name]) if span.name in given else span.start
                if not span.low <= value <= span.high:
                    raise IdentificationError(place, f"is {value:g}, outside [{span.low:g}, {span.high:g}]", "move it")
                values.append(span.part(value))
            points.append(np.array(values))
        return spans, points


def _port(interface: Interface, name: str) -> Port:
    """A real parameter of the controller.

    Raises:
        IdentificationError: there is none of this name.
    """
    port = interface.ports.get(name)
    if port is None or port.causality != "parameter" or not port.real:
        known = ", ".join(p.name for p in interface.of("parameter") if p.real and p.array is None)
        raise IdentificationError(f"unknowns.{name}", "is no real parameter of the controller", f"there are {known}")
    return port


def _with_draws(
    problem: Problem,
    spans: Sequence[Span],
    best: Judgement,
    points: Sequence[FloatArray],
    evaluations: int,
    tell: Progress,
) -> tuple[Judgement, Judgement]:
    """The best values with which enough draws hold the hard goals, too, and what all draws do to these goals.

    Only those draws stand in the search that have spoilt an earlier round's values: a handful decides. It goes on from
    there, and from the first start, since what was best without draws may be far off.
    """
    assert problem.draws is not None
    hard = tuple(goal for goal in problem.goals if goal.hard and not goal.minimised)
    every, active = replace(problem.on(problem.draws), goals=hard), list[int]()
    count = len(every.plants)
    allowed = int((1 - problem.share) * count + 1e-9)
    drawn = every.judged(best.values)
    for turn in range(ROUNDS):
        tell(turn / ROUNDS, f"{count} draws, {len(active)} in the search")
        misses = drawn.misses
        worst = np.argsort(-misses, kind="stable")[allowed:]
        new = [int(i) for i in worst[:AT_ONCE] if misses[i] > HELD and i not in active]
        if not new:
            break
        active += new
        some, from_best = problem.with_draws(active), _parts(spans, best.values)
        found = [_descent(some, spans, point, evaluations).found for point in (from_best, points[0])]
        best = problem.judged(min(found, key=_rank).values)
        drawn = every.judged(best.values)
    return best, drawn


def _rank(judged: Judgement) -> tuple[float, float]:
    """Feasible ones by their objective, before others by what they miss."""
    return (0.0, judged.objective) if judged.most_missed <= HELD else (judged.most_missed, judged.objective)


def _agreeing(unknowns: Sequence[Span], descents: Sequence[Descent], best: Judgement) -> int:
    there = _parts(unknowns, best.values)
    return sum(bool(np.abs(_parts(unknowns, d.found.values) - there).max() <= TOGETHER) for d in descents)


def _parts(unknowns: Sequence[Span], values: Mapping[str, float]) -> FloatArray:
    return np.array([unknown.part(values[unknown.name]) for unknown in unknowns])


def _descent(problem: Problem, unknowns: Sequence[Span], point: FloatArray, evaluations: int) -> Descent:
    """From one start to its end."""
    seen = _Seen(problem, unknowns)
    start = seen(point)
    if not start.stable:
        point = _until_stable(seen, point)
    for _ in range(2):
        before = seen(point)
        point = _least(seen, [point, _program(seen, point)])
        point = _least(seen, [point, _simplex(seen.penalised(point), point, evaluations)])
        if _rank(before) <= _rank(seen(point)):
            break
    if seen(point).most_missed > HELD:
        point = _least(seen, [point, _least_infeasible(seen, point, evaluations)])
    return Descent(start.values, seen(point), seen.evaluations)


def _until_stable(seen: _Seen, point: FloatArray) -> FloatArray:
    """The first point of a simplex at which all loops are stable, or where it ends."""

    def stop(intermediate_result: OptimizeResult) -> None:
        if seen(intermediate_result.x).stable:
            raise StopIteration

    return _simplex(lambda z: seen(z).most_missed, point, MOST, stop)


def _least(seen: _Seen, points: Sequence[FloatArray]) -> FloatArray:
    return min(points, key=lambda point: _rank(seen(point)))


class _Seen:
    """Candidates between the bounds, from 0 to 1, each judged once."""

    def __init__(self, problem: Problem, unknowns: Sequence[Span]) -> None:
        self._problem, self._unknowns = problem, unknowns
        self._known: dict[bytes, Judgement] = {}

    @property
    def evaluations(self) -> int:
        return len(self._known)

    def __call__(self, point: FloatArray) -> Judgement:
        inside = np.clip(point, 0.0, 1.0)
        key = inside.tobytes()
        if key not in self._known:
            values = {u.name: u.value(part) for u, part in zip(self._unknowns, inside, strict=True)}
            self._known[key] = self._problem.judged(values)
        return self._known[key]

    def vector(self, point: FloatArray, scale: float) -> FloatArray:
        """(1 + H,) the objective by this scale, and by how much each hard goal is held in each loop."""
        judged = self(point)
        if not judged.stable:
            held = np.full(judged.missed[judged.hard].size, -judged.most_missed)
            return np.concatenate([[FAR * judged.most_missed], held])
        return np.concatenate([[judged.objective / scale], -judged.missed[judged.hard].ravel()])

    def slopes(self, point: FloatArray, scale: float) -> FloatArray:
        """(1 + H, n) of `vector`, by differences to the side on which there is room."""
        base = self.vector(point, scale)
        columns = []
        for i in range(len(point)):
            moved = np.clip(point, 0.0, 1.0)
            width = SLOPE if moved[i] <= 0.5 else -SLOPE
            moved[i] += width
            columns.append((self.vector(moved, scale) - base) / width)
        return np.column_stack(columns)

    def penalised(self, point: FloatArray) -> Merit:
        """A function that counts objective and misses together."""
        scale = _scale(self(point))

        def merit(z: FloatArray) -> float:
            judged = self(z)
            if not judged.stable:
                return FAR * judged.most_missed
            return judged.objective / scale + DEAR * float(np.maximum(judged.missed[judged.hard], 0.0).sum())

        return merit


def _scale(judged: Judgement) -> float:
    return abs(judged.objective) if np.isfinite(judged.objective) and judged.objective else 1.0


def _program(seen: _Seen, point: FloatArray) -> FloatArray:
    """The end of sequential quadratic programming."""
    scale = _scale(seen(point))
    done = minimize(
        lambda z: seen.vector(z, scale)[0],
        point,
        jac=lambda z: seen.slopes(z, scale)[0],
        bounds=[(0.0, 1.0)] * len(point),
        constraints=[
            {
                "type": "ineq",
                "fun": lambda z: seen.vector(z, scale)[1:],
                "jac": lambda z: seen.slopes(z, scale)[1:],
            }
        ],
        method="SLSQP",
        options={"maxiter": 100, "ftol": 1e-10},
    )
    return np.asarray(done.x)


def _simplex(
    merit: Merit, point: FloatArray, evaluations: int, stop: Callable[[OptimizeResult], None] | None = None
) -> FloatArray:
    """The end of a simplex that begins small."""
    size = 0.02
    corners = np.array(
        [point, *(point + size * (1 if point[i] <= 0.5 else -1) * row for i, row in enumerate(np.eye(len(point))))]
    )
    done = minimize(
        merit,
        point,
        method="Nelder-Mead",
        callback=stop,
        bounds=[(0.0, 1.0)] * len(point),
        options={"initial_simplex": corners, "maxfev": evaluations, "xatol": 1e-6, "fatol": 1e-10},
    )
    return np.asarray(done.x)


def _least_infeasible(seen: _Seen, point: FloatArray, evaluations: int) -> FloatArray:
    """The point whose most missed goal is missed least."""
    for _ in range(2):
        ends = [point, _most_missed_lowered(seen, point)]
        point = min(ends, key=lambda z: seen(z).most_missed)
        ends = [point, _simplex(lambda z: seen(z).most_missed, point, evaluations)]
        point = min(ends, key=lambda z: seen(z).most_missed)
    return point


def _most_missed_lowered(seen: _Seen, point: FloatArray) -> FloatArray:
    """The end of a quadratic program that lowers a bound on all misses, its last variable."""
    count, rows = len(point), len(seen.vector(point, 1.0)) - 1
    held = {
        "type": "ineq",
        "fun": lambda z: seen.vector(z[:-1], 1.0)[1:] + z[-1],
        "jac": lambda z: np.column_stack([seen.slopes(z[:-1], 1.0)[1:], np.ones(rows)]),
    }
    done = minimize(
        lambda z: z[-1],
        np.append(point, seen(point).most_missed),
        jac=lambda z: np.append(np.zeros(count), 1.0),
        bounds=[*[(0.0, 1.0)] * count, (None, None)],
        constraints=[held],
        method="SLSQP",
        options={"maxiter": 100, "ftol": 1e-10},
    )
    return np.asarray(done.x[:-1])
