"""One data set of a campaign: prepared, identified at every order of a range, and validated in two ways.

Data matching (DMV) runs a model freely along the record whose first half it was fitted to. Set-point following (SFV)
runs it under the rig's controller, against the response that the rig gave to the same set-point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.threads import single_threaded
from identification.estimation.validation import delta
from identification.experiments.physical_modes import PhysicalMode
from identification.experiments.reduction import Errors, Judge, Reduction, reduce_and_update
from identification.experiments.schema import ExampleBlock, ExperimentsBlock
from identification.linear.mode_tracking import stabilisation
from identification.linear.model import LinearModel
from identification.linear.preparation import Preparation, PreparedData, prepared, without_compensation
from identification.linear.records import InputOutputData
from identification.linear.set_point import Feedback, followed
from identification.subspace.range_space import SubspaceSettings, range_space
from identification.subspace.realisation import realise
from orchestrator.trace import FloatArray, Trace

NEAR = 0.15  # how far from a physical frequency its mode is looked for, relative


@dataclass(frozen=True, eq=False)
class Attempt:
    """A model of one order, in scaled outputs, and how it did."""

    model: LinearModel
    errors: Errors

    @property
    def order(self) -> int:
        """Number of states."""
        return self.model.order

    @property
    def stable(self) -> bool:
        """Whether no pole is outside the unit circle."""
        return self.model.stable


@dataclass(frozen=True, eq=False)
class SetResult:
    """What a data set gave.

    Attributes:
        removed: whether the compensation was taken off the input (type II), or left in it (type III).
        attempts: one an order that could be had, rising.
        scale: (p,) by which the outputs were multiplied.
        stop: how long an end stop was touched [s].
        frequencies: relative distances from the physical modes, see `distances`.
        reductions: the examples that begin with this data set.
    """

    code: str
    removed: bool
    attempts: tuple[Attempt, ...]
    scale: FloatArray
    stop: float
    frequencies: tuple[float, ...]
    reductions: tuple[Reduction, ...]

    @property
    def stable(self) -> list[int]:
        """Orders that gave a stable model."""
        return [each.order for each in self.attempts if each.stable]

    @property
    def chosen(self) -> Attempt:
        """The stable model with the least delta-bar in data matching; the best of all where none is stable."""
        return best([each for each in self.attempts if each.stable] or self.attempts)

    def unscaled(self, model: LinearModel) -> LinearModel:
        """One of its models in the outputs' own units."""
        return replace(model, c=model.c / self.scale[:, None], d=model.d / self.scale[:, None])

    def attempt(self, order: int) -> Attempt | None:
        """The model of this order, None where it could not be had."""
        return next((each for each in self.attempts if each.order == order), None)


@dataclass(frozen=True, eq=False)
class Job:
    """What a process needs to work on one data set.

    Attributes:
        following: the record whose set-point and response count for this payload.
    """

    study: ExperimentsBlock
    code: str
    removed: bool
    trace: Trace
    following: Trace
    physical: tuple[PhysicalMode, ...]

    @property
    def label(self) -> str:
        """The data set's code, with a `c` where the compensation is left in."""
        return self.code if self.removed else f"{self.code}c"


def mean(errors: FloatArray | None) -> float:
    """Delta-bar; inf for an unstable loop or a run that overflowed."""
    value = math.inf if errors is None else float(np.mean(errors))
    return value if math.isfinite(value) else math.inf


def best(attempts: Sequence[Attempt]) -> Attempt:
    """The one with the least delta-bar in data matching."""
    return min(attempts, key=lambda each: mean(each.errors.dmv))


