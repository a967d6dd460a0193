"""A calibration of several candidates: all fitted to the same windows alike, ranked, and the best one given back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fmus.errors import FmuError, IdentificationError, within
from identification.estimation.stopped import stopped
from identification.output_error.calibration import Calibration, Judged, PreparedStudy, isolated
from identification.output_error.choice.choice import Choice, FittedCandidate
from identification.output_error.choice.criteria import Misfit
from identification.output_error.choice.ranking import ranked
from identification.output_error.search.options import IntervalOptions
from identification.output_error.study import OutputErrorStudy
from identification.output_error.windows import counted, weighed
from identification.recordings.campaign import StudyTrace, TraceSource, load_campaign
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress, silent
from orchestrator.trace import FloatArray

_PREPARED = 0.05  # of the whole when all candidates are prepared, roughly


def choose(
    studies: Mapping[str, OutputErrorStudy],
    data: Path | None = None,
    progress: Progress = silent,
    isolation: Isolation | None = None,
) -> Calibration:
    """The calibration of the candidate that the recordings speak for, with how all came out.

    Args:
        studies: name -> the study that a candidate is; outputs of one signal are compared, in all.
        data: the recordings, over the studies' own.
        isolation: of simulations, over the studies' own.

    Raises:
        InputError: a candidate and the recordings do not fit together; nothing has been simulated.
        FmuError: all candidates fail.
        EstimationInterrupted: stopped; it carries the best of the candidates that were done.
        KeyboardInterrupt: stopped before one was.
    """
    prepared = _prepared({name: isolated(study, isolation) for name, study in studies.items()}, data, progress)
    tried = _Tried(prepared)
    for number, (name, one) in enumerate(prepared.items()):
        try:
            tried.add(name, one.calibrated(_share(progress, name, number, len(prepared))))
        except KeyboardInterrupt as error:
            if not tried.found:
                raise KeyboardInterrupt from error
            raise stopped(error, tried.best(f"interrupted before {name} was done")) from error
        except (FmuError, IdentificationError) as error:
            tried.failed[name] = str(error)
    if not tried.found:
        name, why = next(iter(tried.failed.items()))
        raise FmuError(f"candidates.{name}", f"fails as all others do: {why}", "mend one of them")
    return _with_intervals(tried.best(), studies, progress)


def _prepared(
    studies: Mapping[str, OutputErrorStudy], data: Path | None, progress: Progress
) -> dict[str, PreparedStudy]:
    """Each candidate with windows at the same instants."""
    runs = {name: study.run for name, study in studies.items()}
    made, loaded = dict[str, PreparedStudy](), list[tuple[TraceSource, Sequence[StudyTrace]]]()
    for number, (name, study) in enumerate(studies.items()):
        progress(_PREPARED * number / len(studies), name)
        beside = tuple(run for other, run in runs.items() if other != name)
        brief = replace(study.options, intervals=IntervalOptions())
        with within(f"candidates.{name}"):
            recorded = next((traces for source, traces in loaded if source == study.traces), None)
            if recorded is None:
                recorded = load_campaign(study.traces, data, isolation=study.options.isolation)
                loaded.append((study.traces, recorded))
            asked = replace(study, run=replace(study.run, beside=beside), options=brief)
            made[name] = PreparedStudy.of(asked, recorded)
    return made


def _share(progress: Progress, name: str, number: int, count: int) -> Progress:
    """The progress of one candidate as part of the whole."""
    return lambda done, doing: progress(_PREPARED + (1 - _PREPARED) * (number + done) / count, f"{name}: {doing}")


def _with_intervals(best: Calibration, studies: Mapping[str, OutputErrorStudy], progress: Progress) -> Calibration:
    """The chosen one, with the intervals that are asked for where these are more than the local ones."""
    assert best.choice is not None
    asked = studies[best.choice.chosen].options.intervals
    if asked.by == "local":
        return best
    study = replace(best.study, options=replace(best.study.options, intervals=asked))
    again = PreparedStudy.of(study, best.recorded).calibrated(progress)
    return replace(again, choice=best.choice)


@dataclass
class _Tried:
    """The candidates on their way.

    Attributes:
        found: those that are done.
        failed: name -> why.
    """

    prepared: Mapping[str, PreparedStudy]
    found: dict[str, Calibration] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)

    def add(self, name: str, calibration: Calibration) -> None:
        """One more, if it can be compared with the others."""
        first = next(iter(self.found.values()), calibration)
        for own, other in ((calibration.train, first.train), (calibration.validation, first.validation)):
            if own is not None and other is not None and _places(own) != _places(other):
                self.failed[name] = "its windows lie elsewhere than those of others; drive all by the same signals"
                return
        self.found[name] = calibration

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals that are an output of all."""
        measured = [[spec.signal for spec in one.study.run.outputs.values()] for one in self.prepared.values()]
        return tuple(signal for signal in measured[0] if all(signal in others for others in measured))

    def best(self, why: str = "") -> Calibration:
        """The chosen one of those that are done; `why` there are not more."""
        misfits = {name: _misfit(one, self._columns(one)) for name, one in self.found.items()}
        unseen = {
            name: _unseen(one.validation, self._columns(one))
            for name, one in self.found.items()
            if one.validation is not None
        }
        ranking = ranked(misfits, unseen)
        outcomes = {name: _outcome(self.found[name], misfits[name]) for name in ranking.rows}
        left = tuple(name for name in self.prepared if name not in self.found and name not in self.failed)
        choice = Choice(ranking, outcomes, dict(self.failed), self.signals, left)
        chosen = self.found[choice.chosen]
        return replace(chosen, choice=choice, stopped=why)

    def _columns(self, calibration: Calibration) -> list[int]:
        """Which of its outputs are compared."""
        measured = [spec.signal for spec in calibration.study.run.outputs.values()]
        return [measured.index(signal) for signal in self.signals]


