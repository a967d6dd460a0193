"""Every way of estimating a linear model that a study leaves open, tried; what fails is an entry like the others."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmus.errors import IdentificationError
from identification.linear.mode_tracking import ModeSpread
from identification.linear.model import LinearModel
from identification.linear.poles import Poles
from identification.linear.preparation import PreparedData
from identification.linear.records import InputOutputData
from identification.linear.reduction import without_constants
from identification.subspace.free_runs import free_runs, offset_of, samples_for
from identification.subspace.orders import OrderRule
from identification.subspace.range_space import RangeSpace, SubspaceSettings, range_space
from identification.subspace.realisation import SubspaceResult
from identification.subspace.subspace import in_range_space
from orchestrator.trace import FloatArray

_LOWEST = -1.0  # FIT from which on it does not matter how bad a run is


@dataclass(frozen=True, eq=False)
class ModelCandidate:
    """A model and how it runs free along the traces.

    Attributes:
        model: in the signals' own units.
        why: how its order came about.
        train, unseen: (R, p) FIT of each record and output.
        runs: record -> (K, p) free run.
        offset: (p,) of the outputs, beside what was taken off all records.
        spreads: uncertainty of its modes, which only a refined model has.
        changes: and of its matrices; see `spread.changes`.
    """

    name: str
    model: LinearModel
    why: str
    train: FloatArray
    unseen: FloatArray
    runs: dict[str, FloatArray]
    offset: FloatArray
    spreads: tuple[ModeSpread, ...] = ()
    changes: tuple[LinearModel, ...] = ()

    @property
    def score(self) -> float:
        """Mean FIT of the free runs along records kept aside, without any along the fitted ones."""
        known = self.unseen if len(self.unseen) else self.train
        known = np.maximum(known[~np.isnan(known)], _LOWEST)
        return float(known.mean()) if known.size else _LOWEST


@dataclass(frozen=True)
class Sides:
    """Records that models are judged on.

    Attributes:
        start: seconds of an unseen record that its state is estimated from; None takes some periods of the model.
        rest: whether every record begins at rest.
    """

    fitted: tuple[InputOutputData, ...]
    unseen: tuple[InputOutputData, ...]
    start: float | None = None
    rest: bool = False

    def judged(self, name: str, why: str, model: LinearModel) -> ModelCandidate:
        """A model with its free runs: of fitted records from their fitted states, of others from a horizon's."""
        own, other = (None, None) if self.rest else (math.inf, samples_for(model, self.start))
        offset = np.zeros(len(model.outputs)) if self.rest else offset_of(model, self.fitted)
        seen, train = free_runs(model, self.fitted, own, offset)
        new, unseen = free_runs(model, self.unseen, other, offset)
        records = (*self.fitted, *self.unseen)
        runs = {record.name: run for record, run in zip(records, [*seen, *new], strict=True)}
        return ModelCandidate(name, model, why, train, unseen, runs, offset)


@dataclass(frozen=True, eq=False)
class SubspaceTrial:
    """A way that was tried.

    Attributes:
        result, candidate: what it gave; None where it failed, with the error.
    """

    settings: SubspaceSettings
    result: SubspaceResult | None = None
    candidate: ModelCandidate | None = None
    error: IdentificationError | None = None

    @property
    def score(self) -> float:
        return -math.inf if self.candidate is None else self.candidate.score


@dataclass(frozen=True, eq=False)
class Trying:
    """What is tried on which records.

    Attributes:
        ready: the records that are fitted.
        poles, feedthrough: those that are compared; the first is tried everywhere, the others where that is best.
    """

    ready: PreparedData
    sides: Sides
    rule: OrderRule
    poles: tuple[Poles, ...]
    feedthrough: tuple[bool, ...]

    def by(self, settings: Sequence[SubspaceSettings]) -> Iterator[SubspaceTrial]:
        """Trials of one weighting, with each of these block sizes; then the other poles and D of the best of them."""
        spaces = [self._space(one) for one in settings]
        first = [self._tried(space, self.poles[0], self.feedthrough[0]) for space in spaces]
        yield from first
        best = max(range(len(first)), key=lambda i: first[i].score)
        for poles in self.poles:
            for feedthrough in self.feedthrough:
                if (poles, feedthrough) != (self.poles[0], self.feedthrough[0]):
                    yield self._tried(spaces[best], poles, feedthrough)

    def _space(self, settings: SubspaceSettings) -> RangeSpace | SubspaceTrial:
        try:
            return range_space(self.ready.records, settings)
        except IdentificationError as error:
            return SubspaceTrial(settings, error=error)

    def _tried(self, space: RangeSpace | SubspaceTrial, poles: Poles, feedthrough: bool) -> SubspaceTrial:
        if isinstance(space, SubspaceTrial):
            return space
        settings = replace(space.settings, poles=poles, feedthrough=feedthrough)
        try:
            found = in_range_space(replace(space, settings=settings), self.rule)
        except IdentificationError as error:
            return SubspaceTrial(settings, error=error)
        model = without_constants(self.ready.unscaled(found.model), [record.u for record in self.sides.fitted])
        why = found.why
        if model.order < found.model.order:
            why += f", of which {found.model.order - model.order} only added a constant"
        return SubspaceTrial(settings, found, self.sides.judged(settings.weighting, why, model))
