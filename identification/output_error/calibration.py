"""Output-error calibration of a system of FMUs, from a study file to estimates and their validation."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from fmus.errors import FmuError
from identification.built_system import BuiltSystem
from identification.estimation.arrow_least_squares import Loss
from identification.estimation.parameters import Parameter, ParameterSet
from identification.estimation.stopped import STOPPED, reason, stopped
from identification.fits import FitSummary, fit_summary
from identification.output_error.choice.choice import Choice
from identification.output_error.choice.otherwise import recorded_otherwise
from identification.output_error.chosen_windows import PickedWindows, chosen_length, picked_windows
from identification.output_error.free_runs.simulator import SystemFactory
from identification.output_error.free_runs.window import FreeRunWindow
from identification.output_error.search.estimate import Estimate
from identification.output_error.search.estimator import estimate, predict
from identification.output_error.search.options import SearchOptions, SearchState, Watch
from identification.output_error.search.problem import Problem
from identification.output_error.shooting.shooting import shoot
from identification.output_error.shooting.shots import Shots, cut
from identification.output_error.start_values import UnreadStart, resting_inputs, start_warnings
from identification.output_error.study import OutputErrorStudy, WindowSpec
from identification.output_error.study_checks import checked_parts
from identification.output_error.times.rates import rate_warnings
from identification.output_error.windows import counted, evenly_weighed, initial_states, length_warnings, weighed
from identification.recordings.campaign import StudyTrace, load_campaign, recorded_bytes, recording_warnings, split
from identification.recordings.clipping import clipping_warnings
from identification.results import GROUPS
from orchestrator.assembly.assembly import Assembled
from orchestrator.crossing import Crossing, noted
from orchestrator.fmi.isolation import Isolation
from orchestrator.processes.child import load_ahead
from orchestrator.processes.pool import processors
from orchestrator.progress import Progress, share_of, silent
from orchestrator.trace import FloatArray, ReadOnlyArrays, Trace

LOADED = 0.05  # of the whole when the traces are there, roughly
_SHORT = 3_000_000  # steps of components, which are done here sooner than other processes are ready
_LONG_READ = 1_000_000  # bytes of recordings, whose fit needs other processes as a rule
_ROUNDS = 30  # of runs that a search takes, roughly


@dataclass(frozen=True, eq=False)
class Judged(ReadOnlyArrays):
    """Free runs over some windows.

    Attributes:
        simulated: (K, m) a window.
        fit: (W, m) FIT of each window and output.
        outputs: component.variable of the m outputs.
    """

    outputs: tuple[str, ...]
    windows: tuple[FreeRunWindow, ...]
    simulated: tuple[FloatArray, ...]
    fit: FloatArray

    @property
    def median(self) -> float:
        """Median FIT over all windows and outputs; nan where none of them moves."""
        known = self.fit[~np.isnan(self.fit)]
        return float(np.median(known)) if known.size else math.nan

    def traces(self, index: int, units: Mapping[str, str]) -> tuple[Trace, Trace]:
        """Measured and simulated outputs of one window."""
        window, names = self.windows[index], self.outputs
        known = {name: units[name] for name in names if name in units}
        measured, simulated = (
            Trace(window.time, dict(zip(names, values.T, strict=True)), known, window.name)
            for values in (window.measured, self.simulated[index])
        )
        return measured, simulated

    @property
    def crossings(self) -> list[Crossing]:
        """How the windows' signals got to the units of the variables."""
        return [crossing for window in self.windows for crossing in window.crossings]

    @property
    def runs(self) -> list[tuple[str, FloatArray, FloatArray]]:
        """Name of the trace, time (K,) [s] and simulated outputs (K, m) of each window."""
        return [(window.trace, window.time, y) for window, y in zip(self.windows, self.simulated, strict=True)]

    @property
    def summary(self) -> FitSummary:
        """FIT in few figures."""
        names, traces = [window.name for window in self.windows], [window.trace for window in self.windows]
        return fit_summary(self.fit, names, traces, self.outputs)


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a study gave.

    Attributes:
        train, validation: free runs with the estimates; validation is None where no trace was kept aside.
        compared: name -> free runs with the parameters of the study's `compare`, on the validation windows (on the
            fitted ones where there are none).
        system: the FMUs as they were before.
        wired: how values pass through the connections.
        starts: sentences about windows that begin elsewhere than their free runs, and about inputs that rest.
        stopped: why there is less than was asked for; nothing where the calibration came to its end.
        choice: how it came to be chosen among candidates, where there were some.
        picked: how windows were chosen, where the recordings do.
    """

    study: OutputErrorStudy
    system: BuiltSystem
    recorded: tuple[StudyTrace, ...]
    estimate: Estimate
    train: Judged
    validation: Judged | None
    compared: Mapping[str, Judged]
    units: Mapping[str, str]
    wired: tuple[Crossing, ...]
    starts: tuple[str, ...] = ()
    stopped: str = ""
    choice: Choice | None = None
    picked: PickedWindows | None = None

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What a reader of the figures must know."""
        doubts = [str(crossing) for crossing in self.crossings if crossing.doubtful]
        said = [*(self.choice.doubts if self.choice else ()), *_of_groups(self)]
        step, asked, traces = self.study.run.step, self.study.validation, [one.trace for one in self.recorded]
        said += length_warnings(step, self._windows, traces, "windows")
        if isinstance(asked, WindowSpec) and asked != self._windows:
            said += length_warnings(step, asked, traces, "validation")
        said += rate_warnings(self.study.run, self.recorded, self.train.windows, self.estimate.late)
        signals = {name: spec.signal for name, spec in self.study.run.outputs.items()}
        said += clipping_warnings(signals, self.recorded, self.train.runs)
        return (*said, *doubts, *self.starts, *self.estimate.warnings, *recording_warnings(self.recorded))

    @property
    def _windows(self) -> WindowSpec:
        asked = self.study.windows
        if isinstance(asked, WindowSpec):
            return asked
        assert self.picked is not None
        return asked.of(self.picked.length.seconds)

    @property
    def crossings(self) -> tuple[Crossing, ...]:
        """Signals that were converted, or taken as they are although their units differ; connections alike."""
        sides = (self.train, self.validation) if self.validation else (self.train,)
        return noted([*self.wired, *(crossing for side in sides for crossing in side.crossings)])


