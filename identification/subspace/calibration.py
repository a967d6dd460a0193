"""A linear model of a study's traces: by each weighting it names, refined and reduced where it asks for that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from identification.estimation.validation import fit
from identification.linear.model import LinearModel
from identification.linear.modes import kept, modes
from identification.linear.preparation import Preparation, PreparedData, prepared, without_compensation
from identification.linear.records import InputOutputData
from identification.linear.updating import reduced, updated
from identification.recordings.campaign import Recorded, load_campaign, split
from identification.subspace.orders import Best, Gap, OrderRule, Threshold
from identification.subspace.prediction_error import Refined, Refinement, refine
from identification.subspace.range_space import SubspaceSettings
from identification.subspace.realisation import SubspaceResult, simulated
from identification.subspace.schema import OrderBlock, ReductionBlock, SubspaceBlock
from identification.subspace.subspace import subspace
from identification.subspace.weightings import Weighting
from orchestrator.progress import Progress
from orchestrator.trace import FloatArray


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model and how it runs free along the traces.

    Attributes:
        model: in the signals' own units.
        why: how its order came about.
        train, unseen: (R, p) FIT of each trace and output.
        runs: trace -> (K, p) free run.
    """

    name: str
    model: LinearModel
    why: str
    train: FloatArray
    unseen: FloatArray
    runs: dict[str, FloatArray]


@dataclass(frozen=True, eq=False)
class SubspaceCalibration:
    """What a study gave.

    Attributes:
        records: trace -> the record that models are judged on: bias and compensation taken off, nothing filtered.
        subspaces: weighting -> its estimate.
        refined: what the refinement gave, where it was asked for.
    """

    study: SubspaceBlock
    recorded: tuple[Recorded, ...]
    records: dict[str, InputOutputData]
    candidates: dict[str, Candidate]
    subspaces: dict[str, SubspaceResult]
    refined: Refined | None

    @property
    def taken(self) -> Candidate:
        """The one that is written."""
        return self.candidates[self.study.taken]


def calibrate(study: SubspaceBlock, base: Path, data: Path | None, progress: Progress) -> SubspaceCalibration:
    """Identify, refine, reduce, and judge on the traces kept aside.

    Args:
        base: folder of the study file.
        data: the recordings, over the study's own.

    Raises:
        InputError: the study and the traces do not fit together, or the data do not bear the model.
    """
    recorded = load_campaign(
        study.traces, base, data, lambda fraction, doing: progress(0.5 * fraction, doing), study.signals
    )
    fitted, kept = split(recorded, study.traces.hold_out)
    given = {each.trace.name: _record(study, each) for each in recorded}
    ready = prepared([given[each.trace.name] for each in fitted], _preparation(study))
    plain = Preparation(tuple(study.preparation.zero_mean), scaled=False)
    judged = {name: prepared([each], plain).records[0] for name, each in given.items()}
    sides = ([judged[each.trace.name] for each in fitted], [judged[each.trace.name] for each in kept])
    found: dict[str, SubspaceResult] = {}
    candidates: dict[str, Candidate] = {}
    for number, weighting in enumerate(study.weightings):
        progress(0.5 + 0.2 * number / len(study.weightings), weighting)
        found[weighting] = subspace(ready.records, _rule(study.order), settings_of(study, weighting))
        candidates[weighting] = _judged(study, weighting, found[weighting].why, found[weighting].model, ready, sides)
    best, why = found[study.weightings[0]].model, found[study.weightings[0]].why
    refined = None
    if study.refine:
        progress(0.7, "refining")
        refined = refine(best, ready.records, _refinement(study), found[study.weightings[0]].gain)
        best = refined.model
        candidates["refined"] = _judged(study, "refined", why, best, ready, sides)
    if study.reduce is not None:
        best = _reduced(best, study.reduce, ready.records)
        why = f"{best.order} states by {study.reduce.by.upper()}"
        candidates["reduced"] = _judged(study, "reduced", why, best, ready, sides)
    return SubspaceCalibration(study, tuple(recorded), judged, candidates, found, refined)


def _record(study: SubspaceBlock, recorded: Recorded) -> InputOutputData:
    trace = recorded.trace.select([*study.inputs, *study.outputs])
    if study.sample is not None:
        count = int(trace.duration / study.sample * (1 + 1e-12)) + 1
        trace = trace.resampled(trace.time[0] + study.sample * np.arange(count), hold=study.inputs)
    given = InputOutputData.of(trace, study.inputs, study.outputs)
    return replace(given, u=without_compensation(given.u, study.preparation.compensation))


def _preparation(study: SubspaceBlock) -> Preparation:
    how = study.preparation
    return Preparation(tuple(how.zero_mean), how.cutoff, how.causal, how.filter_input, how.scaled)


def settings_of(study: SubspaceBlock, weighting: Weighting) -> SubspaceSettings:
    """How a model is estimated with one of the study's weightings."""
    return SubspaceSettings(
        study.block,
        weighting,
        past=study.past,
        closed_loop=study.closed_loop,
        feedthrough=study.feedthrough,
        initial_states=study.initial_states,
        poles=study.poles,
    )


def _refinement(study: SubspaceBlock) -> Refinement:
    return Refinement(
        "innovations" if study.closed_loop else "output-error",
        feedthrough=study.feedthrough,
        poles=study.poles,
        initial_states=study.initial_states,
    )


def _rule(order: int | OrderBlock) -> OrderRule:
    if isinstance(order, int):
        return order
    if order.threshold is not None:
        return Threshold(order.threshold)
    if order.gap is not None:
        return Gap(*order.gap)
    assert order.best is not None
    return Best(range(order.best[0], order.best[1] + 1))


def _reduced(model: LinearModel, how: ReductionBlock, records: Sequence[InputOutputData]) -> LinearModel:
    u = np.concatenate([record.u for record in records])
    numbers = kept(how.by, modes(model), u, how.order, how.flexible)
    return updated(reduced(model, numbers), records, how.update)


def _judged(
    study: SubspaceBlock,
    name: str,
    why: str,
    model: LinearModel,
    ready: PreparedData,
    sides: tuple[Sequence[InputOutputData], Sequence[InputOutputData]],
) -> Candidate:
    """A model of prepared records, in the signals' own units, with its free runs of both sides: fitted and kept."""
    own = ready.unscaled(model)
    horizon = max(round(study.start / own.step), own.order + 1) if study.initial_states else 0
    runs: dict[str, FloatArray] = {}
    fits = []
    for side in sides:
        free = simulated(own, side, horizon) if horizon else [own.simulate(each.u) for each in side]
        runs |= {each.name: run for each, run in zip(side, free, strict=True)}
        fits.append(np.array([fit(each.y, run) for each, run in zip(side, free, strict=True)]))
    return Candidate(name, own, why, fits[0], fits[1].reshape(-1, len(own.outputs)), runs)
