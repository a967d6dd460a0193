"""A linear model of a study's traces: by each weighting it names, refined and reduced where it asks for that."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.stopped import stopped
from identification.linear.mode_tracking import spreads
from identification.linear.modes import kept, modes
from identification.linear.preparation import Offsets, Preparation, offsets_of, prepared, without_compensation
from identification.linear.records import InputOutputData, check_rate
from identification.linear.reduction import Reduction, reduced, together, updated
from identification.recordings.campaign import StudyTrace, load_campaign, split
from identification.recordings.marks import nothing_left, sound
from identification.recordings.units import in_common_units
from identification.subspace.refinement.prediction_error import Refined, refine, uncertainty
from identification.subspace.schema import ReductionBlock, SubspaceBlock
from identification.subspace.spread import changes
from identification.subspace.trials import ModelCandidate, Sides, SubspaceTrial, Trying
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress, share_of

_ATTEMPTS = 3  # of the best models that are tried to be refined, one after the other


@dataclass(frozen=True, eq=False)
class SubspaceCalibration:
    """What a study gave.

    Attributes:
        records: name -> the record that models are judged on: offsets and compensation taken off, nothing filtered.
        pieces: name of each of these -> trace that it is cut from, between its marks.
        dropped: samples in pieces that were too short.
        trials: every way that was tried; the best of each weighting is a candidate.
        refined: what the refinement gave, where it was asked for and could be had.
        offsets: where inputs and outputs have their zero; None where records begin at rest.
        failures: sentences about what was asked for and could not be had.
        stopped: why there is less than was asked for; nothing where the calibration came to its end.
    """

    study: SubspaceBlock
    recorded: tuple[StudyTrace, ...]
    records: dict[str, InputOutputData]
    candidates: dict[str, ModelCandidate]
    trials: tuple[SubspaceTrial, ...]
    refined: Refined | None
    pieces: dict[str, str]
    dropped: int
    offsets: Offsets | None = None
    failures: tuple[str, ...] = ()
    reduction: Reduction | None = None
    stopped: str = ""

    @property
    def taken(self) -> ModelCandidate:
        """The one that is written: that of `take`, the reduced one where there is one, else that of the best free run.

        Of equally good ones it is the first.
        """
        wanted = self.study.take or ("reduced" if self.study.reduce else None)
        if wanted in self.candidates:
            return self.candidates[wanted]
        return max(self.candidates.values(), key=lambda candidate: candidate.score)

    @property
    def zero(self) -> Offsets | None:
        """What the written model counts from; None where records begin at rest."""
        known = self.offsets
        return None if known is None else Offsets(known.u, known.y + self.taken.offset)

    @property
    def best(self) -> SubspaceTrial:
        """The trial with the best free run."""
        return max(self.trials, key=lambda trial: trial.score)


def calibrate(
    study: SubspaceBlock, base: Path, data: Path | None, progress: Progress, isolation: Isolation | None = None
) -> SubspaceCalibration:
    """Identify in every way that is left open, refine the best, reduce, and judge on the traces kept aside.

    Args:
        base: folder of the study file.
        data: the recordings, over the study's own.
        isolation: of FMUs whose runs are the recordings.

    Raises:
        InputError: the study and the traces do not fit together, or the data bear no model at all.
        EstimationInterrupted: interrupted when there was a model, which it carries.
    """
    source = study.source(base)
    recorded = load_campaign(source, data, share_of(progress, 0.0, 0.3), isolation)
    recorded = in_common_units(recorded, [*study.inputs, *study.outputs])
    cut = _cut(study, recorded)
    trials = list[SubspaceTrial]()
    found = SubspaceCalibration(
        cut.study, tuple(recorded), cut.judged, {}, (), None, cut.origin, cut.dropped, cut.offsets
    )
    try:
        for number, weighting in enumerate(study.weightings):
            for trial in cut.trying.by(cut.study.ways(weighting, cut.samples)):
                trials.append(trial)
                progress(0.3 + 0.4 * number / len(study.weightings), f"{weighting}, {len(trials)} ways tried")
        found = replace(found, trials=tuple(trials), candidates=_best_of_each(trials))
        found = _refined(found, cut, progress) if study.refine else found
        return _reduced(found, cut, study.reduce) if study.reduce is not None else found
    except KeyboardInterrupt as error:
        if not any(trial.candidate for trial in trials):
            raise
        found = found if found.trials else replace(found, trials=tuple(trials), candidates=_best_of_each(trials))
        raise stopped(error, replace(found, stopped="interrupted")) from error


@dataclass(frozen=True, eq=False)
class _Cut:
    """Traces cut for identification and for judging; see `SubspaceCalibration`."""

    study: SubspaceBlock
    judged: dict[str, InputOutputData]
    origin: dict[str, str]
    dropped: int
    offsets: Offsets | None
    trying: Trying

    @property
    def samples(self) -> int:
        """Samples of the fitted records together."""
        return sum(map(len, self.trying.ready.records))


def _cut(study: SubspaceBlock, recorded: list[StudyTrace]) -> _Cut:
    fitted, aside = split(recorded, study.traces.held_out)
    given = records(study, recorded)
    if any(np.isnan(record.u).any() for record in given.values()):
        study = study.model_copy(update={"initial_states": True})  # nothing rests where a piece begins
    first = [given[known.trace.name] for known in fitted]
    offsets = offsets_of(first) if study.initial_states else None
    how = study.preparation.preparation(scaled=study.preparation.scaled, offsets=offsets)
    cut = pieces(study, given, offsets)
    judged = {piece.name: piece for trace, piece in cut if len(piece) >= study.shortest or piece.name == trace}
    origin = {piece.name: trace for trace, piece in cut if piece.name in judged}
    sides = [tuple(judged[name] for name in _of(side, origin, study)) for side in (fitted, aside)]
    ready = prepared(first, how)
    ready = replace(ready, records=tuple(record for record in ready.records if record.name in judged))
    dropped = sum(len(piece) for _, piece in cut if piece.name not in judged)
    trying = Trying(
        ready,
        Sides(sides[0], sides[1], study.start, not study.initial_states),
        study.rule,
        study.compared_poles,
        study.compared_feedthrough,
    )
    return _Cut(study, judged, origin, dropped, offsets, trying)


def _best_of_each(trials: Sequence[SubspaceTrial]) -> dict[str, ModelCandidate]:
    """Weighting -> its best candidate.

    Raises:
        IdentificationError: no way gave a model; the first says why.
    """
    best: dict[str, ModelCandidate] = {}
    for trial in trials:
        known = trial.candidate
        if known is not None and (known.name not in best or known.score > best[known.name].score):
            best[known.name] = known
    if not best:
        raise trials[0].error or IdentificationError("model", "none could be had", "use other records")
    return best


def _refined(found: SubspaceCalibration, cut: _Cut, progress: Progress) -> SubspaceCalibration:
    """With the best trial refined, or the next best where it cannot be."""
    failures = list[str]()
    known = [trial for trial in found.trials if trial.result is not None]
    for trial in sorted(known, key=lambda trial: -trial.score)[:_ATTEMPTS]:
        assert trial.result is not None
        start = trial.result
        settings = cut.study.refinement(trial.settings, stable=start.model.stable)
        try:
            refined = refine(
                start.model,
                cut.trying.ready.records,
                settings,
                start.gain,
                lambda share, cost: progress(0.7 + 0.25 * share, f"refining, error {cost:.4g}"),
            )
            directions, covariance = refined.directions, uncertainty(refined).matrix
            spread = spreads(refined.model, directions.a, covariance)
        except (IdentificationError, np.linalg.LinAlgError) as error:
            failures.append(f"the model by {trial.settings.weighting} could not be refined: {error}")
            continue
        judged = cut.trying.sides.judged("refined", start.why, cut.trying.ready.unscaled(refined.model))
        moved = tuple(cut.trying.ready.unscaled(one) for one in changes(refined.model, directions, covariance))
        candidates = {**found.candidates, "refined": replace(judged, spreads=tuple(spread), changes=moved)}
        found = replace(found, candidates=candidates, refined=refined, failures=tuple(failures))
        if refined.interrupted:
            raise stopped(KeyboardInterrupt(), replace(found, stopped="interrupted while it was refined"))
        return found
    return replace(found, failures=tuple(failures))


def _reduced(found: SubspaceCalibration, cut: _Cut, how: ReductionBlock) -> SubspaceCalibration:
    """With the best model reduced; its scaled records are those that it is updated by."""
    trying, first = cut.trying, found.best.result
    assert first is not None
    refined = found.refined is not None and found.candidates["refined"].score >= found.best.score
    model = found.refined.model if refined and found.refined is not None else first.model
    u = np.concatenate([record.u for record in trying.ready.records])
    numbers = kept(how.by, modes(model), u, how.order, how.flexible)
    best = updated(reduced(model, numbers), trying.ready.records, how.update)
    why = f"{best.order} states by {how.by.upper()}"
    judged = trying.sides.judged("reduced", why, trying.ready.unscaled(best))
    return replace(found, candidates={**found.candidates, "reduced": judged}, reduction=together(model, numbers, u))


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


def records(study: SubspaceBlock, recorded: Sequence[StudyTrace]) -> dict[str, InputOutputData]:
    """Trace -> its record at the study's samples, with gaps where it is marked.

    Raises:
        IdentificationError: they are sampled at different rates.
    """
    found = {known.trace.name: _record(study, known) for known in recorded}
    for first in list(found.values())[:1]:
        check_rate(list(found.values()), first.step, first.name)
    return found


def pieces(
    study: SubspaceBlock, given: Mapping[str, InputOutputData], offsets: Offsets | None
) -> list[tuple[str, InputOutputData]]:
    """What models are judged on, each with its trace: records between gaps, without offsets, not filtered."""
    plain = Preparation(study.preparation.zero_mean, scaled=False, offsets=offsets)
    there = {trace: record for trace, record in given.items() if np.isfinite(record.u).any()}
    return [(trace, piece) for trace, record in there.items() for piece in prepared([record], plain).records]


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
