"""A scenario run: each case stepped and judged."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property, partial
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from fmus.errors import FmuError, PartialError, ScenarioError, ServotwinError, WiringError
from fmus.files import sha256
from orchestrator import formats, last_words
from orchestrator.assembly.assembly import Assembled, OpenSystem, assemble
from orchestrator.assembly.whole_arrays import check_shapes, elements, shapes, written
from orchestrator.crossing import Crossing, logged
from orchestrator.display.table import table
from orchestrator.engine import Interrupted, Profile, Result, Run, RunFailed, Simulation, Sink
from orchestrator.fmi.interface import Value, Written
from orchestrator.fmi.isolation import Isolation, scratch
from orchestrator.fmi.said import kept
from orchestrator.formats import parquet
from orchestrator.interrupts import requested
from orchestrator.progress import Progress, silent
from orchestrator.scenario.draws import drawn
from orchestrator.scenario.expectations import Check, DrawnTraces, Expected, Ran
from orchestrator.scenario.scenario import Case, Scenario
from orchestrator.scenario.schema import load_scenario
from orchestrator.scenario.units import in_units_of
from orchestrator.system import System, recordable, typed
from orchestrator.trace import FloatArray, Trace
from orchestrator.yaml_file import naming

Execute = Callable[[Simulation, Run, Sink | None], Result]


@dataclass(frozen=True)
class Keeping:
    """How much of the record is kept, and where.

    Attributes:
        every: communication steps from one row to the next.
        stream: folder of a Parquet file a case, written while it runs; None keeps the record in memory.
        log: file that takes all that FMUs say.
        profile: what takes note of every step.
        execute: what runs a simulation instead of itself, at a pace of its own.
        first: number of the case among all of the scenario that is the first here.
    """

    every: int = 1
    stream: Path | None = None
    log: Path | None = None
    profile: Profile | None = None
    execute: Execute | None = None
    first: int = 0

    def run(
        self, simulation: Simulation, run: Run, progress: Callable[[float], None], sink: Sink | None = None
    ) -> Result:
        """The result of a run of the simulation."""
        if self.execute is None:
            return simulation.execute(run, progress, sink)
        return self.execute(simulation, run, sink)

    def span(self, name: str) -> AbstractContextManager[None]:
        """What has a block noted, where anything is."""
        return nullcontext() if self.profile is None else self.profile.span(name)

    def file(self, number: int) -> Path | None:
        """Where the record of the case with this number is written while it runs."""
        return None if self.stream is None else self.stream / f"{self.first + number}.parquet"


LOG = logging.getLogger("servotwin.scenario")
HEADERS = ("case", "expectation", "held", "found")


class CaseState(StrEnum):
    """How far a case came; only one that is done is judged."""

    DONE = "done"
    INTERRUPTED = "interrupted"
    FAILED = "failed"
    NOT_RUN = "not run"


@dataclass(frozen=True)
class CaseResult:
    """A case: its result, or the error that ended it, and how its expectations turned out.

    Attributes:
        file: where its record is; the result's trace then holds only what expectations look at.
        seconds: wall time of its run and of its judgement [s].
        processor: processor time that this process took to run it [s].
        draws: like runs with other noise that its expectations have asked for.
    """

    name: str
    result: Result | None
    error: ServotwinError | None
    checks: tuple[Check, ...]
    file: Path | None = None
    state: CaseState = CaseState.DONE
    seconds: float = 0.0
    processor: float = 0.0
    draws: DrawnTraces = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """It is done, all expectations held, and no error came that none of them expected."""
        held = not any(check.failed for check in self.checks) and (self.error is None or bool(self.checks))
        return held and self.state is CaseState.DONE

    @property
    def trace(self) -> Trace:
        """What was recorded.

        Raises:
            ServotwinError: the case ended in this error, or did not run.
        """
        if self.result is None:
            raise self.error or ScenarioError(f"case {self.name}", "did not run", "run the scenario again")
        return self.result.trace

    @property
    def how_far(self) -> str:
        """How far it came, in words."""
        if self.state is not CaseState.DONE:
            return str(self.state) if self.result is None else f"{self.state} at t = {self.result.account.reached:g} s"
        return self.ended or "ran through"

    @property
    def ended(self) -> str:
        """What an FMU said that asked to stop before the case was over."""
        return "" if self.result is None else self.result.ended


@dataclass(frozen=True)
class ScenarioResult:
    """A scenario that was run.

    Attributes:
        scenario: in the units of its system.
        crossings: values that were converted, or taken as they are although their units differ.
        overrides: component.variable -> value, over those of the file.
        system: what ran, None where it was not opened.
        hashes: component -> SHA-256 of its FMU.
    """

    scenario: Scenario
    assembled: Assembled
    cases: tuple[CaseResult, ...]
    keeping: Keeping
    interrupted: bool = False
    crossings: tuple[Crossing, ...] = ()
    overrides: Mapping[str, Value] = field(default_factory=dict)
    system: System | None = None
    hashes: Mapping[str, str] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        return all(case.passed for case in self.cases)

    @cached_property
    def recordings(self) -> list[tuple[str, str, str]]:
        """What a recording was read for, its file as seen from the scenario, and its SHA-256."""
        folder = self.scenario.path.parent
        return [
            (what, Path(os.path.relpath(file, folder)).as_posix(), sha256(file))
            for what, files in self.scenario.recordings.items()
            for file in files
        ]

    def rows(self) -> list[tuple[str, str, str, str]]:
        """A row under `HEADERS` of every check; a case without expectations has a row too."""
        rows = []
        for case in self.cases:
            rows += [(case.name, check.text, _word(check), check.found) for check in case.checks]
            if not case.checks:
                rows.append((case.name, "-", "-", case.how_far))
        return rows

    def _repr_html_(self) -> str:
        return table(HEADERS, self.rows(), caption=self.scenario.title)

    def recorded(self, case: CaseResult) -> Trace:
        """What a case leaves as its recording: the recorder's samples, or else the whole trace."""
        logger = self.scenario.logger
        return case.trace if logger is None else logger.sample(case.trace, self.cases.index(case))