@single_threaded
def work(job: Job) -> SetResult:
    """Everything about one data set.

    Raises:
        IdentificationError: the record does not fit its entry in the study, or does not bear any order.
    """
    study = job.study
    ready = prepared([_cut(job)], _preparation(study))
    whole = ready.records[0]
    fitted = whole.rows(0, len(whole) // 2)
    judge = _judge(job, ready)
    attempts = _attempts(study, fitted, judge)
    if not attempts:
        raise IdentificationError(f"sets.{job.code}", "bears no order of the range", "widen `orders`")
    result = SetResult(job.code, job.removed, attempts, ready.scale, _stop(job), (), ())
    return replace(
        result,
        frequencies=distances([each.model for each in attempts], job.physical),
        reductions=tuple(_reduction(result, each, fitted, job, judge) for each in _examples(job)),
    )


def distances(models: Sequence[LinearModel], physical: Sequence[PhysicalMode]) -> tuple[float, ...]:
    """|f / f_physical - 1| of what the models of all orders say of each physical mode; inf where they do not.

    A model has many pairs, and one of them is always near. What counts is the median of those within `NEAR` that came
    back at the next order in the same place: the stable points of a stabilisation diagram.
    """
    stable = [each.mode.frequency for each in stabilisation(models) if each.stable]
    away = []
    for known in physical:
        near = [each for each in stable if abs(each / known.frequency - 1) <= NEAR]
        away.append(abs(float(np.median(near)) / known.frequency - 1) if near else math.inf)
    return tuple(away)


def _cut(job: Job) -> InputOutputData:
    """The samples that count, the compensation taken off where it shall be."""
    known = job.study.sets[job.code]
    whole = InputOutputData.of(job.trace, [job.study.input], job.study.outputs)
    if abs(whole.step * known.rate - 1) > 1e-3 or len(whole) < known.samples:
        raise IdentificationError(
            f"sets.{job.code}",
            f"has {len(whole)} samples at {1 / whole.step:g} Hz, {known.samples} at {known.rate:g} Hz are needed",
            "correct the scenario or the study",
        )
    u = without_compensation(whole.u, known.compensation) if job.removed else whole.u
    return replace(whole, u=u).rows(0, known.samples)


def _stop(job: Job) -> float:
    samples = job.study.sets[job.code].samples
    return float(np.max(job.trace[job.study.stop][:samples])) if job.study.stop else 0.0


def _preparation(study: ExperimentsBlock) -> Preparation:
    how = study.preparation
    return Preparation(tuple(how.zero_mean), how.cutoff, how.causal, how.filter_input)


def _attempts(study: ExperimentsBlock, fitted: InputOutputData, judge: Judge) -> tuple[Attempt, ...]:
    space = range_space(fitted, SubspaceSettings(study.block, feedthrough=False, initial_states=False))
    attempts = []
    for order in range(study.orders[0], study.orders[1] + 1):
        try:
            model = realise(space, order).model
        except IdentificationError:  # not borne by the data; a study sees it in the list of orders
            continue
        attempts.append(Attempt(model, judge(model)))
    return tuple(attempts)


def _judge(job: Job, ready: PreparedData) -> Judge:
    """The two validations of models of this record."""
    study, whole = job.study, ready.records[0]
    set_point, measured = _followed(job, whole.step)
    feedback = Feedback(
        study.feedback.proportional,
        study.feedback.derivative,
        study.outputs.index(study.feedback.position),
        study.outputs.index(study.feedback.speed),
    )

    def judge(model: LinearModel) -> Errors:
        with np.errstate(over="ignore", invalid="ignore"):
            dmv = delta(whole.y, model.simulate(whole.u))
            run = followed(ready.unscaled(model), feedback, set_point)
        return Errors(dmv, None if run is None else delta(measured, run))

    return judge


def _followed(job: Job, step: float) -> tuple[FloatArray, FloatArray]:
    """Set-point (K,) and measured response (K, p) of the record for this payload, at this step."""
    study = job.study
    code = study.feedback.records[study.sets[job.code].payload]
    trace = job.following
    trace = trace.between(float(trace.time[0]), float(trace.time[study.sets[code].samples - 1]))
    grid = trace.time[0] + step * np.arange(int(trace.duration / step + 0.5))
    trace = trace.resampled(grid, hold=[study.feedback.reference])
    measured = InputOutputData.of(trace, [study.input], study.outputs)
    plain = replace(_preparation(study), scaled=False)
    return trace[study.feedback.reference], prepared([measured], plain).records[0].y


def _examples(job: Job) -> list[ExampleBlock]:
    return [each for each in job.study.examples if (each.data, each.removed) == (job.code, job.removed)]


def _reduction(result: SetResult, example: ExampleBlock, fitted: InputOutputData, job: Job, judge: Judge) -> Reduction:
    start = result.chosen
    if example.unstable:
        unstable = [each for each in result.attempts if not each.stable]
        if not unstable:
            raise IdentificationError(f"examples.{example.name}", "every order is stable", "remove `unstable`")
        start = best(unstable)
    return reduce_and_update(start.model, example, fitted, [mode.frequency for mode in job.physical], judge)
