"""Bounded Levenberg-Marquardt for least squares whose Jacobian has the shape of an arrow.

All windows share the parameters, and each has states of its own. Orthogonal elimination of the states, window
by window, leaves a problem in the parameters alone, so neither memory nor time grows faster than the number
of windows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.numerics.bounded import bounded_least_squares
from orchestrator.trace import FloatArray

ROUGH = "the cost falls no further than its own roughness"
LossKind = Literal["linear", "soft_l1", "huber", "cauchy"]
_SUFFICIENT = 1e-4
NO_DAMPING = 1e-12
_MOST_DAMPING = 1e12
_CAREFUL = 0.1  # damping, at least, after a point that could not be evaluated: it may have cost a long wait
_ROUGHNESS = 1e3  # times the tolerance: what a linear model may still promise of a cost that does not follow it


@dataclass(frozen=True, eq=False)
class Point:
    """parameters : (n,) and states : (W, s), both scaled."""

    parameters: FloatArray
    states: FloatArray

    def __add__(self, step: Point) -> Point:
        return Point(self.parameters + step.parameters, self.states + step.states)

    def __sub__(self, other: Point) -> Point:
        return Point(self.parameters - other.parameters, self.states - other.states)

    def clipped(self, box: Box) -> Point:
        """The nearest point inside the box."""
        return Point(
            np.clip(self.parameters, box.lower.parameters, box.upper.parameters),
            np.clip(self.states, box.lower.states, box.upper.states),
        )

    @property
    def flat(self) -> FloatArray:
        """(n + W s,) all entries."""
        return np.concatenate([self.parameters, self.states.ravel()])


@dataclass(frozen=True)
class Box:
    """Bounds on every entry of a point.

    Attributes:
        reach: (n,) how far one step may take each parameter; None where as far as the bounds.
    """

    lower: Point
    upper: Point
    reach: FloatArray | None = None

    def around(self, point: Point) -> Box:
        """The bounds on a step from this point."""
        return Box(self.lower - point, self.upper - point)

    def within_reach(self, point: Point) -> Box:
        """The bounds on a step that is tried from this point."""
        room = self.around(point)
        if self.reach is None:
            return room
        return Box(
            replace(room.lower, parameters=np.maximum(room.lower.parameters, -self.reach)),
            replace(room.upper, parameters=np.minimum(room.upper.parameters, self.reach)),
        )


@dataclass(frozen=True, eq=False)
class WindowBlock:
    """One window linearised: residual : (N,), its derivatives parameters : (N, n) and states : (N, s).

    Attributes:
        unknown: columns of parameters with which the window could not be linearised; they are 0.
    """

    residual: FloatArray
    parameters: FloatArray
    states: FloatArray
    unknown: frozenset[int] = frozenset()


@dataclass(frozen=True)
class Loss:
    """0.5 scale^2 rho((r / scale)^2), summed; rho as in SciPy's `least_squares`.

    Attributes:
        kind: "linear" is least squares; "soft_l1", "huber" and "cauchy" weigh outliers less and less.
        scale: residual (after weighting) beyond which a sample counts as an outlier.
    """

    kind: LossKind = "linear"
    scale: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in ("linear", "soft_l1", "huber", "cauchy"):
            raise IdentificationError("loss", f"'{self.kind}' is unknown", "use linear, soft_l1, huber or cauchy")
        if not 0 < self.scale < math.inf:
            raise IdentificationError("loss", f"scale {self.scale:g} is not positive", "use a scale above 0")

    def cost(self, residuals: Sequence[FloatArray]) -> float:
        """The sum over all residuals."""
        return 0.5 * self.scale**2 * sum(float(np.sum(self._rho(r)[0])) for r in residuals)

    def influence(self, residual: FloatArray) -> FloatArray:
        """d cost / d r, the shape of r."""
        return self._rho(residual)[1] * residual

    def curvature(self, residual: FloatArray) -> FloatArray:
        """d2 cost / d r2, the shape of r; negative for cauchy's far outliers."""
        _, first, second = self._rho(residual)
        return first + 2.0 * second * (residual / self.scale) ** 2

    def scaled(self, block: WindowBlock) -> WindowBlock:
        """The block whose least squares has this loss's gradient and (floored, positive) curvature."""
        if self.kind == "linear":
            return block
        first = self._rho(block.residual)[1]
        root = np.sqrt(np.maximum(self.curvature(block.residual), 0.1 * first))
        return replace(
            block,
            residual=block.residual * first / root,
            parameters=block.parameters * root[:, None],
            states=block.states * root[:, None],
        )

    def _rho(self, residual: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """rho(z) and its first two derivatives at z = (r / scale)^2."""
        z = (residual / self.scale) ** 2
        if self.kind == "linear":
            return z, np.ones_like(z), np.zeros_like(z)
        if self.kind == "soft_l1":
            root = np.sqrt(1 + z)
            return 2 * (root - 1), 1 / root, -0.5 / root**3
        if self.kind == "cauchy":
            return np.log1p(z), 1 / (1 + z), -1 / (1 + z) ** 2
        inside, root = z <= 1, np.sqrt(np.maximum(z, 1))
        return np.where(inside, z, 2 * root - 1), 1 / root, np.where(inside, 0.0, -0.5 / root**3)


LEAST_SQUARES = Loss()


class ArrowModel:
    """The quadratic model of the cost around one point, compressed to one small triangle a window.

    `triangles` : (W, c, c) with c = s + n + 1 columns: states, parameters, residual. Orthogonal
    transformations keep all inner products, so gradient, curvature and cost of the model are those of the
    full Jacobian.
    """

    def __init__(self, blocks: Sequence[WindowBlock]) -> None:
        self.n = blocks[0].parameters.shape[1]
        self.s = blocks[0].states.shape[1]
        self.triangles = np.array([self._triangle(block) for block in blocks])

    def _triangle(self, block: WindowBlock) -> FloatArray:
        columns = np.column_stack([block.states, block.parameters, block.residual])
        missing = columns.shape[1] - len(columns)
        return _triangular(np.pad(columns, ((0, missing), (0, 0))) if missing > 0 else columns)

    def norms(self) -> Point:
        """Length of every Jacobian column; 1 for a column that is zero."""
        squares = np.sum(self.triangles**2, axis=1)
        states, parameters = np.sqrt(squares[:, : self.s]), np.sqrt(squares[:, self.s : -1].sum(axis=0))
        return Point(np.where(parameters > 0, parameters, 1.0), np.where(states > 0, states, 1.0))

    def step(self, damping: float, scale: Point, room: Box) -> Point:
        """The step that minimises |r + J d|^2 + damping |scale d|^2 within the room.

        Parameters are bounded exactly (SciPy's BVLS). A state at a bound that the gradient pushes outward
        stays; other states are clipped.
        """
        root = math.sqrt(damping)
        reduced = self._states_eliminated(root * scale.states, self._held(room))
        below = reduced[:, self.s :, self.s :].reshape(-1, self.n + 1)
        matrix = np.vstack([below[:, :-1] / scale.parameters, root * np.eye(self.n)])
        target = -np.concatenate([below[:, -1], np.zeros(self.n)])
        parameters = bounded_least_squares(
            matrix, target, room.lower.parameters * scale.parameters, room.upper.parameters * scale.parameters
        )
        parameters = parameters / scale.parameters
        states = self._states(reduced, parameters)
        return Point(parameters, states).clipped(room)

    def _held(self, room: Box) -> FloatArray:
        """(W, s) 1 for a state that may move, 0 for one held at its bound."""
        gradient = np.einsum("wrs,wr->ws", self.triangles[:, :, : self.s], self.triangles[:, :, -1])
        outward = ((room.lower.states >= 0) & (gradient > 0)) | ((room.upper.states <= 0) & (gradient < 0))
        return np.where(outward, 0.0, 1.0)

    def _states_eliminated(self, damping: FloatArray, free: FloatArray) -> FloatArray:
        windows, columns = self.triangles.shape[0], self.triangles.shape[2]
        rows = np.zeros((windows, self.s, columns))
        rows[:, range(self.s), range(self.s)] = damping
        masked = self.triangles.copy()
        masked[:, :, : self.s] *= free[:, None, :]
        return _triangular(np.concatenate([masked, rows], axis=1))

    def _states(self, reduced: FloatArray, parameters: FloatArray) -> FloatArray:
        target = -(reduced[:, : self.s, -1] + reduced[:, : self.s, self.s : -1] @ parameters)
        return np.asarray(np.linalg.solve(reduced[:, : self.s, : self.s], target[..., None])[..., 0])

    def reduction(self, step: Point) -> float:
        """By how much the model's cost falls over this step."""
        windows = len(self.triangles)
        moves = np.hstack([step.states, np.tile(step.parameters, (windows, 1)), np.ones((windows, 1))])
        moved = np.einsum("wrc,wc->wr", self.triangles, moves)
        return 0.5 * float(np.sum(self.triangles[:, :, -1] ** 2) - np.sum(moved**2))


def _triangular(matrices: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.qr(matrices, mode="r"))


class ArrowSystem(Protocol):
    """What is minimised."""

    def residuals(self, point: Point) -> list[FloatArray] | None:
        """One (N,) vector a window; None when the point cannot be evaluated."""

    def linearise(self, point: Point, residuals: list[FloatArray]) -> list[WindowBlock]:
        """Residuals and Jacobian of every window."""


@dataclass(frozen=True)
class SearchLimits:
    """When to stop.

    Attributes:
        evaluations: most points tried.
        iterations: most Jacobians computed.
        cost: relative cost reduction, expected and reached, under which the search has converged.
        step: largest change of a scaled entry, relative to 1 + its size, under which it has converged.
    """

    evaluations: int = 60
    iterations: int = 60
    cost: float = 1e-7
    step: float = 1e-7


@dataclass(frozen=True, eq=False)
class Iterate:
    """A point that could be evaluated."""

    point: Point
    residuals: list[FloatArray]
    cost: float


@dataclass(frozen=True)
class Minimum:
    """Where a search ended and why.

    Attributes:
        promised: share of the cost that the linear model still promises to take off where no better point was found.
    """

    at: Iterate
    iterations: int
    converged: bool
    message: str
    promised: float = 0.0


def minimise(
    system: ArrowSystem,
    start: Iterate,
    box: Box,
    loss: Loss,
    *,
    limits: SearchLimits,
    report: Callable[[int, Iterate], None],
) -> Minimum:
    """The nearest local minimum within the box; `report` is told iteration and point after every step.

    SciPy's `least_squares` would need the whole Jacobian or an inner iteration, and nears active bounds only in the
    limit, at a Jacobian a step; here its BVLS solves the bounded step exactly.

    Source: Moré 1978 (scaling by the largest column norms so far, relative tolerances).
    """
    here, search, scale = start, _DampingSearch(system, box, loss, limits), None
    for iteration in range(limits.iterations):
        model = ArrowModel([loss.scaled(block) for block in system.linearise(here.point, here.residuals)])
        scale = _larger(scale, model.norms())
        newton = model.reduction(model.step(NO_DAMPING, scale, box.around(here.point)))
        if newton <= limits.cost * here.cost:
            return Minimum(here, iteration, True, "no step promises a relevant reduction")
        there = search.downhill(model, here, scale)
        if there is None:
            return search.given_up(here, iteration, newton)
        report(iteration + 1, there)
        gained, here = here.cost - there.cost, there
        if gained <= limits.cost * here.cost and search.damping < 1.0 and _irrelevant(newton, here, limits.cost):
            return Minimum(here, iteration + 1, True, "the cost no longer falls")
    return Minimum(here, limits.iterations, False, f"stopped after {limits.iterations} iterations")


class _DampingSearch:
    """The damping (the more, the shorter the step), and what is left of the evaluations."""

    def __init__(self, system: ArrowSystem, box: Box, loss: Loss, limits: SearchLimits) -> None:
        self.system, self.box, self.loss, self.limits = system, box, loss, limits
        self.left, self.damping, self.failed = limits.evaluations, 1e-3, 0

    def downhill(self, model: ArrowModel, here: Iterate, scale: Point) -> Iterate | None:
        """The first better point, damping the step more and more; None when there is none."""
        growth, self.failed = 4.0, 0
        while self.left > 0 and self.damping < _MOST_DAMPING:
            step = model.step(self.damping, scale, self.box.within_reach(here.point))
            if _negligible(step, here.point, self.limits.step):
                return None
            self.left -= 1
            there = evaluated(self.system, (here.point + step).clipped(self.box), self.loss)
            if there is None:
                self.failed, self.damping = self.failed + 1, max(self.damping, _CAREFUL)
            expected = model.reduction(step)
            gain = (here.cost - there.cost) / expected if there and expected > 0 else -math.inf
            if there is not None and gain > _SUFFICIENT:
                self._trust(gain)
                return there
            self.damping, growth = self.damping * growth, 2.0 * growth
        return None

    def _trust(self, gain: float) -> None:
        if gain > 0.75 and not self.failed:
            self.damping = max(0.1 * self.damping, NO_DAMPING)
        elif gain < 0.25:
            self.damping *= 3.0

    def given_up(self, here: Iterate, iteration: int, promised: float) -> Minimum:
        """Why `downhill` found nothing, where the model promised to take so much off the cost."""
        if self.left <= 0:
            return Minimum(here, iteration, False, "stopped: no evaluations left")
        if self.damping < 1.0:
            return Minimum(here, iteration, True, "steps have become negligible")
        if _irrelevant(promised, here, self.limits.cost):
            return Minimum(here, iteration, True, ROUGH, promised / here.cost)
        if self.failed:
            return Minimum(here, iteration, False, f"stopped: {self.failed} points ahead could not be simulated")
        why = "stopped: no better point was found however short the step"
        return Minimum(here, iteration, False, why, promised / here.cost)


def evaluated(system: ArrowSystem, point: Point, loss: Loss) -> Iterate | None:
    """The point with its residuals and cost; None when it cannot be evaluated."""
    residuals = system.residuals(point)
    return None if residuals is None else Iterate(point, residuals, loss.cost(residuals))


def _negligible(step: Point, point: Point, tolerance: float) -> bool:
    return bool(np.all(np.abs(step.flat) <= tolerance * (1.0 + np.abs(point.flat))))


def _irrelevant(promised: float, here: Iterate, tolerance: float) -> bool:
    """Whether a reduction of the cost is no more than rough residuals, or noise of their size, promise at a minimum."""
    noise = 2 * len(here.point.flat) / sum(map(len, here.residuals))
    return promised <= max(_ROUGHNESS * tolerance, min(noise, 0.1)) * here.cost


def _larger(scale: Point | None, norms: Point) -> Point:
    if scale is None:
        return norms
    return Point(np.maximum(scale.parameters, norms.parameters), np.maximum(scale.states, norms.states))