class ScenarioInterrupted(KeyboardInterrupt):
    """A scenario was interrupted; `result` has its cases, the one that ran with all up to there.

    From one process to another it travels as a plain KeyboardInterrupt.
    """

    def __init__(self, result: ScenarioResult) -> None:
        super().__init__("interrupted")
        self.result = result

    def __reduce__(self) -> tuple[type, tuple[str]]:
        return KeyboardInterrupt, (str(self),)


class ScenarioFailed(PartialError):  # noqa: N818 - as what interrupts it
    """An FMU failed in a case that does not expect it; `result` has the cases before it, and all up to there."""

    result: ScenarioResult


def run_scenario(
    scenario: Scenario | str | Path,
    overrides: Mapping[str, Value | list[Any]] | None = None,
    progress: Progress = silent,
    fmus: Path | None = None,
    keeping: Keeping | None = None,
    isolation: Isolation | None = None,
    going_on: bool = False,
) -> ScenarioResult:
    """Run every case of a scenario, or of a scenario file, and judge it.

    Args:
        overrides: component.variable -> value, or component.array -> nested lists, over those of the file.
        fmus: folder that keeps the FMUs that are built; a temporary one by default.
        isolation: how FMUs given as files are isolated, None where they are not.
        going_on: whether a case in which an FMU fails, though none expects it, is one failed case, and others follow.

    Raises:
        InputError: the file or the system does not fit; nothing has run.
        ScenarioFailed: an FMU failed in a case that does not expect to be refused, when something had been stepped.
        FmuError: it failed before that.
        ScenarioInterrupted: a KeyboardInterrupt came when a case had begun to step.
    """
    whole = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    done: list[ScenarioResult] = []
    for group in whole.by_system():
        first = sum(len(result.cases) for result in done)
        told = _share_of(progress, first, len(group.cases), len(whole.cases))
        kept_there = replace(keeping or Keeping(), first=first)
        try:
            done.append(_run(group, overrides or {}, told, fmus, kept_there, isolation, going_on))
        except (ScenarioInterrupted, ScenarioFailed) as end:
            end.result = _joined(whole, [*done, end.result])
            raise
        except KeyboardInterrupt:
            if not done:
                raise
            raise ScenarioInterrupted(replace(_joined(whole, done), interrupted=True)) from None
        except FmuError as error:
            if not done:
                raise
            raise ScenarioFailed(error, _joined(whole, done)) from error
    return _joined(whole, done)


