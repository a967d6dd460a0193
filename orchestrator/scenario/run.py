"""A scenario: a system, its stimuli, what is recorded, and what must hold, for one case or several."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from fmus.errors import ScenarioError, ServotwinError, WiringError
from orchestrator import formats
from orchestrator.assembly.assembly import Assembled, OpenSystem, RunBlock, SystemBlock, assemble
from orchestrator.engine import Interrupted, Result, Run, Simulation
from orchestrator.fmi.interface import Value
from orchestrator.fmi.isolation import Isolation, scratch
from orchestrator.formats import parquet
from orchestrator.interrupts import requested
from orchestrator.scenario.can_block import CanBlock
from orchestrator.scenario.expectations import Check, Expectation, check
from orchestrator.trace import FloatArray, Trace
from orchestrator.yaml_file import Block, load, naming

Progress = Callable[[float], None]


class StimulusBlock(Block):
    """What drives an input: a constant, or a signal of a trace file."""

    constant: float | None = None
    file: Path | None = None
    signal: str | None = None
    interpolation: Literal["linear", "hold"] = "linear"

    @model_validator(mode="after")
    def _one_kind(self) -> StimulusBlock:
        if (self.constant is None) == (self.file is None) or (self.file is None) != (self.signal is None):
            raise ValueError("give `constant`, or `file` and `signal`")
        return self

    def values(self, time: FloatArray, base: Path) -> FloatArray:
        """(K,) values at these times [s]."""
        if self.file is None:
            return np.full(len(time), self.constant)
        assert self.signal is not None
        trace = formats.read(base / self.file).trace.select([self.signal])
        return trace.resampled(time, hold=[self.signal] if self.interpolation == "hold" else [])[self.signal]


class RecorderBlock(Block):
    """A data logger that samples the run at irregular instants, as hardware does.

    Attributes:
        signals: name in the recording -> component.variable.
        every: mean time between samples [s].
        jitter: standard deviation of that time, as a fraction of it; 0 samples evenly.
        first: time from the start of the run to the first sample [s], `every` by default. Half of it reads what
            sampled components hold in the middle of their period.
    """

    signals: dict[str, str] = Field(min_length=1)
    every: float = Field(gt=0)
    jitter: float = Field(0.2, ge=0, lt=1)
    first: float | None = Field(None, ge=0)
    seed: int = 0

    def sample(self, trace: Trace, number: int) -> Trace:
        """What the logger holds of the run with this number: the last value before each of its instants."""
        rng = np.random.default_rng([self.seed, number])
        count = int(1.5 * trace.duration / self.every) + 1
        gaps = self.every * np.maximum(1 + self.jitter * rng.standard_normal(count), 0.01)
        later = self.every * np.arange(1, count + 1) if self.jitter == 0 else np.cumsum(gaps)
        instants = trace.time[0] + later + (0.0 if self.first is None else self.first - later[0])
        names = {source: name for name, source in self.signals.items()}
        chosen = trace.select(names)
        return chosen.resampled(instants[instants <= trace.time[-1]], hold=chosen.names).renamed(names)


class CaseBlock(Block):
    """A variant of the scenario: values that differ, and what must hold besides."""

    name: str
    set: dict[str, Value] = {}
    expect: list[Expectation] = []


class ScenarioBlock(SystemBlock):
    """A scenario file.

    Attributes:
        own_noise: whether every case draws noise of its own: each `seed` that a component is given, and the case does
            not set, grows by 1000 from case to case.
        can: how it is coupled to a CAN bus; a plain run takes the safe values, as if nobody else were there.
    """

    title: str
    description: str = ""
    stimuli: dict[str, StimulusBlock] = {}
    run: RunBlock
    record: list[str] | None = None
    recorder: RecorderBlock | None = None
    own_noise: bool = False
    can: CanBlock | None = None
    cases: list[CaseBlock] = Field(default_factory=lambda: [CaseBlock(name="run")], min_length=1)
    expect: list[Expectation] = []

    @model_validator(mode="after")
    def _distinct_cases(self) -> ScenarioBlock:
        names = [case.name for case in self.cases]
        if len(set(names)) != len(names):
            raise ValueError("two cases have one name")
        return self

    @model_validator(mode="after")
    def _one_source_each(self) -> ScenarioBlock:
        twice = sorted(set(self.stimuli) & set(self.can.receive if self.can else ()))
        if twice:
            raise ValueError(f"{twice[0]} has two sources, a stimulus and a signal of the bus")
        return self

    def driven(self) -> dict[str, StimulusBlock]:
        """component.input -> what drives it where there is no bus: its stimulus, or the safe value of its signal."""
        received = self.can.receive if self.can else {}
        return dict(self.stimuli) | {name: StimulusBlock(constant=each.safe) for name, each in received.items()}

    def values_of(self, case: CaseBlock) -> dict[str, Value]:
        """component.variable -> value in a case."""
        values = self.values()
        if self.own_noise:
            number = self.cases.index(case)
            seeds = {name: seed for name, seed in values.items() if name.endswith(".seed") and isinstance(seed, int)}
            values |= {name: seed + 1000 * number for name, seed in seeds.items()}
        return values | case.set


@dataclass(frozen=True)
class Keeping:
    """How much of the record is kept, and where.

    Attributes:
        every: communication steps from one row to the next.
        stream: folder of a Parquet file a case, written while it runs; None keeps the record in memory.
    """

    every: int = 1
    stream: Path | None = None

    def file(self, number: int) -> Path | None:
        """Where the record of the case with this number is written while it runs."""
        return None if self.stream is None else self.stream / f"{number}.parquet"


class State(StrEnum):
    """How far a case came; only one that is done is judged."""

    DONE = "done"
    INTERRUPTED = "interrupted"
    NOT_RUN = "not run"


@dataclass(frozen=True)
class CaseResult:
    """A case: its result, or the error that ended it, and how its expectations turned out.

    Attributes:
        file: where its record is; the result's trace then holds only what expectations look at.
    """

    name: str
    result: Result | None
    error: ServotwinError | None
    checks: tuple[Check, ...]
    file: Path | None = None
    state: State = State.DONE

    @property
    def passed(self) -> bool:
        """It is done, all expectations held, and no error came that none of them expected."""
        held = all(each.held for each in self.checks) and (self.error is None or bool(self.checks))
        return held and self.state is State.DONE


@dataclass(frozen=True)
class ScenarioResult:
    """A scenario that was run."""

    path: Path
    block: ScenarioBlock
    assembled: Assembled
    cases: tuple[CaseResult, ...]
    keeping: Keeping
    interrupted: bool = False

    @property
    def passed(self) -> bool:
        return all(case.passed for case in self.cases)

    def recorded(self, case: CaseResult) -> Trace:
        """What a case leaves as its recording: the recorder's samples, or else the whole trace."""
        assert case.result is not None
        if self.block.recorder is None:
            return case.result.trace
        return self.block.recorder.sample(case.result.trace, self.cases.index(case))


