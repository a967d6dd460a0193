"""What one data set gives: models of every order of a range, validated in two ways, and some of them reduced.

Data matching (DMV) runs a model freely along the record whose first half it was fitted to. Set-point following (SFV)
runs it under the rig's controller, against the response that the rig gave to the same set-point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.threads import single_threaded
from identification.estimation.validation import delta
from identification.experiments.data_set import DataSet
from identification.experiments.physical_modes import PhysicalMode
from identification.experiments.reduction import (
    Example,
    ReductionExample,
    Validate,
    ValidationErrors,
    reduce_and_update,
)
from identification.linear.mode_tracking import stabilisation
from identification.linear.model import LinearModel
from identification.linear.modes import NEAR
from identification.linear.preparation import PreparedData, prepared
from identification.linear.records import InputOutputData
from identification.linear.set_point import followed
from identification.subspace.range_space import SubspaceSettings, range_space
from identification.subspace.realisation import realise
from orchestrator.trace import FloatArray


@dataclass(frozen=True, eq=False)
class Attempt:
    """A model of one order, in scaled outputs, and how it did."""

    model: LinearModel
    errors: ValidationErrors

    @property
    def order(self) -> int:
        """Number of states."""
        return self.model.order


@dataclass(frozen=True, eq=False)
class SetResult:
    """What a data set gave.

    Attributes:
        attempts: one an order that could be had, rising.
        ready: the record, prepared; its outputs' scale is that of the models.
        frequencies: relative distances from the physical modes, see `distances`.
        reductions: of the data set's examples.
    """

    data_set: DataSet
    attempts: tuple[Attempt, ...]
    ready: PreparedData
    frequencies: tuple[float, ...]
    reductions: tuple[ReductionExample, ...]

    @property
    def stable(self) -> list[int]:
        """Orders that gave a stable model."""
        return [attempt.order for attempt in self.attempts if attempt.model.stable]

    @property
    def chosen(self) -> Attempt:
        """The stable model with the least delta-bar in data matching; the best of all where none is stable."""
        return _best([attempt for attempt in self.attempts if attempt.model.stable] or self.attempts)

    def attempt(self, order: int) -> Attempt | None:
        """The model of this order, None where it could not be had."""
        return next((attempt for attempt in self.attempts if attempt.order == order), None)


def mean(errors: FloatArray | None) -> float:
    """Delta-bar; inf for an unstable loop or a run that overflowed."""
    value = math.inf if errors is None else float(np.mean(errors))
    return value if math.isfinite(value) else math.inf


def _best(attempts: Sequence[Attempt]) -> Attempt:
    """The one with the least delta-bar in data matching."""
    return min(attempts, key=lambda attempt: mean(attempt.errors.dmv))


@single_threaded
def identified(data_set: DataSet) -> SetResult:
    """Everything about one data set.

    Raises:
        IdentificationError: its record does not bear any order.
    """
    ready = prepared([data_set.data], data_set.preparation)
    (whole,) = ready.records
    fitted = whole.rows(0, len(whole) // 2)
    validate = _validation(data_set, ready)
    attempts = _attempts(data_set, fitted, validate)
    if not attempts:
        raise IdentificationError(f"sets.{data_set.code}", "bears no order of the range", "widen `orders`")
    return SetResult(
        data_set,
        attempts,
        ready,
        distances([attempt.model for attempt in attempts], data_set.physical),
        tuple(_reduction(attempts, example, fitted, data_set, validate) for example in data_set.examples),
    )


def distances(models: Sequence[LinearModel], physical: Sequence[PhysicalMode]) -> tuple[float, ...]:
    """|f / f_physical - 1| of what the models of all orders say of each physical mode; inf where they do not.

    A model has many pairs, and one of them is always near. What counts is the median of those within `NEAR` that came
    back at the next order in the same place: the stable points of a stabilisation diagram.
    """
    stable = [sighting.mode.frequency for sighting in stabilisation(models) if sighting.stable]
    away = []
    for known in physical:
        near = [frequency for frequency in stable if abs(frequency / known.frequency - 1) <= NEAR]
        away.append(abs(float(np.median(near)) / known.frequency - 1) if near else math.inf)
    return tuple(away)


def _attempts(data_set: DataSet, fitted: InputOutputData, validate: Validate) -> tuple[Attempt, ...]:
    space = range_space(fitted, SubspaceSettings(data_set.block, initial_states=False))
    attempts = []
    for order in data_set.orders:
        try:
            model = realise(space, order).model
        except IdentificationError:  # not borne by the data; a study sees it in the list of orders
            continue
        attempts.append(Attempt(model, validate(model)))
    return tuple(attempts)


def _validation(data_set: DataSet, ready: PreparedData) -> Validate:
    """The two validations of models of this record."""
    (whole,), following = ready.records, data_set.following

    def validate(model: LinearModel) -> ValidationErrors:
        with np.errstate(over="ignore", invalid="ignore"):
            dmv = delta(whole.y, model.simulate(whole.u))
            run = followed(ready.unscaled(model), following.feedback, following.set_point)
        return ValidationErrors(dmv, None if run is None else delta(following.response, run))

    return validate


def _reduction(
    attempts: Sequence[Attempt], example: Example, fitted: InputOutputData, data_set: DataSet, validate: Validate
) -> ReductionExample:
    wanted = [attempt for attempt in attempts if attempt.model.stable != example.unstable]
    if example.unstable and not wanted:
        raise IdentificationError(f"examples.{example.name}", "every order is stable", "remove `unstable`")
    start = _best(wanted or attempts)
    return reduce_and_update(start.model, example, fitted, [mode.frequency for mode in data_set.physical], validate)
