"""Residuals of free runs and their structured Jacobian, exact or by finite differences, simulated through a pool.

A window's initial states act on that window only, so one pass perturbs them in all windows at once: a
Jacobian costs as many simulations a window as there are parameters and states of one window.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fmus.errors import FmuError, IdentificationError, ParametersRefused, TangentsMissing
from identification.estimation.arrow_least_squares import Iterate, Point, WindowBlock
from identification.estimation.workers import Pool, SimulationTask
from identification.output_error.search.exact import WITNESSES, Columns, exact_columns, require_agreement, say
from identification.output_error.search.problem import Problem
from orchestrator.trace import FloatArray

_REASONS_KEPT = 5
_CURVED = 1e-2  # of the outputs' spread


@dataclass
class Tally:
    """What an estimation has cost so far.

    Attributes:
        evaluations: points at which all windows were simulated.
        exact: linearisations that tangents gave, but for delays.
        differences: why tangents do not; nothing while they may.
        simulations: windows simulated.
        failures: simulations that failed or gave values that are not finite.
        reasons: the first few distinct reasons.
        refused: the first of an FMU that does not take its parameters.
    """

    evaluations: int = 0
    exact: int = 0
    differences: str = ""
    simulations: int = 0
    failures: int = 0
    reasons: list[str] = field(default_factory=list)
    refused: ParametersRefused | None = None

    def failed(self, error: FmuError) -> None:
        """Count one failure."""
        self.failures += 1
        if len(self.reasons) < _REASONS_KEPT and str(error) not in self.reasons:
            self.reasons.append(str(error))
        if isinstance(error, ParametersRefused) and self.refused is None:
            self.refused = error

    def no_start(self, what: str) -> FmuError:
        """Why there is nothing to begin a search from.

        Args:
            what: is simulated.
        """
        if self.refused is not None:
            return self.refused.within("start")
        reason = self.reasons[0] if self.reasons else "no reason given"
        return FmuError("start", f"{what}cannot be simulated: {reason}", "change the start values")


@dataclass(frozen=True)
class FreeRun:
    """Some windows of a problem as a system to minimise, by residual = weight * (simulated - measured).

    Attributes:
        windows: which of the problem's windows; row w of a point's states belongs to windows[w].
        step: relative step of a forward difference, about the root of the simulation's relative accuracy.
        rough: column -> relative forward and central step that simulations' own noise asks for, where it is known.
        wide: column -> wider step of one that acts in steps.
        tangents: whether derivatives are exact where they can be.
        noise: standard deviation of the residuals, which what is known before of parameters is weighed by: its rows
            stand behind the residuals of the first window.
    """

    problem: Problem
    pool: Pool
    tally: Tally
    windows: tuple[int, ...]
    step: float
    wide: Mapping[int, float] = field(default_factory=dict)
    tangents: bool = False
    noise: float = 1.0
    rough: Mapping[int, tuple[float, float]] = field(default_factory=dict)

    def residuals(self, point: Point) -> list[FloatArray] | None:
        """One (K m,) vector a window; None when a simulation failed."""
        return self.several([point])[0]

    def several(self, points: Sequence[Point]) -> list[list[FloatArray] | None]:
        """The residuals at each of these points, all simulated at once."""
        self.tally.evaluations += len(points)
        count = len(self.windows)
        found = self._simulated([(row, point, i) for i, point in enumerate(points) for row in range(count)])
        rows = [found[i * count : (i + 1) * count] for i in range(len(points))]
        complete = [[residual for residual in row if residual is not None] for row in rows]
        return [
            self._informed(row, point) if len(row) == count else None
            for row, point in zip(complete, points, strict=True)
        ]

    def _informed(self, residuals: list[FloatArray], point: Point) -> list[FloatArray]:
        """The residuals, and behind them how far the point is from what is known before."""
        if not self.problem.parameters.is_known_of:
            return residuals
        return [np.concatenate([residuals[0], self.before(point).residual]), *residuals[1:]]

    def informed(self, at: Iterate) -> list[FloatArray]:
        """The residuals there, with what is known before by the noise of this run."""
        return self._informed(self.problem.measured_only(at.residuals, self.windows), at.point)

    def before(self, point: Point) -> WindowBlock:
        """What is known before as rows (p,), one a parameter of which something is known, alone or beside others."""
        return known_before(self.problem, point, self.noise)

    def with_before(self, blocks: Sequence[WindowBlock], point: Point) -> list[WindowBlock]:
        """Blocks of windows alone, what is known before stacked below the first."""
        if not self.problem.parameters.is_known_of:
            return list(blocks)
        return [_stacked(blocks[0], self.before(point)), *blocks[1:]]

    def linearise(self, point: Point, residuals: list[FloatArray], central: bool = False) -> list[WindowBlock]:
        """Residuals and Jacobian of every window, and what is known before."""
        return self.with_before(
            self.linearised(point, self.problem.measured_only(residuals, self.windows), central), point
        )

    def linearised(self, point: Point, residuals: list[FloatArray], central: bool = False) -> list[WindowBlock]:
        """Residuals and Jacobian of every window: exact, or else by forward or central differences inside the bounds.

        Where a perturbed run fails the other side is tried; where that fails too the derivative is 0 and `unknown`.
        """
        exact = self.exact(point, residuals)
        up, down = self._steps(point, central)
        acting = np.array([self.problem.acting(window) for window in self.windows]).T
        up, down = np.where(acting, up, 0.0), np.where(acting, down, 0.0)
        up[list(exact)] = down[list(exact)] = 0.0
        above, below = self._shifted(point, up, residuals), self._shifted(point, down, residuals)
        retry = np.where([[r is None for r in column] for column in above], -up, 0.0)
        retry = np.where(self._inside(point, retry) & (down == 0), retry, 0.0)
        again = self._shifted(point, retry, residuals)
        n = len(point.parameters)
        blocks = []
        for row, residual in enumerate(residuals):
            columns, unknown = np.zeros((len(residual), len(up))), set()
            for c in range(len(up)):
                tried = ((up, above), (down, below), (retry, again))
                slope = _difference([(float(steps[c, row]), table[c][row]) for steps, table in tried], residual)
                if slope is None:
                    unknown.add(c)
                else:
                    columns[:, c] = exact[c][row] if c in exact else slope
            blocks.append(WindowBlock(residual, columns[:, :n], columns[:, n:], frozenset(unknown)))
        return blocks

    def exact(self, point: Point, residuals: list[FloatArray]) -> Columns:
        """The columns that tangents give; the first ones are compared with differences in a few windows."""
        if not self.tangents or self.tally.differences:
            return {}
        try:
            found = exact_columns(self.problem, self.pool, self.windows, point)
            columns = {c: column for c, column in found.items() if c not in self.wide}
            self.tally.simulations += len(self.windows) if columns else 0
            if not self.tally.exact:
                require_agreement(self.problem, columns, self._witnessed(point, residuals, columns))
        except TangentsMissing as reason:
            self.tally.differences = str(reason)
            say(reason)
            return {}
        except FmuError:
            return {}  # where tangents run out of bounds, differences may not
        self.tally.exact += 1
        return columns

    @property
    def _curved(self) -> float:
        """How far residuals may move in a difference that shows a slope."""
        moving = [w.weight * w.measured.std(axis=0) for w in (self.problem.windows[row] for row in self.windows)]
        return _CURVED * float(np.max(moving, initial=0.0)) or 1.0

    def _witnessed(
        self, point: Point, residuals: list[FloatArray], columns: Columns
    ) -> dict[int, list[FloatArray | None]]:
        """Differences of these columns in the first few windows, over steps that do not leave what slopes tell of."""
        few = replace(self, windows=self.windows[:WITNESSES], tangents=False)
        point, residuals = Point(point.parameters, point.states[:WITNESSES]), residuals[:WITNESSES]
        steps, _ = few._steps(point, central=False)
        for c, column in columns.items():
            largest = max(float(np.abs(own).max()) for own in column[: len(residuals)])
            steps[c] /= max(1.0, float(np.abs(steps[c]).max()) * largest / self._curved)
        moved = few._shifted(point, steps, residuals)
        return {
            c: [
                None if found is None or not steps[c, row] else (found - base) / float(steps[c, row])
                for row, (found, base) in enumerate(zip(moved[c], residuals, strict=True))
            ]
            for c in columns
        }

    def _steps(self, point: Point, central: bool) -> tuple[FloatArray, FloatArray]:
        """Two signed steps (n + s, W) in z; the second is 0 for a one-sided difference."""
        size = self._columns(Point(np.maximum(1, abs(point.parameters)), np.maximum(1, abs(point.states))))
        up = size * self.relative(len(size), central)[:, None]
        rising, falling = self._inside(point, up), self._inside(point, -up)
        down = np.where(rising & falling, -up, 0.0) if central else np.zeros_like(up)
        box = self.problem.box(self.windows).around(point)
        lower, upper = self._columns(box.lower), self._columns(box.upper)
        widest = np.where(upper >= -lower, upper, lower)
        return np.where(rising, up, np.where(falling, -up, widest)), down

    def relative(self, columns: int, central: bool) -> FloatArray:
        """(n + s,) relative steps."""
        steps = np.full(columns, self.step ** (2 / 3) if central else self.step)
        for column, asked in self.rough.items():
            steps[column] = max(asked[central], steps[column])
        for column, width in self.wide.items():
            steps[column] = max(width, steps[column])
        return steps

    def _inside(self, point: Point, steps: FloatArray) -> NDArray[np.bool_]:
        """(n + s, W) whether the point stays within the bounds when one entry moves by its step."""
        box = self.problem.box(self.windows).around(point)
        return np.asarray((steps >= self._columns(box.lower)) & (steps <= self._columns(box.upper)))

    def _columns(self, point: Point) -> FloatArray:
        """(n + s, W) the entries a window sees."""
        parameters = np.repeat(point.parameters[:, None], len(self.windows), axis=1)
        return np.concatenate([parameters, point.states.T])

    def _shifted(self, point: Point, steps: FloatArray, base: list[FloatArray]) -> list[list[FloatArray | None]]:
        """Residuals [column][window] with one entry moved by its step; the base where the step is 0."""
        places, n = [(int(c), int(w)) for c, w in np.argwhere(steps != 0)], len(point.parameters)
        moved = [(w, _moved(point, c, w, float(steps[c, w])), c if c < n else None) for c, w in places]
        table: list[list[FloatArray | None]] = [list(base) for _ in steps]
        for (c, w), residual in zip(places, self._simulated(moved), strict=True):
            table[c][w] = residual
        return table

    def _simulated(self, places: Sequence[tuple[int, Point, int | None]]) -> list[FloatArray | None]:
        """Residuals of (row, point, group); None where the simulation failed, or another one of the group before it."""
        tasks = [
            SimulationTask(self.windows[row], self.problem.values(self.windows[row], at, row), group)
            for row, at, group in places
        ]
        outcomes = self.pool.run(tasks)
        self.tally.simulations += sum(outcome is not None for outcome in outcomes)
        return [self._residual(task.window, outcome) for task, outcome in zip(tasks, outcomes, strict=True)]

    def _residual(self, index: int, outcome: FloatArray | FmuError | None) -> FloatArray | None:
        window = self.problem.windows[index]
        if outcome is None:
            return None
        if isinstance(outcome, FmuError):
            self.tally.failed(outcome)
            return None
        simulated = np.asarray(outcome, dtype=float)
        if simulated.shape != window.measured.shape:
            raise IdentificationError(
                window.name,
                f"simulated outputs have shape {simulated.shape}, measured ones {window.measured.shape}",
                "let the simulator report the outputs at the measured instants",
            )
        if not np.all(np.isfinite(simulated)):
            self.tally.failed(FmuError(window.name, "a simulated output is not finite"))
            return None
        return np.asarray((window.weight * (simulated - window.measured)).ravel())


def known_before(problem: Problem, point: Point, noise: float) -> WindowBlock:
    """What is known before of parameters as rows (p,): standard deviations off, in those of the residuals.

    It counts as often as samples do, so that windows that overlap do not outweigh it.
    """
    parameters, noise = problem.parameters, noise * math.sqrt(problem.counted)
    values, slopes = parameters.values(point.parameters), parameters.slopes(point.parameters)
    columns = {parameter.name: c for c, parameter in enumerate(parameters.free)}
    rows = np.zeros((len(parameters.informed), len(columns)))
    off = np.zeros(len(rows))
    for row, parameter in enumerate(parameters.informed):
        assert parameter.prior is not None
        off[row] = noise * parameter.prior.distance(values[parameter.name])
        if parameter.name in columns:
            c = columns[parameter.name]
            rows[row, c] = noise * parameter.prior.slope(values[parameter.name]) * slopes[c]
    for around in parameters.around:
        own = np.array([values[name] for name in around.members])
        off = np.append(off, noise * (own - own.mean()) / around.std)
        moved = np.zeros((len(own), len(columns)))
        for row, name in enumerate(around.members):
            if name in columns:
                moved[row, columns[name]] = slopes[columns[name]]
        rows = np.vstack([rows, noise * (moved - moved.mean(axis=0)) / around.std])
    return WindowBlock(off, rows, np.zeros((len(rows), point.states.shape[1])))


def _stacked(block: WindowBlock, below: WindowBlock) -> WindowBlock:
    return replace(
        block,
        residual=np.concatenate([block.residual, below.residual]),
        parameters=np.vstack([block.parameters, below.parameters]),
        states=np.vstack([block.states, below.states]),
    )


def _moved(point: Point, column: int, row: int, step: float) -> Point:
    n = len(point.parameters)
    if column < n:
        parameters = point.parameters.copy()
        parameters[column] += step
        return replace(point, parameters=parameters)
    states = point.states.copy()
    states[row, column - n] += step
    return replace(point, states=states)


def _difference(sides: Sequence[tuple[float, FloatArray | None]], base: FloatArray) -> FloatArray | None:
    """The derivative from whichever two of the sides and the base are there, the widest apart; None where a run failed
    and there are no two."""
    known = [(step, residual) for step, residual in sides if residual is not None] + [(0.0, base)]
    (low, below), (high, above) = min(known, key=lambda k: k[0]), max(known, key=lambda k: k[0])
    if high > low:
        return (above - below) / (high - low)
    return None if any(residual is None for _, residual in sides) else np.zeros_like(base)
