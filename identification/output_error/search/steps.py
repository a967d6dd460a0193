"""Parameters that act in steps: a sampled clock, a count, a play that is passed or not.

A fine difference sees nothing of such a parameter, or one step of it as a cliff. So two widths are compared and the
difference is widened until two agree; the search goes on along such parameters by looking, not by slopes; and what the
cost cannot tell apart is the parameter's flat range.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.estimation.arrow_least_squares import Iterate, Loss, Point
from identification.output_error.search.free_run import FreeRun
from orchestrator.trace import FloatArray

WIDEST = 0.3  # of a scaled parameter: the widest difference
_FINER, _AGREE = 0.25, 0.5  # from width to width, and by how much of the larger slope two may differ
_SMOOTH = 0.01  # by how much two differ at most where neither steps nor noise disturb them
_NO_EFFECT = 1e-10  # of the measured outputs
_LOOKS = (0.25, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0)  # widths away, to either side
_ROUNDS = 4
_FAR = 10.0  # scaled: where an open range is no longer followed
_CHI2 = 3.84  # 95 %, one degree of freedom
_CELLS, _REFINED = 9, 3  # of a grid that finds a range's end, and how often it is refined


@dataclass(frozen=True)
class FlatStretch:
    """Between which z the outputs cannot tell a parameter's values apart; infinite where it is open.

    Attributes:
        silent: whether that is all that is allowed.
    """

    low: float
    high: float
    silent: bool

    @property
    def width(self) -> float:
        return self.high - self.low


def widened(run: FreeRun, here: Iterate) -> dict[int, float]:
    """Column -> relative width of its difference, of what acts in steps or below the accuracy of a run.

    A smooth one's slopes over the run's own step for it and a quarter of that agree, and it is not among them. Columns
    are the parameters, then the estimated initial states, each moved in all windows at once.
    """
    finest = _own_widths(run, here)
    width = dict(finest)
    finer = _slopes(run, here, {c: _FINER * w for c, w in width.items()})
    found: dict[int, float] = {}
    while width:
        wider = _slopes(run, here, width)
        settled = {c for c in width if _alike(run, finer[c], wider[c], _FINER * width[c])}
        found |= {c: w for c, w in width.items() if c in settled and w > finest[c]}
        left = {c: w / _FINER for c, w in width.items() if c not in settled}
        found |= {c: WIDEST for c, w in left.items() if w > WIDEST}
        width, finer = {c: w for c, w in left.items() if w <= WIDEST}, wider
    return found


def restless(run: FreeRun, here: Iterate) -> list[int]:
    """Columns whose slopes over the run's own step and a quarter of it differ as those of smooth simulations do not."""
    width = _own_widths(run, here)
    finer, wider = _slopes(run, here, {c: _FINER * w for c, w in width.items()}), _slopes(run, here, width)
    return [c for c, w in width.items() if not _alike(run, finer[c], wider[c], _FINER * w, _SMOOTH)]


def _own_widths(run: FreeRun, here: Iterate) -> dict[int, float]:
    """Column -> relative step that the run takes for a forward difference."""
    columns = len(here.point.parameters) + here.point.states.shape[1]
    return dict(enumerate(run.relative(columns, central=False).tolist()))


def _slopes(run: FreeRun, here: Iterate, widths: Mapping[int, float]) -> dict[int, FloatArray | None]:
    """Column -> (N,) slope of all residuals over one side; None where a run failed or there is no room."""
    steps = {c: width * size(here.point, c) for c, width in widths.items()}
    steps = {c: step if inside(run, moved(here.point, c, step)) else -step for c, step in steps.items()}
    ends = [moved(here.point, c, step) for c, step in steps.items()]
    base = np.concatenate(here.residuals)
    return {
        c: (np.concatenate(residuals) - base) / step if residuals is not None and inside(run, end) else None
        for (c, step), end, residuals in zip(steps.items(), ends, run.several(ends), strict=True)
    }


def size(point: Point, column: int) -> float:
    """What a relative step of a parameter, or of a state in all windows, is a part of."""
    n = len(point.parameters)
    entries = point.parameters[column : column + 1] if column < n else point.states[:, column - n]
    return max(1.0, float(np.abs(entries).max()))


def inside(run: FreeRun, point: Point) -> bool:
    """Whether a point is within the bounds."""
    return bool(np.array_equal(point.clipped(run.problem.box(run.windows)).flat, point.flat))


