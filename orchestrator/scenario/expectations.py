"""What must hold in a run: limits, values, closeness to a reference, or that the run is refused for a reason."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from fmus.errors import ScenarioError, ServotwinError
from orchestrator.crossing import NOTHING_GIVEN, Given
from orchestrator.trace import FloatArray, Trace


@dataclass(frozen=True)
class Check:
    """How an expectation turned out: what was asked, whether it held, and the figure that decided."""

    text: str
    held: bool
    found: str


class Condition(Protocol):
    """What is asked of the samples of a signal; its text says it in words."""

    def judged(self, time: FloatArray, values: FloatArray) -> tuple[bool, str]:
        """Whether values (K,) at times (K,) [s] fulfil it, and the figure that decided.

        Raises:
            TraceError: a reference does not cover the times.
        """


Number = float | str
"""In the unit of the signal; a text with a unit of its own, `90 deg`, until a scenario is in its system's units."""


@dataclass(frozen=True)
class Below:
    """Every sample lies below the limit [unit of the signal]."""

    limit: Number

    def __str__(self) -> str:
        return f"stays below {_shown(self.limit)}"

    def judged(self, time: FloatArray, values: FloatArray) -> tuple[bool, str]:
        return bool(values.max() < float(self.limit)), f"largest {values.max():.6g}"


@dataclass(frozen=True)
class Above:
    """Every sample lies above the limit [unit of the signal]."""

    limit: Number

    def __str__(self) -> str:
        return f"stays above {_shown(self.limit)}"

    def judged(self, time: FloatArray, values: FloatArray) -> tuple[bool, str]:
        return bool(values.min() > float(self.limit)), f"smallest {values.min():.6g}"


@dataclass(frozen=True)
class Near:
    """No sample is farther than `within` from a value, or from a trace with one signal [unit of the signal].

    Attributes:
        name: what the value or the trace is called in words.
        given: what the trace is converted by, over its unit.
    """

    target: Number | Trace
    within: Number
    name: str = ""
    given: Given = NOTHING_GIVEN

    def __str__(self) -> str:
        if isinstance(self.target, Trace):
            return f"follows {self.name or self.target.name} within {_shown(self.within)}"
        return f"is {_shown(self.target)} within {_shown(self.within)}"

    def judged(self, time: FloatArray, values: FloatArray) -> tuple[bool, str]:
        target: float | FloatArray
        if isinstance(self.target, Trace):
            (target,) = self.target.resampled(time).signals.values()
        else:
            target = float(self.target)
        deviation = float(np.max(np.abs(values - target)))
        return deviation <= float(self.within), f"largest deviation {deviation:.3g}"


@dataclass(frozen=True)
class Unread:
    """No sample is farther than `within` from a reference that is not there, or that is to be replaced: never held.

    Attributes:
        file: where the reference is to be.
        scenario: the file that asks for it.
    """

    file: Path
    within: Number
    scenario: Path

    def __str__(self) -> str:
        return f"follows its reference within {_shown(self.within)}"

    def judged(self, time: FloatArray, values: FloatArray) -> tuple[bool, str]:
        return False, f"no {self.file}, which `servotwin accept {self.scenario}` writes"


def _shown(number: Number) -> str:
    return number if isinstance(number, str) else f"{number:g}"


@dataclass(frozen=True)
class Expectation:
    """A condition on one recorded variable between two times [s]; None is the run's begin or end."""

    signal: str
    condition: Condition
    after: float | None = None
    before: float | None = None

    def __str__(self) -> str:
        times = {"after": self.after, "before": self.before}
        between = [f"{word} {time:g} s" for word, time in times.items() if time is not None]
        return " ".join([self.signal, str(self.condition), *between])

    def check(self, trace: Trace | None, error: ServotwinError | None) -> Check:
        """FileJudge the trace of a run, or the error that ended it.

        Raises:
            ScenarioError: there is no sample between the times.
            TraceError: the signal was not recorded, or a reference does not cover the times.
        """
        if trace is None:
            return Check(str(self), False, str(error))
        window = self._window(trace)
        held, found = self.condition.judged(window.time, window[self.signal])
        if isinstance(self.condition, Unread):
            return Check(str(self), held, found)
        unit = trace.unit(self.signal) or "1"
        return Check(str(self), held, found if unit == "1" else f"{found} {unit}")

    def check_covered(self, instants: FloatArray) -> None:
        """See, before a run with these instants, that a reference lasts as long as the run is compared with it.

        Raises:
            ScenarioError: it does not.
        """
        if not (isinstance(self.condition, Near) and isinstance(self.condition.target, Trace)):
            return
        reference = self.condition.target
        after, before = (-np.inf if self.after is None else self.after, np.inf if self.before is None else self.before)
        looked_at = instants[(instants >= after) & (instants <= before)]
        if not len(looked_at) or reference.covers(looked_at[0], looked_at[-1]):
            return
        covered = f"{reference.time[0]:g} to {reference.time[-1]:g} s" if len(reference) else "nothing"
        raise ScenarioError(
            f"expect {self.signal}",
            f"{self.condition.name or reference.name} covers {covered}, not {looked_at[0]:g} to {looked_at[-1]:g} s",
            "say from when to when it is compared with `after` and `before`",
        )

    def _window(self, trace: Trace) -> Trace:
        start = trace.time[0] if self.after is None else self.after
        stop = trace.time[-1] if self.before is None else self.before
        window = trace.select([self.signal]).between(start, stop)
        if not len(window):
            raise ScenarioError(
                f"expect {self.signal}",
                f"there is no sample from {start:g} to {stop:g} s",
                "correct `after` and `before`",
            )
        return window


@dataclass(frozen=True)
class Refusal:
    """The run ends in an error whose message holds `reason`."""

    reason: str

    def __str__(self) -> str:
        return f"refused because of '{self.reason}'"

    def check(self, trace: Trace | None, error: ServotwinError | None) -> Check:
        """FileJudge the error that ended a run, None where it went through."""
        found = str(error) if error is not None else "the run went through"
        return Check(str(self), error is not None and self.reason in found, found)
