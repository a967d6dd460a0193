"""Refinement of a linear model: least squares of what it predicts wrongly, started from a subspace estimate.

The error is that of the free run (output error) or of one step ahead (innovations). The second is the first of another
model, the predictor, whose inputs are inputs and outputs alike; so there is one minimiser. Derivatives are exact: the
model's own sensitivities, simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.linalg import solve_discrete_are

from fmus.errors import IdentificationError
from identification.estimation.arrow_least_squares import Loss, WindowBlock
from identification.estimation.threads import single_threaded
from identification.estimation.uncertainty import Covariance, covariance
from identification.linear.local_coordinates import Directions, balanced_basis
from identification.linear.model import LinearModel
from identification.linear.poles import Poles, constrained
from identification.linear.records import InputOutputData, Records, checked_weights, without_gaps
from identification.subspace.refinement.prediction_problem import PredictionProblem
from orchestrator.trace import FloatArray

Error = Literal["output-error", "innovations"]
_MOST_DAMPING, _LEAST_DAMPING = 1e8, 1e-10
_ROUGHNESS = 1e3  # times the tolerance: what a linear model may still promise of a cost that does not follow it
_NO_EFFECT = 1e-10
_DISTURBANCE = 1e-3
_OVERFLOW = 1e100
INTERRUPTED = "was interrupted"


@dataclass(frozen=True)
class Refinement:
    """What is minimised, and what the model keeps.

    Attributes:
        error: "output-error" for the best free run, when noise is independent of the input; "innovations" for data
            from a closed loop.
        feedthrough: estimate D, instead of fixing it to 0.
        poles: "stable" keeps all poles inside the unit circle, "integrating" also one on 1.
        initial_states: estimate each record's state at its start; False starts all at 0.
        weights: (p,) one over each output's unit of error; one over its rms when empty.
        tolerance: relative decrease of the sum of squares below which it ends.
        iterations: it ends after so many, converged or not.
    """

    error: Error = "output-error"
    feedthrough: bool = False
    poles: Poles = "free"
    initial_states: bool = True
    weights: tuple[float, ...] = ()
    tolerance: float = 1e-6
    iterations: int = 50


@dataclass(frozen=True, eq=False)
class Refined:
    """A refined model with the evidence for it.

    Attributes:
        model: A, B, C, D, in balanced coordinates.
        gain: (n, p) Kalman gain; without columns for output error.
        initial_states: (R, n), one a record.
        records: what was fitted: the given records cut at gaps.
        cost, first_cost: mean square of the weighted error of a sample, at the end and at the start.
        iterations: steps that were taken.
        converged, why: whether and how it ended.
        weights: (p,) in force.
        problem, candidate: what was minimised, and its minimiser in weighted outputs.
    """

    model: LinearModel
    gain: FloatArray
    initial_states: FloatArray
    records: tuple[InputOutputData, ...]
    cost: float
    first_cost: float
    iterations: int
    converged: bool
    why: str
    weights: FloatArray
    problem: PredictionProblem
    candidate: LinearModel

    @property
    def interrupted(self) -> bool:
        return self.why == INTERRUPTED

    @property
    def directions(self) -> Directions:
        """What a step along each degree of freedom changes in the model's matrices; `uncertainty` is of these steps."""
        own, candidate = self.problem.directions(self.candidate), self.candidate
        inputs, scale = len(self.model.inputs), self.weights[:, None]
        gain, change = self.problem.gain(candidate), own.b[:, :, inputs:]
        measured = self.problem.measured
        c, d = own.c[:, :measured], own.d[:, :measured, :inputs]
        return Directions(
            own.a + change @ candidate.c[:measured] + gain @ c,
            own.b[:, :, :inputs] + change @ candidate.d[:measured, :inputs] + gain @ d,
            own.c / scale,
            own.d[:, :, :inputs] / scale,
        )