def _alike(
    run: FreeRun, finer: FloatArray | None, wider: FloatArray | None, width: float, share: float = _AGREE
) -> bool:
    """Whether two slopes are those of a smooth parameter, but for a share; where one is missing nothing is said against
    it."""
    if finer is None or wider is None:
        return True
    sizes = [float(np.linalg.norm(slope)) for slope in (finer, wider)]
    measured = math.sqrt(sum(float(np.sum((w.weight * w.measured) ** 2)) for w in run.problem.windows))
    if min(sizes) * width <= _NO_EFFECT * measured:
        return False
    return float(np.linalg.norm(finer - wider)) <= share * max(sizes)


def best_nearby(run: FreeRun, here: Iterate, loss: Loss) -> Iterate:
    """The best point of those so many widths away along one parameter after the other, again until none is better.

    Smooth parameters are tried as well: over their central differences, as the steps of others show there, too.
    """
    for _ in range(_ROUNDS):
        before = here.cost
        for c, z in enumerate(here.point.parameters):
            width = run.wide.get(c, run.step ** (2 / 3)) * max(1.0, abs(float(z)))
            moves = width * np.array([*_LOOKS, *(-k for k in _LOOKS)])
            here = min([here, *_tried(run, here.point, c, moves, loss)], key=lambda there: there.cost)
        if here.cost >= before:
            break
    return here


def _tried(run: FreeRun, point: Point, column: int, moves: Sequence[float] | FloatArray, loss: Loss) -> list[Iterate]:
    """What lies so far along one column, where it can be had, within the bounds."""
    points = [moved(point, column, float(step)).clipped(run.problem.box(run.windows)) for step in moves]
    found = zip(points, run.several(points), strict=True)
    return [Iterate(there, r, loss.cost(r)) for there, r in found if r is not None]


def flat(run: FreeRun, here: Iterate, column: int, loss: Loss) -> FlatStretch:
    """The range over which the cost of the other parameters at their estimates rises by no more than noise.

    It ends outside: at the first point found beyond it, or at a bound.
    """
    lower, upper = run.problem.parameters.z_bounds
    most = here.cost * (1 + _CHI2 / sum(map(len, here.residuals)))
    z = float(here.point.parameters[column])
    reaches = [
        _reach(run, here, column, side, min(abs(bound - z), _FAR), most, loss)
        for side, bound in ((-1.0, float(lower[column])), (1.0, float(upper[column])))
    ]
    to_bounds = [reach is None for reach in reaches]
    low = float(lower[column]) if reaches[0] is None else z - reaches[0]
    high = float(upper[column]) if reaches[1] is None else z + reaches[1]
    return FlatStretch(low, high, all(to_bounds))


def _reach(run: FreeRun, here: Iterate, column: int, side: float, room: float, most: float, loss: Loss) -> float | None:
    """How far to a side the cost stays below; None where it does so as far as there is room."""
    inner, outer = 0.0, math.inf
    grid = room * np.geomspace(1e-4, 1.0, _CELLS + 4)
    for _ in range(_REFINED):
        costs = _costs(run, here.point, column, side * grid, loss)
        above = np.flatnonzero(costs > most)
        if len(above):
            outer = float(grid[above[0]])
            inner = float(grid[above[0] - 1]) if above[0] else inner
        elif math.isinf(outer):
            return None
        else:
            inner = float(grid[-1])
        grid = np.linspace(inner, outer, _CELLS + 2)[1:-1]
    return outer


def _costs(run: FreeRun, point: Point, column: int, moves: FloatArray, loss: Loss) -> FloatArray:
    """(N,) cost so far along one column; infinite where it cannot be had."""
    found = run.several([moved(point, column, float(step)) for step in moves])
    return np.array([math.inf if r is None else loss.cost(r) for r in found])


def centred(run: FreeRun, here: Iterate, column: int, flat: FlatStretch, loss: Loss) -> Iterate:
    """The middle of a flat range, where it is as good as the point that was found."""
    if flat.silent or not math.isfinite(flat.width):
        return here
    step = 0.5 * (flat.low + flat.high) - float(here.point.parameters[column])
    return min([here, *_tried(run, here.point, column, [step], loss)], key=lambda there: (there.cost, there is here))


def moved(point: Point, column: int, step: float) -> Point:
    """The point with a parameter, or a state in all windows, moved."""
    parameters, states = point.parameters.copy(), point.states.copy()
    if column < len(parameters):
        parameters[column] += step
    else:
        states[:, column - len(parameters)] += step
    return Point(parameters, states)