class ScenarioInterrupted(KeyboardInterrupt):
    """A scenario was interrupted; `result` has its cases, the one that ran with all up to there.

    From one process to another it travels as a plain KeyboardInterrupt.
    """

    def __init__(self, result: ScenarioResult) -> None:
        super().__init__("interrupted")
        self.result = result

    def __reduce__(self) -> tuple[type, tuple[str]]:
        return KeyboardInterrupt, (str(self),)


def run_scenario(
    path: Path,
    overrides: Mapping[str, Value] | None = None,
    progress: Progress | None = None,
    fmus: Path | None = None,
    keeping: Keeping | None = None,
    isolation: Isolation | None = None,
) -> ScenarioResult:
    """Run every case of a scenario file and judge it.

    Args:
        overrides: component.variable -> value, over those of the file.
        fmus: folder that keeps the FMUs that are built; a temporary one by default.
        isolation: how FMUs given as files are isolated, None where they are not.

    Raises:
        InputError: the file or the system does not fit; nothing has run.
        FmuError: an FMU failed in a case that does not expect to be refused.
        ScenarioInterrupted: a KeyboardInterrupt came when a case had begun to step.
    """
    block = load(path, ScenarioBlock)
    keeping = keeping or Keeping()
    if block.recorder is not None and keeping != Keeping():
        raise ScenarioError(path, "has a recorder, which samples the whole record", "run it without stride and stream")
    with naming(path), scratch(isolation) as folder:
        assembled = assemble(block, path.parent, fmus or folder, tuple(sorted(block.driven())))
        cases: list[CaseResult] = []
        try:
            with OpenSystem(assembled) as opened, opened.simulation(block.run.timing(), isolation) as simulation:
                instants = simulation.instants()
                stimuli = {name: each.values(instants, path.parent) for name, each in block.driven().items()}
                simulation.check_record(recorded_names(block, simulation.outputs))
                for number, case in enumerate(block.cases):
                    part = _part_of(progress, number, len(block.cases))
                    values = block.values_of(case) | dict(overrides or {})
                    cases.append(_run_case(block, case, simulation, values, stimuli, path.parent, keeping, part))
        except KeyboardInterrupt as stop:
            cases += _unfinished(block, len(cases), stop, keeping)
            if all(case.state is State.NOT_RUN for case in cases):
                raise
            raise ScenarioInterrupted(
                ScenarioResult(path, block, assembled, tuple(cases), keeping, interrupted=True)
            ) from None
        return ScenarioResult(path, block, assembled, tuple(cases), keeping)


