"""A scenario: a system, its stimuli, what is recorded, and what must hold, for one case or several."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from fmus.errors import ServotwinError, WiringError
from orchestrator import formats
from orchestrator.assembly import Assembled, OpenSystem, RunBlock, SystemBlock, assemble
from orchestrator.engine import Result, Simulation
from orchestrator.expectations import Check, Expectation, check
from orchestrator.slave import Value
from orchestrator.trace import FloatArray
from orchestrator.yaml_file import Block, load

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


class CaseBlock(Block):
    """A variant of the scenario: values that differ, and what must hold besides."""

    name: str
    set: dict[str, Value] = {}
    expect: list[Expectation] = []


class ScenarioBlock(SystemBlock):
    """A scenario file."""

    title: str
    description: str = ""
    stimuli: dict[str, StimulusBlock] = {}
    run: RunBlock
    record: list[str] | None = None
    cases: list[CaseBlock] = Field(default_factory=lambda: [CaseBlock(name="run")], min_length=1)
    expect: list[Expectation] = []

    @model_validator(mode="after")
    def _distinct_cases(self) -> ScenarioBlock:
        names = [case.name for case in self.cases]
        if len(set(names)) != len(names):
            raise ValueError("two cases have one name")
        return self


@dataclass(frozen=True)
class CaseResult:
    """A case that was run: its result, or the error that ended it, and how its expectations turned out."""

    name: str
    result: Result | None
    error: ServotwinError | None
    checks: tuple[Check, ...]

    @property
    def passed(self) -> bool:
        """All expectations held, and no error came that none of them expected."""
        return all(each.held for each in self.checks) and (self.error is None or bool(self.checks))


@dataclass(frozen=True)
class ScenarioResult:
    """A scenario that was run."""

    path: Path
    block: ScenarioBlock
    assembled: Assembled
    cases: tuple[CaseResult, ...]

    @property
    def passed(self) -> bool:
        return all(case.passed for case in self.cases)


def run_scenario(path: Path, overrides: Mapping[str, Value] | None = None, progress: Progress | None = None,
                 fmus: Path | None = None) -> ScenarioResult:  # fmt: skip
    """Run every case of a scenario file and judge it.

    Args:
        overrides: component.variable -> value, over those of the file.
        fmus: folder that keeps the FMUs that are built; a temporary one by default.

    Raises:
        InputError: the file or the system does not fit; nothing has run.
        FmuError: an FMU failed in a case that does not expect to be refused.
    """
    block = load(path, ScenarioBlock)
    with tempfile.TemporaryDirectory(prefix="servotwin-") as folder:
        assembled = assemble(block, path.parent, fmus or Path(folder), tuple(sorted(block.stimuli)))
        with OpenSystem(assembled) as opened, opened.simulation(block.run.timing()) as simulation:
            stimuli = {name: each.values(simulation.instants(), path.parent) for name, each in block.stimuli.items()}
            cases = []
            for number, case in enumerate(block.cases):
                part = _part_of(progress, number, len(block.cases))
                values = block.values() | case.set | dict(overrides or {})
                cases.append(_run_case(block, case, simulation, values, stimuli, path.parent, part))
        return ScenarioResult(path, block, assembled, tuple(cases))


def _run_case(
    block: ScenarioBlock,
    case: CaseBlock,
    simulation: Simulation,
    values: Mapping[str, Value],
    stimuli: Mapping[str, FloatArray],
    base: Path,
    progress: Progress | None,
) -> CaseResult:
    expected = [*block.expect, *case.expect]
    refusal = any(each.refused is not None for each in expected)
    result, error = None, None
    try:
        result = simulation.run(values, stimuli, _recorded(block, expected), progress)
    except ServotwinError as failure:
        if not refusal:
            raise _in_case(failure, case, len(block.cases)) from failure
        error = failure
    trace = result.trace if result is not None else None
    return CaseResult(case.name, result, error, tuple(check(each, trace, error, base) for each in expected))


def _recorded(block: ScenarioBlock, expected: list[Expectation]) -> list[str] | None:
    """The file's `record`, and whatever an expectation looks at."""
    if block.record is None:
        return None
    return list(dict.fromkeys([*block.record, *(each.signal for each in expected if each.signal is not None)]))


def _in_case(error: ServotwinError, case: CaseBlock, count: int) -> ServotwinError:
    if count == 1:
        return error
    return type(error)(f"case {case.name}: {error.place}", error.problem, error.fix)


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