def _joined(scenario: Scenario, parts: Sequence[ScenarioResult]) -> ScenarioResult:
    """The result of a scenario from those of its cases with one system each; what follows them has not run."""
    first, made = parts[0], [case for part in parts for case in part.cases]
    rest = scenario.cases[len(made) :]
    cases = [*made, *(CaseResult(case.name, None, None, (), state=CaseState.NOT_RUN) for case in rest)]
    converted = (*(case for part in parts for case in part.scenario.cases), *rest)
    files, built, hashes = dict(first.assembled.files), set(first.assembled.built), dict(first.hashes)
    components = dict(first.scenario.system.components)
    for part in parts[1:]:
        for name, digest in part.hashes.items():
            known = name if hashes.get(name, digest) == digest else f"{name} of {part.cases[0].name}"
            files[known], hashes[known] = part.assembled.files[name], digest
            components[known] = part.scenario.system.components[name]
            built |= {known} if name in part.assembled.built else set()
    return replace(
        first,
        scenario=replace(first.scenario, cases=converted, system=replace(first.scenario.system, components=components)),
        assembled=replace(first.assembled, files=files, built=frozenset(built)),
        cases=tuple(cases),
        keeping=replace(first.keeping, first=0),
        interrupted=any(part.interrupted for part in parts),
        crossings=tuple(dict.fromkeys(crossing for part in parts for crossing in part.crossings)),
        hashes=hashes,
    )


def _share_of(progress: Progress, first: int, count: int, total: int) -> Progress:
    return lambda fraction, doing: progress((first + fraction * count) / total, doing)


def _run(
    scenario: Scenario,
    overrides: Mapping[str, Value | list[Any]],
    progress: Progress,
    fmus: Path | None,
    keeping: Keeping,
    isolation: Isolation | None,
    going_on: bool,
) -> ScenarioResult:
    if scenario.logger is not None and (keeping.every, keeping.stream) != (1, None):
        raise ScenarioError(
            scenario.path, "has a recorder, which samples the whole record", "run it without stride and stream"
        )
    with naming(scenario.path), kept(keeping.log), scratch(isolation) as folder:
        given = elements(overrides)
        with keeping.span("build FMUs"):
            assembled = assemble(scenario.system.given(given), fmus or folder, scenario.driven)
        result = ScenarioResult(scenario, assembled, (), keeping, overrides=given)
        cases: list[CaseResult] = []
        try:
            with (
                OpenSystem(assembled) as opened,
                opened.simulation(scenario.timing, isolation, keeping.profile) as simulation,
            ):
                result = _prepared(result, opened.system, simulation, shapes(overrides))
                for case in _run_cases(result, simulation, progress):
                    cases.append(case)
                    if not going_on:
                        _go_on(replace(result, cases=tuple(cases)))
        except KeyboardInterrupt as stop:
            cases += _unfinished(scenario, len(cases), stop, keeping)
            if all(case.state is CaseState.NOT_RUN for case in cases):
                raise
            raise ScenarioInterrupted(replace(result, cases=tuple(cases), interrupted=True)) from None
        return replace(result, cases=tuple(cases))


