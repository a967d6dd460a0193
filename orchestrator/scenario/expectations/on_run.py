"""Expectations of the run itself: refused for a reason, its warnings, steps and times, its frames on a bus."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from pydantic import Field, model_validator

from fmus.errors import ScenarioError
from orchestrator.scenario.expectations.base import Check, Expected, Ran
from orchestrator.scenario.expectations.figure import FigureBounds
from orchestrator.scenario.expectations.quantities import Dimension
from orchestrator.yaml_file import Time

NO_BUS = "not on a bus"


@dataclass(frozen=True)
class Refusal(Expected):
    """The run ends in an error whose message holds `reason`."""

    reason: str

    def __str__(self) -> str:
        return f"refused because of '{self.reason}'"

    @property
    def refuses(self) -> bool:
        return True

    def check(self, ran: Ran) -> Check:
        found = str(ran.error) if ran.error is not None else "the run went through"
        return Check(str(self), ran.error is not None and self.reason in found, found)


class CountBlock(FigureBounds):
    """Bounds of a count, of all components together or of one.

    Attributes:
        component: all by default.
    """

    component: str | None = None

    def of(self, counts: Mapping[str, int]) -> float:
        """What of these counts is asked for.

        Raises:
            ScenarioError: there is no such component.
        """
        if self.component is None:
            return float(sum(counts.values()))
        if self.component not in counts:
            raise ScenarioError("expect", f"there is no component {self.component}", f"known are {', '.join(counts)}")
        return float(counts[self.component])


class ProcessorTimeBlock(FigureBounds):
    """Bounds of the processor time over a stored one.

    Attributes:
        seconds: the stored one [s].
        manifest: or a manifest.json of a run, whose case of the same name has it under `processor`.
    """

    seconds: Time | None = Field(None, gt=0)
    manifest: Path | None = None

    @model_validator(mode="after")
    def _stored(self) -> Self:
        if (self.seconds is None) == (self.manifest is None):
            raise ValueError("give `seconds` or `manifest`")
        return self

    def beside(self, base: Path) -> Self:
        """The same with a manifest that is relative to `base`."""
        return self.model_copy(update={"manifest": self.manifest and base / self.manifest})

    def stored(self, case: str) -> float:
        """The stored time of a case [s].

        Raises:
            ScenarioError: the manifest cannot be read, or has no such time.
        """
        if self.manifest is None:
            return self.seconds or 0.0
        try:
            cases = json.loads(self.manifest.read_text(encoding="utf-8"))["cases"]
            seconds = float(next(one["processor"] for one in cases if one["name"] == case))
        except (OSError, ValueError, KeyError, TypeError, StopIteration, RecursionError):
            seconds = 0.0
        if not seconds > 0:
            fix = "give the manifest.json of a run of this scenario"
            raise ScenarioError(self.manifest, f"has no processor time of case {case}", fix)
        return seconds


@dataclass(frozen=True)
class RunKind:
    """A figure of a run: what it is called, what it is, and how it is read; a text says why there is none to judge.

    Attributes:
        only_told: whether it depends on the machine alone, so that it never fails a case.
    """

    words: str
    dimension: Dimension
    read: Callable[[Ran, FigureBounds], float | str]
    only_told: bool = False


def _warnings(ran: Ran, bounds: FigureBounds) -> float | str:
    assert isinstance(bounds, CountBlock)
    return "unknown" if ran.result is None else bounds.of(ran.result.warnings)


def _steps(ran: Ran, bounds: FigureBounds) -> float | str:
    assert isinstance(bounds, CountBlock)
    if ran.result is None:
        return "unknown"
    calls = {name: counted.calls for name, counted in ran.result.statistics.items()}
    return bounds.of(calls)


def _processor_time(ran: Ran, bounds: FigureBounds) -> float | str:
    assert isinstance(bounds, ProcessorTimeBlock)
    return "unknown" if ran.processor is None else ran.processor / bounds.stored(ran.case)


def _counted(name: str) -> Callable[[Ran, FigureBounds], float | str]:
    return lambda ran, bounds: NO_BUS if ran.bus is None else float(ran.bus[name])


def _iterations(ran: Ran, bounds: FigureBounds) -> float | str:
    return "unknown" if ran.result is None else float(ran.result.iterations)


def _real_time_factor(ran: Ran, bounds: FigureBounds) -> float | str:
    return "unknown" if ran.result is None else ran.result.account.real_time_factor


KINDS: Mapping[str, RunKind] = {
    "warnings": RunKind("warnings of FMUs", Dimension.SHARE, _warnings),
    "steps": RunKind("steps of components", Dimension.SHARE, _steps),
    "iterations": RunKind("iterations of cycles", Dimension.SHARE, _iterations),
    "processor_time": RunKind("processor time over the stored one", Dimension.SHARE, _processor_time),
    "real_time_factor": RunKind("real-time factor", Dimension.SHARE, _real_time_factor),
    "frames_lost": RunKind("frames lost", Dimension.SHARE, _counted("frames lost")),
    "late_steps": RunKind("late steps", Dimension.SHARE, _counted("late steps"), only_told=True),
}


def plain(block: FigureBounds, base: Path) -> FigureBounds:
    """Bounds as plain numbers; a manifest is relative to `base`.

    Raises:
        WiringError: a bound has a unit that does not fit.
    """
    if isinstance(block, ProcessorTimeBlock):
        block = block.beside(base)
    return block.bounds_in("expect", Dimension.SHARE)


@dataclass(frozen=True)
class OnRun(Expected):
    """A figure of the run lies between bounds.

    Attributes:
        kind: a name in `KINDS`.
        bounds: plain numbers.
    """

    kind: str
    bounds: FigureBounds

    def __str__(self) -> str:
        of = getattr(self.bounds, "component", None)
        return (
            f"has {KINDS[self.kind].words}{f' of {of}' if of else ''} {self.bounds.asked(KINDS[self.kind].dimension)}"
        )

    def check(self, ran: Ran) -> Check:
        kind = KINDS[self.kind]
        if ran.trace is None:
            return Check(str(self), False, str(ran.error), needed=not kind.only_told)
        found = kind.read(ran, self.bounds)
        if isinstance(found, str):
            return Check(str(self), found == NO_BUS, found, needed=not kind.only_told)
        answer = self.bounds.judgement(kind.words, found, kind.dimension, lowest=0.0)
        needed = not kind.only_told
        return Check(str(self), answer.held, answer.found, answer.figure, answer.margin, "", needed, answer.doubt)