@single_threaded
def refine(
    model: LinearModel,
    records: Records,
    settings: Refinement,
    gain: FloatArray | None = None,
    report: Callable[[float, float], None] = lambda share, cost: None,
) -> Refined:
    """The model, changed until its error over all records is least.

    Args:
        model: where to start, from `subspace`.
        gain: (n, p) Kalman gain to start the innovations from; when not given, that of a model whose states are
            disturbed by a thousandth of their power.
        report: told after each step which share of the iterations is done, and the cost.

    An interrupt ends it: what was found until then comes back and says so.

    Raises:
        IdentificationError: records that do not fit the model, or a start whose errors are not finite.
    """
    pieces = without_gaps(records, model.order + 1).records
    if (pieces[0].inputs, pieces[0].outputs) != (model.inputs, model.outputs):
        raise IdentificationError(
            pieces[0].name,
            f"has columns {pieces[0].inputs} and {pieces[0].outputs}, the model {model.inputs} and {model.outputs}",
            "give the model's",
        )
    weights = _weights(settings, pieces)
    problem, start = _posed(model, pieces, weights, settings, gain)
    first = _at(problem, start.transformed(balanced_basis(start, [u for u, _ in problem.data])))
    if not np.isfinite(first.cost):
        raise IdentificationError("refinement", "the free run of the start overflows", "start from a stable model")
    last, iterations, converged, why = _minimised(problem, first, settings, report)
    found, k = _unposed(problem, last.model, model, weights)
    return Refined(
        found, k, last.starts, pieces, last.cost, first.cost, iterations, converged, why, weights, problem, last.model
    )


@single_threaded
def uncertainty(refined: Refined) -> Covariance:
    """Covariance of the steps along `refined.directions`, allowing for coloured errors and the initial states.

    The whole Jacobian is held in memory.
    """
    own = refined.model.order * refined.problem.starts
    directions = refined.problem.directions(refined.candidate)
    blocks = []
    for record, start in enumerate(refined.initial_states):
        chunks = refined.problem.rows(refined.candidate, directions, record, start)
        rows = np.concatenate(list(chunks))[:, refined.model.order - own :]
        blocks.append(WindowBlock(rows[:, -1], -rows[:, own:-1], -rows[:, :own]))
    return covariance(blocks, Loss(), len(refined.model.outputs))


@dataclass(frozen=True, eq=False)
class _Point:
    model: LinearModel
    starts: FloatArray
    cost: float


def _at(problem: PredictionProblem, model: LinearModel) -> _Point:
    """The point with its best initial states; infinite cost where a run overflows or a pole is where none may be."""
    if not problem.admitted(model):
        return _Point(model, np.zeros((len(problem.data), model.order)), np.inf)
    starts = problem.starts_of(model)
    with np.errstate(over="ignore", invalid="ignore"):
        cost = sum(float(np.sum(error**2)) for error in problem.errors(model, starts)) / problem.samples
    return _Point(model, starts, cost if np.isfinite(cost) else np.inf)


def _minimised(
    problem: PredictionProblem, point: _Point, settings: Refinement, report: Callable[[float, float], None]
) -> tuple[_Point, int, bool, str]:
    """The last point, steps taken, whether it is a minimum, and why it ended."""
    damping = 1e-3
    for iteration in range(settings.iterations):
        report(iteration / settings.iterations, point.cost)
        try:
            directions = problem.directions(point.model)
            quadratic = _Quadratic.of(problem.triangle(point.model, directions, point.starts))
            if quadratic.promise < settings.tolerance:
                why = f"no step promises to lower the error by more than {settings.tolerance:g}"
                return point, iteration, True, why
            trial, damping = _stepped(problem, point, directions, quadratic, damping)
        except KeyboardInterrupt:
            return point, iteration, False, INTERRUPTED
        except IdentificationError as error:
            if not iteration:
                raise
            return point, iteration, False, f"ended where it could not go on ({error.problem})"
        if trial is None:
            rough = quadratic.promise < _ROUGHNESS * settings.tolerance
            why = f"no step lowers the error, although one promised {quadratic.promise:.2g} of it"
            return point, iteration, rough, why
        decrease, point = 1 - trial.cost / point.cost, trial
        if decrease < settings.tolerance / 10:
            return point, iteration + 1, True, f"the error fell by less than {settings.tolerance / 10:g}"
    return point, settings.iterations, False, f"{settings.iterations} steps were taken"


def _stepped(
    problem: PredictionProblem, point: _Point, directions: Directions, quadratic: _Quadratic, damping: float
) -> tuple[_Point | None, float]:
    """The first point with a lower cost as the damping grows, and the damping to go on with."""
    while damping < _MOST_DAMPING:
        moved = directions.moved(point.model, quadratic.step(damping))
        try:
            trial = _at(problem, problem.placed(moved))
        except IdentificationError:  # no model: no pole to be an integrator, or a run that overflows
            trial = replace(point, cost=np.inf)
        if trial.cost < point.cost:
            return trial, max(damping / 10, _LEAST_DAMPING)
        damping *= 10
    return None, damping


