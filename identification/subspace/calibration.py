"""A linear model of a study's traces: by each weighting it names, refined and reduced where it asks for that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from identification.estimation.validation import fit
from identification.linear.mode_tracking import Spread, spreads
from identification.linear.model import LinearModel
from identification.linear.modes import kept, modes
from identification.linear.preparation import Preparation, PreparedData, prepared, without_compensation
from identification.linear.records import InputOutputData
from identification.linear.updating import reduced, updated
from identification.recordings.campaign import StudyTrace, load_campaign, split
from identification.recordings.marks import nothing_left, sound
from identification.recordings.units import in_common_units
from identification.subspace.prediction_error import Refined, refine, uncertainty
from identification.subspace.realisation import SubspaceResult, simulated
from identification.subspace.schema import ReductionBlock, SubspaceBlock
from identification.subspace.subspace import subspace
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress
from orchestrator.trace import FloatArray


@dataclass(frozen=True, eq=False)
class Candidate:
    """A model and how it runs free along the traces.

    Attributes:
        model: in the signals' own units.
        why: how its order came about.
        train, unseen: (R, p) FIT of each record and output.
        runs: record -> (K, p) free run.
        spreads: uncertainty of its modes, which only a refined model has.
    """

    name: str
    model: LinearModel
    why: str
    train: FloatArray
    unseen: FloatArray
    runs: dict[str, FloatArray]
    spreads: tuple[Spread, ...] = ()


@dataclass(frozen=True, eq=False)
class SubspaceCalibration:
    """What a study gave.

    Attributes:
        records: name -> the record that models are judged on: bias and compensation taken off, nothing filtered.
        pieces: name of each of these -> trace that it is cut from, between its marks.
        dropped: samples in pieces that were too short.
        subspaces: weighting -> its estimate.
        refined: what the refinement gave, where it was asked for.
    """

    study: SubspaceBlock
    recorded: tuple[StudyTrace, ...]
    records: dict[str, InputOutputData]
    candidates: dict[str, Candidate]
    subspaces: dict[str, SubspaceResult]
    refined: Refined | None
    pieces: dict[str, str]
    dropped: int

    @property
    def taken(self) -> Candidate:
        """The one that is written."""
        return self.candidates[self.study.taken]


def calibrate(
    study: SubspaceBlock, base: Path, data: Path | None, progress: Progress, isolation: Isolation | None = None
) -> SubspaceCalibration:
    """Identify, refine, reduce, and judge on the traces kept aside.

    Args:
        base: folder of the study file.
        data: the recordings, over the study's own.
        isolation: of FMUs whose runs are the recordings.

    Raises:
        InputError: the study and the traces do not fit together, or the data do not bear the model.
    """
    source = study.source(base)
    recorded = load_campaign(source, data, lambda fraction, doing: progress(0.5 * fraction, doing), isolation)
    recorded = in_common_units(recorded, [*study.inputs, *study.outputs])
    fitted, aside = split(recorded, study.traces.hold_out)
    given = {known.trace.name: _record(study, known) for known in recorded}
    if any(np.isnan(record.u).any() for record in given.values()):
        study = study.model_copy(update={"initial_states": True})  # nothing rests where a piece begins
    how = study.preparation.preparation(scaled=study.preparation.scaled)
    plain = Preparation(how.zero_mean, scaled=False)
    there = {trace: record for trace, record in given.items() if np.isfinite(record.u).any()}
    cut = [(trace, piece) for trace, record in there.items() for piece in prepared([record], plain).records]
    judged = {piece.name: piece for trace, piece in cut if len(piece) >= study.shortest or piece.name == trace}
    origin = {piece.name: trace for trace, piece in cut if piece.name in judged}
    names = tuple(_of(side, origin, study) for side in (fitted, aside))
    ready = prepared([given[known.trace.name] for known in fitted], how)
    ready = replace(ready, records=tuple(record for record in ready.records if record.name in judged))
    sides = tuple([judged[name] for name in side] for side in names)
    found: dict[str, SubspaceResult] = {}
    candidates: dict[str, Candidate] = {}
    for number, weighting in enumerate(study.weightings):
        progress(0.5 + 0.2 * number / len(study.weightings), weighting)
        found[weighting] = subspace(ready.records, study.rule, study.settings(weighting))
        candidates[weighting] = _judged(study, weighting, found[weighting].why, found[weighting].model, ready, sides)
    best, why = found[study.weightings[0]].model, found[study.weightings[0]].why
    refined = None
    if study.refine:
        progress(0.7, "refining")
        refined = refine(best, ready.records, study.refinement, found[study.weightings[0]].gain)
        best = refined.model
        spread = spreads(best, refined.directions.a, uncertainty(refined).matrix)
        candidates["refined"] = replace(_judged(study, "refined", why, best, ready, sides), spreads=tuple(spread))
    if study.reduce is not None:
        best = _reduced(best, study.reduce, ready.records)
        why = f"{best.order} states by {study.reduce.by.upper()}"
        candidates["reduced"] = _judged(study, "reduced", why, best, ready, sides)
    dropped = sum(len(piece) for _, piece in cut if piece.name not in judged)
    return SubspaceCalibration(study, tuple(recorded), judged, candidates, found, refined, origin, dropped)


def _of(side: Sequence[StudyTrace], origin: Mapping[str, str], study: SubspaceBlock) -> list[str]:
    """The records that are cut from these traces.

    Raises:
        TraceError: marks leave none.
    """
    traces = {known.trace.name for known in side}
    names = [name for name, trace in origin.items() if trace in traces]
    if side and not names:
        raise nothing_left(side[0].place, f"{study.shortest} samples in a row are not", side[0].marks)
    return names


def _record(study: SubspaceBlock, recorded: StudyTrace) -> InputOutputData:
    """The trace at the study's samples, with gaps where it is marked."""
    trace = recorded.trace.select([*study.inputs, *study.outputs])
    marks = [mark for mark in recorded.marks if mark.concerns(trace.names)]
    if study.sample is not None:
        count = int(trace.duration / study.sample * (1 + 1e-12)) + 1
        trace = trace.resampled(trace.time[0] + study.sample * np.arange(count), hold=study.inputs)
    given = InputOutputData.of(trace, study.inputs, study.outputs)
    u = without_compensation(given.u, study.preparation.compensation)
    used = sound(trace, marks)[:, None]
    return replace(given, u=np.where(used, u, np.nan), y=np.where(used, given.y, np.nan))


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
    sides: Sequence[Sequence[InputOutputData]],
) -> Candidate:
    """A model of prepared records, in the signals' own units, with its free runs of both sides: fitted and kept."""
    own = ready.unscaled(model)
    horizon = max(round(study.start / own.step), own.order + 1) if study.initial_states else 0
    runs: dict[str, FloatArray] = {}
    fits = []
    for side in sides:
        free = simulated(own, side, horizon) if horizon else [own.simulate(record.u) for record in side]
        runs |= {record.name: run for record, run in zip(side, free, strict=True)}
        fits.append(np.array([fit(record.y, run) for record, run in zip(side, free, strict=True)]))
    return Candidate(name, own, why, fits[0], fits[1].reshape(-1, len(own.outputs)), runs)