def _unfinished(block: ScenarioBlock, done: int, stop: KeyboardInterrupt, keeping: Keeping) -> list[CaseResult]:
    """The cases that are not done: the one that was interrupted where one was, and those that have not begun."""
    cases = [CaseResult(case.name, None, None, (), state=State.NOT_RUN) for case in block.cases[done:]]
    if isinstance(stop, Interrupted) and stop.result.account.reached > stop.result.account.start:
        cases[0] = CaseResult(cases[0].name, stop.result, None, (), keeping.file(done), State.INTERRUPTED)
    return cases


def _run_case(
    block: ScenarioBlock,
    case: CaseBlock,
    simulation: Simulation,
    values: Mapping[str, Value],
    stimuli: Mapping[str, FloatArray],
    base: Path,
    keeping: Keeping,
    progress: Progress | None,
) -> CaseResult:
    expected = [*block.expect, *case.expect]
    refusal = any(each.refused is not None for each in expected)
    result, error = None, None
    file = keeping.file(block.cases.index(case))
    try:
        run = Run(values, stimuli, recorded_names(block, simulation.outputs), record_every=keeping.every)
        if file is None:
            result = simulation.execute(run, progress)
        else:
            result = _streamed(simulation, run, progress, file, expected)
    except ServotwinError as failure:
        if requested():  # an FMU's answer to an interrupt
            raise KeyboardInterrupt from failure
        if not refusal and len(block.cases) == 1:
            raise
        if not refusal:
            raise type(failure)(f"case {case.name}: {failure.place}", failure.problem, failure.fix) from failure
        error = failure
    trace = result.trace if result is not None else None
    return CaseResult(case.name, result, error, tuple(check(each, trace, error, base) for each in expected), file)


def _streamed(
    simulation: Simulation, run: Run, progress: Progress | None, file: Path, expected: Iterable[Expectation]
) -> Result:
    """The result of a run whose record goes to a file; its trace has what the expectations look at."""
    with parquet.appending(file) as append:
        result = simulation.execute(run, progress, append)
    signals = {each.signal: each.signal for each in expected if each.signal is not None}
    if not signals:
        return result
    return replace(result, trace=formats.read(file, formats.Layout(columns=signals)).trace)


def recorded_names(block: ScenarioBlock, outputs: tuple[str, ...]) -> list[str]:
    """The file's `record`, or all outputs; and whatever the recorder or an expectation of any case looks at."""
    expected = [*block.expect, *(each for case in block.cases for each in case.expect)]
    looked_at = [each.signal for each in expected if each.signal is not None]
    if block.recorder is not None:
        looked_at += block.recorder.signals.values()
    return list(dict.fromkeys([*(outputs if block.record is None else block.record), *looked_at]))


def _part_of(progress: Progress | None, number: int, count: int) -> Progress | None:
    if progress is None:
        return None
    return lambda fraction: progress((number + fraction) / count)


def parse_override(text: str) -> tuple[str, Value]:
    """`component.variable=value` as name and value: a number, true or false, or text.

    Raises:
        WiringError: there is no `=`.
    """
    name, equals, value = text.partition("=")
    if not equals:
        raise WiringError(f"--set {text}", "has no value", "write component.variable=value")
    if value.strip().lower() in ("true", "false"):
        return name.strip(), value.strip().lower() == "true"
    for kind in (int, float):
        try:
            return name.strip(), kind(value)
        except ValueError:
            continue
    return name.strip(), value.strip()
