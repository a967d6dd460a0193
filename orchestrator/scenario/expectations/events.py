"""Events of a signal: it crosses a level, meets its limits or changes its mode; how many, when, in which order."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from fmus.words import listed
from orchestrator import measures
from orchestrator.fmi.interface import Port
from orchestrator.measures.events import Direction
from orchestrator.scenario.expectations.base import Check, Condition, ExpectationScope, Expected, Judgement, Ran
from orchestrator.scenario.expectations.figure import Figure, shown
from orchestrator.scenario.expectations.on_signal import OnSignal
from orchestrator.scenario.expectations.quantities import Dimension, Distance, Level, brought
from orchestrator.trace import FloatArray, Trace
from orchestrator.yaml_file import Block, Time

SHOWN = 6  # times of events in a text


class Events(Block, Condition):
    """Events of a kind: how many there are, or when each comes; there is one at least where nothing is said.

    Attributes:
        count: how many exactly.
        at_least, at_most: or between which numbers.
        times: of all of them, in order [s].
        within: how far each may be from its time [s].
    """

    count: int | None = Field(None, ge=0)
    at_least: int | None = Field(None, ge=1)
    at_most: int | None = Field(None, ge=0)
    times: list[Time] | None = None
    within: Time | None = Field(None, gt=0)

    @model_validator(mode="after")
    def _asks(self) -> Self:
        if (self.times is None) != (self.within is None):
            raise ValueError("`times` and `within` go together")
        if self.times is not None and sorted(self.times) != self.times:
            raise ValueError("`times` must ascend")
        asked = (self.count is not None, self.times is not None, not (self.at_least is None and self.at_most is None))
        if sum(asked) > 1:
            raise ValueError("give one of `count`, `at_least` and `at_most`, or `times` and `within`")
        return self

    @property
    @abstractmethod
    def words(self) -> str:
        """What the events are called."""

    @abstractmethod
    def stamps(self, time: FloatArray, values: FloatArray, hold: bool) -> FloatArray:
        """(n,) when they come [s]."""

    def __str__(self) -> str:
        if self.times is not None:
            return f"has {self.words} at {_listed(np.array(self.times))} within {self.within:g} s"
        if self.count is not None:
            return f"has {self.count} {self.words}"
        parts = [] if self.at_least is None else [f"at least {self.at_least}"]
        parts += [] if self.at_most is None else [f"at most {self.at_most}"]
        return " ".join(filter(None, ("has", " and ".join(parts), self.words)))

    def brought(self, place: str, port: Port, wiring: ExpectationScope) -> Self:
        return brought(self, place, port)

    def judged(self, time: FloatArray, values: FloatArray, hold: bool, draws: Sequence[Trace]) -> Judgement:
        stamps = self.stamps(time, values, hold)
        found = f"{len(stamps)} {self.words}" + (f" at {_listed(stamps)}" if len(stamps) else "")
        if self.times is not None and self.within is not None:
            if len(stamps) != len(self.times):
                return Judgement(False, f"{found}, not {len(self.times)}")
            farthest = float(np.max(np.abs(stamps - self.times), initial=0.0))
            away = f"{found}, farthest from its time"
            return Judgement(
                farthest <= self.within, f"{away} {farthest:.3g}", farthest, self.within - farthest, Dimension.TIME
            )
        low, high = self._numbers
        return Judgement(low <= len(stamps) <= high, found, float(len(stamps)), None, Dimension.SHARE)

    @property
    def _numbers(self) -> tuple[float, float]:
        """How many there may be at least and at most."""
        if self.count is not None:
            return self.count, self.count
        fewest = 1 if self.at_most is None else 0
        return fewest if self.at_least is None else self.at_least, np.inf if self.at_most is None else self.at_most


def _listed(stamps: FloatArray) -> str:
    return f"{listed([f'{stamp:.6g}' for stamp in stamps], SHOWN)} s"


class Crossings(Events):
    """The signal goes through a level, and beyond it by the hysteresis.

    Attributes:
        level: [unit of the signal].
        direction: which way it goes through.
        hysteresis: how far beyond it has to come to have gone through [unit of the signal].
    """

    level: Level
    direction: Direction = "both"
    hysteresis: Distance = 0.0

    @property
    def words(self) -> str:
        way = "" if self.direction == "both" else f" {self.direction}wards"
        return f"crossings of {shown(self.level)}{way}"

    def stamps(self, time: FloatArray, values: FloatArray, hold: bool) -> FloatArray:
        return measures.crossings(time, values, float(self.level), self.direction, float(self.hysteresis), hold)


class Saturations(Events):
    """The signal meets a limit; it comes when it first is there.

    Attributes:
        low, high: the limits [unit of the signal].
        nearer: how near a limit it is there [unit of the signal].
    """

    low: Level
    high: Level
    nearer: Distance = 0.0

    @property
    def words(self) -> str:
        return f"saturations at {shown(self.low)} or {shown(self.high)}"

    def stamps(self, time: FloatArray, values: FloatArray, hold: bool) -> FloatArray:
        return measures.saturations(time, values, float(self.low), float(self.high), float(self.nearer))[:, 0]


class ModeChanges(Events):
    """A signal that counts or names modes takes another value.

    Attributes:
        modes: the values that it has, one after the other, the first one included.
    """

    modes: list[float] | None = Field(None, min_length=1)

    @model_validator(mode="after")
    def _as_many(self) -> Self:
        if self.modes is not None and not {"count", "at_least", "at_most"}.isdisjoint(self.model_fields_set):
            raise ValueError("`modes` say how many changes there are")
        return self

    @property
    def words(self) -> str:
        return "changes of mode"

    def __str__(self) -> str:
        if self.modes is None:
            return super().__str__()
        through = f"goes through the modes {', '.join(f'{mode:g}' for mode in self.modes)}"
        return through if self.times is None else f"{through}, and {super().__str__()}"

    @property
    def _numbers(self) -> tuple[float, float]:
        return super()._numbers if self.modes is None else (0, np.inf)

    def stamps(self, time: FloatArray, values: FloatArray, hold: bool) -> FloatArray:
        return measures.changes(time, values)[0]

    def judged(self, time: FloatArray, values: FloatArray, hold: bool, draws: Sequence[Trace]) -> Judgement:
        seen = [float(values[0]), *measures.changes(time, values)[1].tolist()]
        if self.modes is not None and seen != self.modes:
            return Judgement(False, f"modes {listed([f'{mode:g}' for mode in seen], SHOWN)}")
        return super().judged(time, values, hold, draws)


class Saturated(Figure):
    """Share of the time that the signal is at a limit or beyond.

    Attributes:
        low, high: the limits [unit of the signal].
        nearer: how near a limit it is there [unit of the signal].
    """

    words: ClassVar[str] = "saturated share"
    dimension: ClassVar[Dimension] = Dimension.SHARE
    low: Level
    high: Level
    nearer: Distance = 0.0

    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float:
        return measures.saturated_share(time, values, float(self.low), float(self.high), float(self.nearer))


@dataclass(frozen=True)
class InOrder(Expected):
    """Events of several signals come one after the other: of each the first that is later than the one before it.

    Attributes:
        steps: the conditions are `Events`; number and times that they ask for do not matter.
    """

    steps: tuple[OnSignal, ...]

    def __str__(self) -> str:
        return "in order: " + ", then ".join(f"{step.signal} has {_events(step).words}" for step in self.steps)

    @property
    def signals(self) -> tuple[str, ...]:
        return tuple(step.signal for step in self.steps)

    @property
    def until(self) -> float:
        return max(step.until for step in self.steps)

    def brought(self, wiring: ExpectationScope) -> Self:
        return replace(self, steps=tuple(step.brought(wiring) for step in self.steps))

    def check(self, ran: Ran) -> Check:
        if ran.trace is None:
            return Check(str(self), False, str(ran.error))
        latest, found = -np.inf, list[float]()
        for number, step in enumerate(self.steps, 1):
            window = step.window(ran.trace)
            if not np.all(np.isfinite(window[step.signal])):
                return Check(str(self), False, f"{step.signal} is not finite everywhere")
            stamps = _events(step).stamps(window.time, window[step.signal], step.hold)
            after = stamps[stamps > latest]
            if not len(after):
                since = f" after {latest:.6g} s" if found else ""
                return Check(str(self), False, f"step {number}: no {_events(step).words} of {step.signal}{since}")
            latest = float(after[0])
            found.append(latest)
        return Check(str(self), True, f"at {_listed(np.array(found))}")


def _events(step: OnSignal) -> Events:
    assert isinstance(step.condition, Events)
    return step.condition
