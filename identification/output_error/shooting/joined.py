"""Segments of windows fitted together, under the constraint that each begins where the one before ends.

The constraint is kept by an augmented Lagrangian: the gaps are residuals of a weight that grows, shifted by their
multipliers, in one block a window, whose states are the start values of all its segments. So the estimate nears that of
the uncut windows, while a gap is allowed as long as it helps the search.

Source: Bock 1983 (multiple shooting); Nocedal and Wright 2006, Section 17.3 (augmented Lagrangian).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from identification.estimation.arrow_least_squares import (
    LEAST_SQUARES,
    NO_DAMPING,
    ArrowModel,
    Box,
    Iterate,
    Minimum,
    Point,
    SearchLimits,
    WindowBlock,
    evaluated,
    minimise,
)
from identification.output_error.search.free_run import FreeRun
from orchestrator.trace import FloatArray

JOINED = 1e-9  # of a state's size: the largest gap of what is taken for joined
_ROUNDS, _NEAR = 20, 1e-5  # of a search each, and the gap at which it takes gaps for none
_CLOSER = 12
_HEAVIER, _HEAVIEST, _SLOW = 10.0, 1e6, 0.1  # the gaps' weight, and the share of a gap above which it grows


@dataclass(eq=False)
class JoinedRuns:
    """Windows of `count` segments each as a system to minimise; a point's states are (W, count s), segment by segment.

    Attributes:
        run: of the segments, window by window.
        offsets: (W, count, s) start values at z = 0, in sizes of the states.
        weight: of the squared gaps.
        multipliers: (W, count - 1, s) of the gaps.
    """

    run: FreeRun
    offsets: FloatArray
    weight: float
    multipliers: FloatArray
    _latest: tuple[Point, list[FloatArray]] | None = field(default=None, init=False)

    @property
    def count(self) -> int:
        return int(self.offsets.shape[1])

    @property
    def size(self) -> int:
        return int(self.offsets.shape[2])

    def residuals(self, point: Point) -> list[FloatArray] | None:
        """One vector a window: outputs of its segments, and gaps between these; None when a run failed."""
        found = self.run.residuals(self._inner(point))
        if found is None:
            return None
        self._latest = (point, found)
        return [
            np.concatenate([*(self._outputs(row, found[row]) for row in self._rows(w)), gaps.ravel()])
            for w, gaps in enumerate(self.weighed(self.gaps(point)))
        ]

    def gaps(self, point: Point) -> FloatArray:
        """(W, count - 1, s) from where a segment ends to where the next begins, at the point that was met last."""
        ends = np.array([self._ends(row, r) for row, r in enumerate(self._found(point))]).reshape(self.offsets.shape)
        begins = self.offsets + point.states.reshape(self.offsets.shape)
        return np.asarray(ends[:, :-1] - begins[:, 1:])

    def linearise(self, point: Point, residuals: list[FloatArray]) -> list[WindowBlock]:
        """Residuals and Jacobian of every window."""
        blocks = self.run.linearise(self._inner(point), self._found(point))
        return [
            self._block(residual, [blocks[row] for row in self._rows(w)], w) for w, residual in enumerate(residuals)
        ]

    def growth(self, blocks: Sequence[WindowBlock]) -> float:
        """How many times as much a window makes at most of a deviation at its start (2-norm), by its segments."""
        most = 0.0
        for w in range(len(self.offsets)):
            passed = np.eye(self.size)
            for row in self._rows(w):
                passed = self._ends(row, blocks[row].states) @ passed
                most = max(most, float(np.linalg.norm(passed, 2)))
        return most

    def condensed(self, point: Point, free: NDArray[np.bool_]) -> tuple[list[WindowBlock], float]:
        """Every window with its outputs alone, as far as its segments stay joined to first order, and the growth.

        States are s' combinations of all start values, in which a window is well conditioned however much it makes of a
        deviation until its end.

        Args:
            free: (count s,) which start values are.
        """
        found = self.run.problem.measured_only(self._found(point), self.run.windows)
        segments, windows = self.run.linearised(self._inner(point), found, central=True), []
        for w in range(len(self.offsets)):
            rows = self._rows(w)
            residual = np.concatenate([self._outputs(row, found[row]) for row in rows])
            block = self._block(residual, [segments[row] for row in rows], w)
            outputs, gaps = (
                np.split(block.parameters, [len(residual)]),
                np.split(block.states[:, free], [len(residual)]),
            )
            follows = -np.linalg.lstsq(gaps[1], outputs[1], rcond=None)[0]
            parameters, states = outputs[0] + gaps[0] @ follows, gaps[0] @ null_space(gaps[1])
            windows.append(WindowBlock(residual, parameters, states, block.unknown))
        return windows, self.growth(segments)

    def _block(self, residual: FloatArray, blocks: Sequence[WindowBlock], window: int) -> WindowBlock:
        """One window; of the gaps' rows each has the end of a segment, less the beginning of the next."""
        root, s, first = np.sqrt(self.weight), self.size, window * self.count
        parameters = [self._outputs(first + j, block.parameters) for j, block in enumerate(blocks)]
        states = [_placed(self._outputs(first + j, block.states), j, self.count) for j, block in enumerate(blocks)]
        for j, block in enumerate(blocks[:-1]):
            parameters.append(root * self._ends(first + j, block.parameters))
            ends = _placed(self._ends(first + j, block.states), j, self.count)
            states.append(root * (ends - _placed(np.eye(s), j + 1, self.count)))
        unknown = frozenset[int]().union(*(block.unknown for block in blocks))
        return WindowBlock(residual, np.vstack(parameters), np.vstack(states), unknown)

    def _found(self, point: Point) -> list[FloatArray]:
        """Residuals of the segments, of a point that could be evaluated."""
        if self._latest is None or self._latest[0] is not point:
            self.residuals(point)
        assert self._latest is not None and self._latest[0] is point
        return self._latest[1]

    def _inner(self, point: Point) -> Point:
        return Point(point.parameters, point.states.reshape(-1, self.size))

    def _rows(self, window: int) -> range:
        return range(window * self.count, (window + 1) * self.count)

    def weighed(self, gaps: FloatArray) -> FloatArray:
        """(W, count - 1, s) residuals of gaps of that shape."""
        return np.asarray(np.sqrt(self.weight) * gaps + self.multipliers / np.sqrt(self.weight))

    def _outputs(self, row: int, entries: FloatArray) -> FloatArray:
        """The rows of a segment's outputs, and behind them those of what is known before."""
        own = self.run.problem.windows[row].measured
        table = entries[: own.size].reshape(len(own), own.shape[1], *entries.shape[1:])
        outputs = table[:, : -self.size].reshape(-1, *entries.shape[1:])
        return np.concatenate([outputs, entries[own.size :]])

    def _ends(self, row: int, entries: FloatArray) -> FloatArray:
        """(s, ...) the rows of where its states end."""
        own = self.run.problem.windows[row].measured
        return np.asarray(entries[own.size - self.size : own.size])