@dataclass(frozen=True, eq=False)
class _Quadratic:
    """The least-squares problem at a point, with columns of length 1, by its singular value decomposition."""

    lengths: FloatArray
    right: FloatArray
    values: FloatArray
    target: FloatArray
    total: float

    @classmethod
    def of(cls, triangle: FloatArray) -> _Quadratic:
        if not np.abs(triangle).max() < _OVERFLOW:
            raise IdentificationError("refinement", "the model's sensitivities overflow", "start from a stable model")
        jacobian, error = triangle[:, :-1], triangle[:, -1]
        lengths = np.linalg.norm(jacobian, axis=0)
        lengths = np.where(lengths > 0, lengths, 1.0)
        left, values, right = np.linalg.svd(jacobian / lengths, full_matrices=False)
        return cls(lengths, right.T, values, left.T @ error, float(error @ error))

    @property
    def promise(self) -> float:
        """By how much of the sum of squares an undamped step lowers its linear model."""
        seen = self.values > _NO_EFFECT * self.values[0]
        return float(np.sum(self.target[seen] ** 2)) / self.total if self.total > 0 else 0.0

    def step(self, damping: float) -> FloatArray:
        """(t,) step with the squares of the scaled step added, times the damping."""
        return np.asarray(self.right @ (self.values / (self.values**2 + damping) * self.target) / self.lengths)


def _weights(settings: Refinement, records: Sequence[InputOutputData]) -> FloatArray:
    if settings.weights:
        return checked_weights(settings.weights, records[0].outputs)
    size = np.sqrt(sum(np.sum(record.y**2, axis=0) for record in records) / sum(map(len, records)))
    return np.asarray(1 / np.where(size > 0, size, 1.0))


def _posed(
    model: LinearModel,
    records: Sequence[InputOutputData],
    weights: FloatArray,
    settings: Refinement,
    gain: FloatArray | None,
) -> tuple[PredictionProblem, LinearModel]:
    """The problem and the candidate that stands for the model in it."""
    a, _ = constrained(model.a, settings.poles)
    c, d = model.c * weights[:, None], model.d * weights[:, None] * settings.feedthrough
    mask = np.full(d.shape, settings.feedthrough)
    data = [(record.u, record.y * weights) for record in records]
    if settings.error == "output-error":
        return (
            PredictionProblem(tuple(data), mask, 0, settings.poles, settings.initial_states),
            replace(model, a=a, c=c, d=d),
        )
    k = _kalman_gain(replace(model, a=a, c=c, d=d), data) if gain is None else gain / weights
    none = np.zeros((len(c), len(c)))
    both, free = [(np.hstack([u, y]), y) for u, y in data], np.hstack([mask, none.astype(bool)])
    problem = PredictionProblem(tuple(both), free, len(c), settings.poles, settings.initial_states)
    predictor = LinearModel(
        a - k @ c,
        np.hstack([model.b - k @ d, k]),
        c,
        np.hstack([d, none]),
        model.step,
        model.inputs + model.outputs,
        model.outputs,
    )
    return problem, predictor


def _kalman_gain(model: LinearModel, data: Sequence[tuple[FloatArray, FloatArray]]) -> FloatArray:
    """(n, p) stationary gain for a disturbance of the states and the noise that the free runs leave."""
    states = np.vstack([model.states(u) for u, _ in data])
    left = np.vstack([y - model.simulate(u) for u, y in data])
    if not max(np.abs(states).max(initial=0.0), np.abs(left).max()) < _OVERFLOW:
        raise IdentificationError("refinement", "the free run of the start overflows", "give the gain of a predictor")
    disturbance = _DISTURBANCE * states.T @ states / len(states)
    noise = left.T @ left / len(left) + _DISTURBANCE * np.eye(left.shape[1])
    try:
        power = solve_discrete_are(model.a.T, model.c.T, disturbance, noise, balanced=False)
    except (np.linalg.LinAlgError, ValueError):
        raise IdentificationError("refinement", "the start has no stable predictor", "give a gain") from None
    return np.asarray(np.linalg.solve(model.c @ power @ model.c.T + noise, model.c @ power @ model.a.T).T)


def _unposed(
    problem: PredictionProblem, candidate: LinearModel, model: LinearModel, weights: FloatArray
) -> tuple[LinearModel, FloatArray]:
    """The model and the gain that a candidate stands for."""
    inputs, gain = len(model.inputs), problem.gain(candidate)
    d = candidate.d[:, :inputs]
    found = replace(
        model,
        a=problem.open_loop(candidate),
        b=candidate.b[:, :inputs] + gain @ d[: problem.measured],
        c=candidate.c / weights[:, None],
        d=d / weights[:, None],
    )
    return found, gain * weights[: problem.measured]
