"""What a scenario gave: how far each case came, and how its expectations turned out."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from pathlib import Path

import numpy as np

from fmus.errors import PartialError, ScenarioError, ServotwinError
from fmus.files import sha256
from orchestrator.assembly.assembly import Assembled
from orchestrator.crossing import Crossing
from orchestrator.display.table import table
from orchestrator.engine import Result
from orchestrator.fmi.interface import Value
from orchestrator.scenario.expectations import Check, DrawnTraces
from orchestrator.scenario.run.keeping import Keeping
from orchestrator.scenario.scenario import Scenario
from orchestrator.system import System
from orchestrator.trace import Trace

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


def nonfinite(trace: Trace) -> dict[str, int]:
    """signal -> how many of its samples are NaN or infinite, where some are."""
    counts = {name: int(np.count_nonzero(~np.isfinite(trace[name]))) for name in trace.names}
    return {name: count for name, count in counts.items() if count}


def _word(check: Check) -> str:
    """Whether it held, in a word."""
    return "yes" if check.held else "NO" if check.needed else "no, but only a warning"