def _prepared(
    result: ScenarioResult, system: System, simulation: Simulation, arrays: Mapping[str, tuple[int, ...]]
) -> ScenarioResult:
    """The result before its first case, of a scenario that fits its system and is in its units.

    Args:
        arrays: shapes of those that are overridden.
    """
    check_shapes(system, arrays)
    given = typed(system, result.overrides)
    scenario, crossed = in_units_of(system, result.scenario)
    crossings = logged([*system.crossings, *crossed])
    recorded = scenario.recorded(simulation.outputs)
    simulation.check_record(recorded)
    for name in () if scenario.logger is None else scenario.logger.signals.values():
        recordable(system, name, f"recorder: {name}")
    for case in scenario.cases:
        check_shapes(system, case.arrays)
    _check_values(scenario, simulation, given)
    if not recorded:
        LOG.warning("nothing is recorded, for there are no outputs; name other variables in `record`")
    if scenario.record is None and simulation.texts:
        LOG.warning("texts are recorded where `record` names them, not by themselves: %s", ", ".join(simulation.texts))
    hashes = hashes_of(result.assembled)
    return replace(result, scenario=scenario, crossings=crossings, overrides=given, system=system, hashes=hashes)


def _run_cases(begun: ScenarioResult, simulation: Simulation, progress: Progress) -> Iterator[CaseResult]:
    """Each case, run and judged."""
    scenario, keeping = begun.scenario, begun.keeping
    stimuli = _stimuli(scenario, simulation)
    for number, case in enumerate(scenario.cases):
        values = {**case.values, **begun.overrides}
        told = _part_of(progress, number, len(scenario.cases), case.name)
        start = perf_counter()
        at_case = last_words.own().working_on(keeping.first + number)
        with at_case, keeping.span(f"case {case.name}"):
            made = _run_case(scenario, number, simulation, values, stimuli, keeping, told)
        yield replace(made, seconds=perf_counter() - start)


def hashes_of(assembled: Assembled) -> dict[str, str]:
    """Component -> SHA-256 of its FMU."""
    return {name: sha256(file) for name, file in assembled.files.items()}


def _check_values(scenario: Scenario, simulation: Simulation, overrides: Mapping[str, Value]) -> None:
    """See that values and references of all cases fit, but the values of those that expect to be refused."""
    instants = simulation.instants() if any(case.looked_at for case in scenario.cases) else np.zeros(0)
    for case in scenario.cases:
        for expected in case.expected:
            expected.check_covered(instants)
        if not case.may_be_refused:
            with _named(scenario, case):
                simulation.check_values({**case.values, **overrides})


def _go_on(result: ScenarioResult) -> None:
    """See that the latest case did not fail."""
    cases = result.cases
    last = cases[-1]
    if last.state is not CaseState.FAILED:
        return
    assert isinstance(last.error, FmuError)
    if all(case.result is None for case in cases):
        raise last.error
    left = result.scenario.cases[len(cases) :]
    rest = [CaseResult(case.name, None, None, (), state=CaseState.NOT_RUN) for case in left]
    raise ScenarioFailed(last.error, replace(result, cases=(*cases, *rest))) from last.error


def _stimuli(scenario: Scenario, simulation: Simulation) -> dict[str, FloatArray]:
    instants = simulation.instants() if scenario.stimuli else np.zeros(0)
    return {name: stimulus.values(instants, name) for name, stimulus in scenario.stimuli.items()}


def _unfinished(scenario: Scenario, done: int, stop: KeyboardInterrupt, keeping: Keeping) -> list[CaseResult]:
    """The cases that are not done: the one that was interrupted where one was, and those that have not begun."""
    cases = [CaseResult(case.name, None, None, (), state=CaseState.NOT_RUN) for case in scenario.cases[done:]]
    if isinstance(stop, Interrupted) and stop.result.account.reached > stop.result.account.start:
        cases[0] = CaseResult(cases[0].name, stop.result, None, (), keeping.file(done), CaseState.INTERRUPTED)
    return cases