@dataclass(frozen=True, eq=False)
class JoinedSegments:
    """Where the search has come to.

    Attributes:
        found: scaled parameters (n,) and start values (W, count s).
        gap: the largest that is left, in sizes of states.
        cost: of the outputs, without that of the gaps.
        system: of the last step.
    """

    found: Minimum
    gap: float
    cost: float
    system: JoinedRuns

    @property
    def closed(self) -> bool:
        return self.gap <= JOINED


def _placed(columns: FloatArray, segment: int, count: int) -> FloatArray:
    """(N, count s) these columns (N, s) at the place of a segment."""
    s = columns.shape[1]
    wide = np.zeros((len(columns), count * s))
    wide[:, segment * s : (segment + 1) * s] = columns
    return wide


def join(
    run: FreeRun,
    offsets: FloatArray,
    start: Point,
    box: Box,
    limits: SearchLimits,
    report: Callable[[int, Iterate], None],
) -> JoinedSegments:
    """The minimum of the segments' outputs under the constraint that they join.

    Args:
        run, offsets: as `JoinedRuns` has them.
        start: (n,) parameters and (W, count s) start values, scaled.

    Raises:
        FmuError: a segment cannot be simulated at the start.
    """
    w, count, s = offsets.shape
    weight, multipliers, before, taken, joined = 1.0, np.zeros((w, count - 1, s)), np.inf, 0, None
    for _ in range(_ROUNDS):
        system = JoinedRuns(run, offsets, weight, multipliers)
        begin = evaluated(system, start if joined is None else joined.found.at.point, LEAST_SQUARES)
        if begin is None:
            raise run.tally.no_start("a segment ")
        told = partial(_told, report, taken)
        found = minimise(system, begin, box, LEAST_SQUARES, limits=limits, report=told)
        taken += found.iterations
        gaps = system.gaps(found.at.point)
        cost = found.at.cost - LEAST_SQUARES.cost([system.weighed(gaps)])
        joined = JoinedSegments(replace(found, iterations=taken), float(np.abs(gaps).max(initial=0.0)), cost, system)
        if joined.gap <= _NEAR or not found.iterations:
            break
        multipliers = multipliers + weight * gaps
        weight = min(_HEAVIER * weight, _HEAVIEST) if joined.gap > _SLOW * before else weight
        before = joined.gap
    assert joined is not None
    return _closer(replace(system, weight=_HEAVIEST), joined, box)


def _closer(system: JoinedRuns, joined: JoinedSegments, box: Box) -> JoinedSegments:
    """The same with gaps of rounding: by whole Gauss-Newton steps, whose gain in cost is too small to be searched for.

    A plant that is unstable makes as many times more of a gap over the rest of a window.
    """
    for _ in range(_CLOSER):
        begin = evaluated(system, joined.found.at.point, LEAST_SQUARES)
        assert begin is not None
        model = ArrowModel(system.linearise(begin.point, begin.residuals))
        step = model.step(NO_DAMPING, model.norms(), box.around(begin.point))
        there = evaluated(system, (begin.point + step).clipped(box), LEAST_SQUARES)
        if there is None:
            break
        gaps = system.gaps(there.point)
        gap = float(np.abs(gaps).max())
        if gap >= joined.gap:
            break
        cost = there.cost - LEAST_SQUARES.cost([system.weighed(gaps)])
        joined = JoinedSegments(replace(joined.found, at=there), gap, cost, system)
        system = replace(system, multipliers=system.multipliers + system.weight * gaps)
    return joined


def _told(report: Callable[[int, Iterate], None], taken: int, iteration: int, there: Iterate) -> None:
    report(taken + iteration, there)