def _of_groups(calibration: Calibration) -> Iterator[str]:
    """What is written of parameters that have several values, and which recordings have none of these."""
    study = calibration.study
    for one in study.grouped:
        first, *others = one.members
        if others:
            yield (
                f"{one.variable} has a value for each of {', '.join(one.members)}: FMUs and parameters.ssv have that "
                f"of {first}, and {GROUPS}/ has a parameter set for each to be laid over them"
            )
        judged = {window.trace for window in calibration.validation.windows} if calibration.validation else set()
        if alone := sorted(trace for trace in judged if one.own(trace) is None):
            yield f"{one.variable}: recordings in no group have the mean of all in the judgement: {', '.join(alone)}"


@dataclass(frozen=True, eq=False)
class PreparedStudy:
    """A study whose parts fit together, before anything is simulated.

    Attributes:
        train, unseen: windows to be fitted, and those of the traces kept aside.
        units: of the parameters, outputs and start values by name.
        wired: how values pass through the connections.
        unread: start values that nobody gives.
        picked: how windows were chosen, where the recordings do.
        shots: the windows to be fitted in segments, where the study asks for that.
    """

    study: OutputErrorStudy
    recorded: tuple[StudyTrace, ...]
    system: BuiltSystem
    train: tuple[FreeRunWindow, ...]
    unseen: tuple[FreeRunWindow, ...]
    units: Mapping[str, str]
    wired: tuple[Crossing, ...]
    unread: tuple[UnreadStart, ...]
    picked: PickedWindows | None = None
    shots: Shots | None = None

    @classmethod
    def of(cls, study: OutputErrorStudy, recorded: Sequence[StudyTrace]) -> PreparedStudy:
        """The study with its traces.

        Raises:
            InputError: the study, the system or the traces do not fit together.
        """
        fitted, kept = split(list(recorded), study.traces.hold_out)
        study = study.of_groups([trace.trace.name for trace in fitted], [trace.trace.name for trace in kept])
        system = BuiltSystem(study.system, sorted(study.run.inputs))
        units, ports, wired, unread, found = checked_parts(study, system.assembled)
        length = chosen_length(study, fitted)
        train, of_train = picked_windows(study.run, fitted, study.windows, length, ports)
        unseen, of_unseen = picked_windows(study.run, kept, study.validation, length, ports)
        picked = None if length is None else PickedWindows(length, {**of_train, **of_unseen})
        shots = cut(study, train, fitted, found, ports)
        return cls(
            study, tuple(recorded), system, tuple(train), tuple(unseen), units, wired, tuple(unread), picked, shots
        )

    def calibration(self, found: Estimate, why: str = "") -> Calibration:
        """What there is once something is estimated; `why` there is no more."""
        study = self.study
        judged = Judged(study.outputs, self.train, found.simulated, found.fit)
        fitted, _ = split(list(self.recorded), study.traces.hold_out)
        traces = [trace.trace for trace in fitted]
        starts = (*start_warnings(study, self.unread, traces, self.train), *resting_inputs(study, traces))
        return Calibration(
            study,
            self.system,
            self.recorded,
            found,
            judged,
            None,
            {},
            self.units,
            self.wired,
            starts,
            why,
            picked=self.picked,
        )

    def calibrated(self, progress: Progress = silent) -> Calibration:
        """The parameters fitted, and judged on the traces kept aside.

        Raises:
            FmuError: the FMUs fail with every start.
            EstimationInterrupted, EstimationFailed: stopped when there was an estimate, which it carries.
        """
        study, assembled, unseen = self.study, self.system.assembled, self.unseen
        try:
            found = _fit(self, _watch(study, progress))
        except STOPPED as stop:
            stop.result = self.calibration(stop.result, stop.result.message)
            raise
        try:
            validation = judge(study, assembled, unseen, found.values) if unseen else None
            compared = {
                name: judge(study, assembled, unseen or self.train, {**found.values, **study.spread(other)})
                for name, other in study.compare.items()
            }
        except (KeyboardInterrupt, FmuError) as error:
            raise stopped(error, self.calibration(found, f"not validated: {reason(error)}")) from error
        return replace(self.calibration(found), validation=validation, compared=compared)