def _places(judged: Judged) -> list[tuple[str, int]]:
    return [(window.name, len(window.measured)) for window in judged.windows]


def _misfit(calibration: Calibration, columns: Sequence[int]) -> Misfit:
    """What a candidate leaves over of the compared outputs, as its loss counts that."""
    found, study = calibration.estimate, calibration.study
    windows = weighed(study, calibration.train.windows)
    left = [window.weight * residual for window, residual in zip(windows, found.residuals, strict=True)]
    moved = [window.weight * (window.measured - window.measured.mean(axis=0)) for window in windows]
    misfits = [
        2
        * study.loss.cost([one[:, i] for one in left])
        / max(float(np.sum(_column(moved, i) ** 2)), np.finfo(float).tiny)
        for i in columns
    ]
    samples = np.array([len(_column(left, i)) for i in columns]) / counted(windows)
    unknowns = len(found.free) + len(found.initial_std) * len(windows)
    each = np.array([found.noise[i].samples_each for i in columns])
    return Misfit(np.array(misfits), samples, each, unknowns)


def _column(windows: Sequence[FloatArray], column: int) -> FloatArray:
    return np.concatenate([window[:, column] for window in windows])


def _unseen(judged: Judged, columns: Sequence[int]) -> FloatArray:
    """(W,) mean square of the prediction error over that of what was recorded, in each window held out."""
    moved = np.concatenate([window.measured for window in judged.windows])[:, columns].var(axis=0)
    errors = [
        np.mean((window.measured - simulated)[:, columns] ** 2, axis=0)
        for window, simulated in zip(judged.windows, judged.simulated, strict=True)
    ]
    return np.asarray(np.mean(np.array(errors) / np.where(moved > 0, moved, 1.0), axis=1))


def _outcome(calibration: Calibration, misfit: Misfit) -> FittedCandidate:
    found, unseen = calibration.estimate, calibration.validation
    return FittedCandidate(
        found.values,
        found.std,
        calibration.units,
        misfit.unknowns,
        calibration.train.median,
        None if unseen is None else unseen.median,
        "" if found.converged else found.message,
    )
