"""Expectations of one recorded signal between two times: a condition on its samples, or what its texts say."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from fmus.errors import ScenarioError, TraceError, WiringError
from orchestrator.scenario.expectations.base import (
    Check,
    Condition,
    DrawnTraces,
    Draws,
    ExpectationScope,
    Expected,
    Judgement,
    Ran,
    Times,
    Tube,
)
from orchestrator.trace import FloatArray, Trace


class OfSignal(Expected):
    """Asks something of one recorded variable between two times [s]; None is the run's begin or end."""

    signal: str
    after: float | None
    before: float | None

    @property
    def place(self) -> str:
        """What messages name."""
        return f"expect {self.signal}"

    @property
    def signals(self) -> tuple[str, ...]:
        return (self.signal,)

    @property
    def until(self) -> float:
        return np.inf if self.before is None else self.before

    def window(self, trace: Trace) -> Trace:
        """The samples that it looks at.

        Raises:
            ScenarioError: there are none.
            TraceError: the signal was not recorded.
        """
        start = trace.time[0] if self.after is None else self.after
        stop = trace.time[-1] if self.before is None else self.before
        window = trace.select([self.signal]).between(start, stop)
        if not len(window):
            problem = f"there is no sample from {start:g} to {stop:g} s"
            raise ScenarioError(self.place, problem, "correct `after` and `before`")
        return window

    def said(self, what: str) -> str:
        """The whole in words, from what is asked."""
        times = {"after": self.after, "before": self.before}
        between = [f"{word} {time:g} s" for word, time in times.items() if time is not None]
        return " ".join([self.signal, what, *between])


@dataclass(frozen=True)
class OnSignal(OfSignal):
    """A condition on one recorded variable between two times [s]; None is the run's begin or end.

    Attributes:
        hold: whether it keeps each value until its next sample.
    """

    signal: str
    condition: Condition
    after: float | None = None
    before: float | None = None
    hold: bool = False

    def __str__(self) -> str:
        return self.said(str(self.condition))

    @property
    def asked(self) -> Times:
        """Between which times it looks at samples [s]."""
        return (-np.inf if self.after is None else self.after, self.until)

    @property
    def drawn(self) -> tuple[tuple[str, Draws], ...]:
        return () if self.condition.draws is None else ((self.signal, self.condition.draws),)

    @property
    def files(self) -> tuple[Path, ...]:
        return self.condition.files

    @property
    def accepted(self) -> bool:
        return self.condition.accepted

    def brought(self, wiring: ExpectationScope) -> Self:
        port = wiring.port(self.signal, self.place)
        if not port.numeric:
            raise WiringError(self.place, f"is a {port.type}, of which only `equals` can be asked", "ask for a text")
        return replace(self, condition=self.condition.brought(self.place, port, wiring), hold=port.stepwise)

    def check_covered(self, instants: FloatArray) -> None:
        after, before = self.asked
        looked_at = instants[(instants >= after) & (instants <= before)]
        if len(looked_at):
            self.condition.check_covered(self.place, looked_at, self.asked)

    def check(self, ran: Ran) -> Check:
        if ran.trace is None:
            return Check(str(self), False, str(ran.error))
        window = self.window(ran.trace)
        time, values = window.time, window[self.signal]
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad) and not self.condition.takes_nonfinite:
            return Check(str(self), False, f"{values[bad[0]]:g} at {time[bad[0]]:g} s")
        self.condition.check_covered(self.place, time, self.asked)
        draws = self._draws(ran.draws)
        try:
            judgement = self.condition.judged(time, values, self.hold, draws)
        except TraceError as odd:
            return Check(str(self), False, f"{odd.place}: {odd.problem}")
        return self._checked(judgement, window.unit(self.signal) or "1")

    def tube(self, trace: Trace, draws: DrawnTraces) -> tuple[FloatArray, Tube] | None:
        """Stamps (K,) [s], and between which bounds the signal may be there; None where the condition has none.

        Args:
            draws: as in `Ran`.
        """
        time = self.window(trace).time
        tube = self.condition.tube(time, self.hold, self._draws(draws))
        return None if tube is None else (time, tube)

    def _draws(self, drawn: DrawnTraces) -> list[Trace]:
        """Its window of the runs with other noise that it wants to see."""
        wanted = self.condition.draws
        return [] if wanted is None else [self.window(trace) for trace in drawn.get(wanted.vary, ())]

    def _checked(self, judgement: Judgement, unit: str) -> Check:
        name = judgement.dimension.written(unit)
        found = f"{judgement.found} {name}".strip() if judgement.figure is not None else judgement.found
        told = f"{found}{judgement.more}"
        figure, margin, doubt = judgement.figure, judgement.margin, judgement.doubt
        return Check(str(self), judgement.held, told, figure, margin, name, doubt=doubt)


@dataclass(frozen=True)
class Says(OfSignal):
    """Every sample of a text between two times [s] is one of these; None is the run's begin or end."""

    signal: str
    words: tuple[str, ...]
    after: float | None = None
    before: float | None = None

    def __str__(self) -> str:
        return self.said(f"says {' or '.join(map(repr, self.words))}")

    def brought(self, wiring: ExpectationScope) -> Self:
        port = wiring.port(self.signal, self.place)
        if port.type != "String":
            problem = f"is a {port.type}, and `equals` asks for a text"
            raise WiringError(self.place, problem, "ask for `near` and `within`")
        return self

    def check(self, ran: Ran) -> Check:
        if ran.trace is None:
            return Check(str(self), False, str(ran.error))
        window = self.window(ran.trace)
        right = [number for number, text in enumerate(window.texts[self.signal]) if text in self.words]
        odd = np.flatnonzero(~np.isin(window[self.signal], right))
        row = int(odd[0]) if len(odd) else len(window) - 1
        (said,) = window.rows(slice(row, row + 1)).words(self.signal)
        return Check(str(self), not len(odd), f"{said!r} at {window.time[row]:g} s")