def calibrate(
    study: OutputErrorStudy, data: Path | None = None, progress: Progress = silent, isolation: Isolation | None = None
) -> Calibration:
    """Fit the study's parameters to its traces and judge them on the traces kept aside.

    Args:
        data: the recordings, over the study's own.
        isolation: of simulations, over the study's own.

    Raises:
        InputError: the study, the system or the traces do not fit together; nothing has been simulated.
        FmuError: the FMUs fail with every start.
        EstimationInterrupted, EstimationFailed: stopped when there was an estimate, which it carries.
    """
    study = isolated(study, isolation)
    if processors() > 1 and recorded_bytes(study.traces, data) > _LONG_READ:
        load_ahead([SystemFactory.__module__])
    recorded = load_campaign(study.traces, data, share_of(progress, 0.0, LOADED), study.options.isolation)
    return PreparedStudy.of(study, recorded).calibrated(progress)


def isolated(study: OutputErrorStudy, isolation: Isolation | None) -> OutputErrorStudy:
    """The study with this isolation of simulations, where one is given."""
    return replace(study, options=replace(study.options, isolation=isolation)) if isolation else study


def _watch(study: OutputErrorStudy, progress: Progress) -> Watch:
    limit = study.options.max_evaluations

    def watch(at: SearchState) -> None:
        done = min(at.iteration / limit, 1)
        stages = {"segments": LOADED + 0.05 * done, "fit": 0.1 + 0.6 * done, "uncertainty": 0.7}
        stages |= dict.fromkeys(("profile", "bootstrap"), 0.7 + 0.15 * at.share)
        fraction = stages.get(at.stage, LOADED)
        progress(fraction, f"{at.stage} {at.iteration}, cost {at.cost:.4g}, {at.simulations} simulations")

    return watch


def _fit(prepared: PreparedStudy, watch: Watch) -> Estimate:
    study, assembled, windows = prepared.study, prepared.system.assembled, prepared.train
    declared = study.parameters
    parameters = tuple(replace(parameter, unit=prepared.units[parameter.name]) for parameter in declared.parameters)
    problem = _problem(study, weighed(study, windows), replace(declared, parameters=parameters), study.loss)
    options, factory = _options(study, assembled, problem, windows), _factory(study, assembled, windows)
    shot = None
    if (shots := prepared.shots) is not None:
        segments = replace(factory, windows=shots.windows, outputs=shots.recorded)
        shot = shoot(shots, problem, segments, options, watch)
    found = estimate(problem, factory, options, watch, shot)
    try:
        return replace(
            found, warnings=(*found.warnings, *recorded_otherwise(study.run, problem, factory, options, found))
        )
    except KeyboardInterrupt as error:
        raise stopped(error, replace(found, message=f"stopped: {reason(error)}")) from error


def _options(
    study: OutputErrorStudy, assembled: Assembled, problem: Problem, windows: Sequence[FreeRunWindow]
) -> SearchOptions:
    """The study's, with as many processes as are worth their start: one where our own models run for short.

    Others may crash or hang, and would take the command with them.
    """
    steps = len(assembled.files) * sum(window.count for window in windows)
    unknowns = len(problem.parameters.free) + len(problem.estimated)
    passes = study.options.starts * _ROUNDS * (1 + unknowns) if unknowns else 1
    trusted = len(assembled.built) == len(assembled.files) and study.options.intervals.by == "local"
    return replace(study.options, processes=1 if trusted and steps * passes < _SHORT else processors())


def _factory(study: OutputErrorStudy, assembled: Assembled, windows: Sequence[FreeRunWindow]) -> SystemFactory:
    timing = study.run.timing(max(window.stop for window in windows))
    return SystemFactory(assembled, windows, study.outputs, assembled.system.values(), timing)


def judge(
    study: OutputErrorStudy, assembled: Assembled, windows: Sequence[FreeRunWindow], values: Mapping[str, float]
) -> Judged:
    """Free runs over these windows, with these values over the study's; estimated initial states are fitted."""
    fixed = ParameterSet(tuple(Parameter(name, value, fixed=True) for name, value in values.items()))
    problem = _problem(study, evenly_weighed(windows), fixed, Loss())
    found = predict(problem, _factory(study, assembled, windows), _options(study, assembled, problem, windows))
    return Judged(study.outputs, tuple(windows), found.simulated, found.fit)


def _problem(
    study: OutputErrorStudy, windows: Sequence[FreeRunWindow], parameters: ParameterSet, loss: Loss
) -> Problem:
    states = initial_states(study.run, windows)
    return Problem(parameters, tuple(windows), study.outputs, states, loss, study.grouped, counted(windows))
