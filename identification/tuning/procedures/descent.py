"""From one start to its end: a quadratic program, and a simplex that goes on from there, since margins have kinks.

Where no point holds all hard goals the one that misses least is sought.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from identification.tuning.procedures.problem import CandidateJudgement, TuningProblem
from identification.tuning.procedures.procedure import HELD, Descent
from identification.tuning.procedures.unknowns import Span
from orchestrator.trace import FloatArray

SLOPE = 1e-6  # width of differences, of the span between the bounds
FAR = 1e3  # what an unstable loop counts in place of an objective, of the start's
DEAR = 10.0  # of the simplex: what a missed goal counts beside the objective
MOST = 400  # evaluations on the way to a stable loop
Merit = Callable[[FloatArray], float]


def rank(judged: CandidateJudgement) -> tuple[float, float]:
    """Feasible ones by their objective, before others by what they miss."""
    return (0.0, judged.objective) if judged.most_missed <= HELD else (judged.most_missed, judged.objective)


def descent(problem: TuningProblem, unknowns: Sequence[Span], point: FloatArray, evaluations: int) -> Descent:
    """From one start to its end."""
    seen = Seen(problem, unknowns)
    start = seen(point)
    if not start.stable:
        point = _until_stable(seen, point)
    for _ in range(2):
        before = seen(point)
        point = _least(seen, [point, program(seen, point)])
        point = _least(seen, [point, simplex(seen.penalised(point), point, evaluations)])
        if rank(before) <= rank(seen(point)):
            break
    if seen(point).most_missed > HELD:
        point = _least(seen, [point, _least_infeasible(seen, point, evaluations)])
    return Descent(start.values, seen(point), seen.evaluations)


def _until_stable(seen: Seen, point: FloatArray) -> FloatArray:
    """The first point of a simplex at which all loops are stable, or where it ends."""

    def stop(intermediate_result: OptimizeResult) -> None:
        if seen(intermediate_result.x).stable:
            raise StopIteration

    return simplex(lambda z: seen(z).most_missed, point, MOST, stop)


def _least(seen: Seen, points: Sequence[FloatArray]) -> FloatArray:
    return min(points, key=lambda point: rank(seen(point)))


class Judge(Protocol):
    """What judges candidates."""

    def judged(self, values: Mapping[str, float]) -> CandidateJudgement:
        """What these values do."""


class Seen:
    """Candidates between the bounds, from 0 to 1, each judged once."""

    def __init__(self, problem: Judge, unknowns: Sequence[Span]) -> None:
        self._problem, self._unknowns = problem, unknowns
        self._known: dict[bytes, CandidateJudgement] = {}

    @property
    def evaluations(self) -> int:
        return len(self._known)

    @property
    def judged(self) -> list[CandidateJudgement]:
        """All candidates so far."""
        return list(self._known.values())

    def __call__(self, point: FloatArray) -> CandidateJudgement:
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


def _scale(judged: CandidateJudgement) -> float:
    return abs(judged.objective) if np.isfinite(judged.objective) and judged.objective else 1.0


def program(seen: Seen, point: FloatArray) -> FloatArray:
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


def simplex(
    merit: Merit,
    point: FloatArray,
    evaluations: int,
    stop: Callable[[OptimizeResult], None] | None = None,
    size: float = 0.02,
) -> FloatArray:
    """The end of a simplex that begins with sides of this size."""
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


def _least_infeasible(seen: Seen, point: FloatArray, evaluations: int) -> FloatArray:
    """The point whose most missed goal is missed least."""
    for _ in range(2):
        ends = [point, _most_missed_lowered(seen, point)]
        point = min(ends, key=lambda z: seen(z).most_missed)
        ends = [point, simplex(lambda z: seen(z).most_missed, point, evaluations)]
        point = min(ends, key=lambda z: seen(z).most_missed)
    return point


def _most_missed_lowered(seen: Seen, point: FloatArray) -> FloatArray:
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