def _run_case(
    scenario: Scenario,
    number: int,
    simulation: Simulation,
    values: Mapping[str, Value],
    stimuli: Mapping[str, FloatArray],
    keeping: Keeping,
    progress: Callable[[float], None],
) -> CaseResult:
    case, file = scenario.cases[number], keeping.file(number)
    result, error, state = None, None, CaseState.DONE
    begun, spent, draws = process_time(), 0.0, {}
    try:
        run = Run(values, stimuli, scenario.recorded(simulation.outputs), record_every=keeping.every)
        if file is None:
            result = keeping.run(simulation, run, progress)
        else:
            result = _streamed(partial(keeping.run, simulation, run, progress), file, case.looked_at)
        spent = process_time() - begun
        draws = drawn(simulation, run, case)
    except ServotwinError as failure:
        if requested():  # an FMU's answer to an interrupt
            raise KeyboardInterrupt from failure
        error = failure
        if isinstance(failure, RunFailed):
            result, error = failure.result, FmuError(failure.place, failure.problem, failure.fix)
        if not case.may_be_refused:
            error = _of_case(scenario, case, error)
            if not isinstance(error, FmuError):
                raise error from failure
            state = CaseState.FAILED
    trace = result.trace if result is not None and error is None else None
    ran = Ran(trace, error, result, spent, case.name, draws=draws)
    checks = tuple(_checked(expected, ran) for expected in case.expected)
    made = CaseResult(case.name, result, error, checks, file, state, processor=spent, draws=draws)
    for check in checks:
        if check.doubt:
            LOG.warning("case %s: %s: %s", case.name, check.text, check.doubt)
    for name, count in nonfinite(trace).items() if trace is not None else ():
        LOG.warning("case %s: %d samples of %s are not finite", case.name, count, name)
    if made.ended:
        LOG.warning("case %s: %s; the run ends there and is judged by what there is", case.name, made.ended)
    return made


def nonfinite(trace: Trace) -> dict[str, int]:
    """signal -> how many of its samples are NaN or infinite, where some are."""
    counts = {name: int(np.count_nonzero(~np.isfinite(trace[name]))) for name in trace.names}
    return {name: count for name, count in counts.items() if count}


def _checked(expected: Expected, ran: Ran) -> Check:
    """How an expectation turned out; one about times that a run which an FMU ended has not reached does not hold."""
    try:
        return expected.check(ran)
    except ScenarioError:
        if ran.result is None or not ran.result.ended:
            raise
        return Check(str(expected), False, ran.result.ended)


def _word(check: Check) -> str:
    """Whether it held, in a word."""
    return "yes" if check.held else "NO" if check.needed else "no, but only a warning"


def _of_case(scenario: Scenario, case: Case, failure: ServotwinError) -> ServotwinError:
    """The error with the name of its case, where there are several."""
    return failure if len(scenario.cases) == 1 else failure.within(f"case {case.name}")


@contextmanager
def _named(scenario: Scenario, case: Case) -> Iterator[None]:
    try:
        yield
    except ServotwinError as failure:
        raise _of_case(scenario, case, failure) from failure


def _streamed(execute: Callable[[Sink], Result], file: Path, looked_at: Iterable[str]) -> Result:
    """The result of a run whose record goes to a file; its trace has what the expectations look at."""
    with parquet.appending(file) as append:
        result = execute(append)
    signals = {signal: signal for signal in looked_at}
    if not signals:
        return result
    return replace(result, trace=formats.read(file, formats.Layout(columns=signals, texts=True)).trace)


def _part_of(progress: Progress, number: int, count: int, name: str) -> Callable[[float], None]:
    return lambda fraction: progress((number + fraction) / count, name)


def parse_override(text: str) -> tuple[str, Value | list[Any]]:
    """`component.variable=value` as name and value as it is written, or nested lists of these: `c.A=[[1, 2], [3, 4]]`.

    Raises:
        WiringError: there is no `=`, or the lists are none.
    """
    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals:
        raise WiringError(f"--set {text}", "has no value", "write component.variable=value")
    if not (value.startswith("[") and value.endswith("]")):
        return name, Written(value)
    try:
        return name, written(name, value)
    except ValueError as error:
        raise WiringError(f"--set {name}", str(error), "write component.array=[[1, 2], [3, 4]]") from None
