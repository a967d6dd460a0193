"""The clocks of one instance: which tick next, what an event does with them, and what of it goes to others."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from orchestrator.fmi.clocks.declared import Clock
from orchestrator.fmi.clocks.schedule import ClockSchedule, Timed
from orchestrator.fmi.clocks.ticks import Arrival, Tick
from orchestrator.fmi.functions.base import FmiFunctions
from orchestrator.fmi.ticking.calls import ClockCalls

Require = Callable[[int, str], None]


@dataclass(frozen=True)
class Saved:
    """A copy of where clocks are."""

    schedule: Mapping[int, Timed]
    arrivals: tuple[Arrival, ...]


class Ticker:
    """The clocks of an instance; times in seconds.

    Attributes:
        schedule: of those that tick by time.
        passed: ticks of its output clocks that others have not been told.
    """

    def __init__(self, clocks: Collection[Clock]) -> None:
        self._clocks = [*clocks]
        self._by_name = {clock.name: clock for clock in clocks}
        self._by_reference = {clock.reference: clock for clock in clocks}
        self.schedule = self._schedule = ClockSchedule(clocks)
        self._arrivals: list[Arrival] = []
        self.passed: list[Tick] = []

    def begin(self, start: float, fmi: FmiFunctions, require: Require) -> None:
        """Have it where a run begins, of an instance with these functions; `require` raises where a status is bad."""
        self._schedule.begin(start)
        self._arrivals, self.passed = [], []
        self._calls = ClockCalls(fmi, self._clocks, require)

    def ask_shifts(self) -> str:
        """Ask for the shifts that only the FMU tells, in initialisation mode; what is wrong with one, or nothing."""
        asking = self._schedule.undeclared
        for reference, shift in zip(asking, self._calls.shifts(asking) if asking else (), strict=False):
            if not 0 <= shift < math.inf:
                return f"gives its {self._by_reference[reference]} the shift {shift:g} s"
            self._schedule.shift(reference, shift)
        return ""

    @property
    def next(self) -> float:
        """Time of the next tick from inside or outside, infinity where there is none."""
        return min(self._schedule.next, self._arrivals[0].time if self._arrivals else math.inf)

    def expect(self, arrivals: Sequence[Arrival]) -> None:
        """Have clocks tick as those of others did."""
        self._arrivals = sorted([*self._arrivals, *arrivals], key=lambda arrival: arrival.time)

    def due(self, until: float) -> tuple[frozenset[int], Mapping[int, float]]:
        """Which clocks tick up to a time, by their references, and place among the inputs -> value that came along.
        What ticks by time and the first ticks from outside tick together; more from outside is a later event."""
        ticking = self._schedule.due(until)
        if not (self._arrivals and self._arrivals[0].time <= until):
            return ticking, {}
        arrival = self._arrivals.pop(0)
        return ticking | self.references(arrival.clocks), arrival.inputs

    def at_once(self, time: float) -> frozenset[int]:
        """Which clocks tick in the next turn of an event, for their countdown was 0 s."""
        return self._schedule.due(time)

    def references(self, names: Iterable[str]) -> frozenset[int]:
        """Of clocks, by their names."""
        return frozenset(self._by_name[name].reference for name in names)

    def activate(self, ticking: Collection[int]) -> frozenset[str]:
        """Have clocks tick, in event mode; their names."""
        if ticking:
            self._calls.activate(ticking)
        return frozenset(self._by_reference[reference].name for reference in ticking)

    @property
    def calls(self) -> ClockCalls:
        """What the FMU is asked and told about its clocks."""
        return self._calls

    def tell(self, time: float, read: Callable[[], Sequence[float]]) -> frozenset[str]:
        """Take note of the output clocks that tick at a time, with what `read` gives then; their names."""
        if active := self._calls.active():
            self.passed.append(Tick(time, active, [*read()]))
        return active

    def learn(self, time: float, ticked: Collection[int], beginning: bool = False) -> str:
        """Ask for the intervals that may be new; what is wrong with one of them, or nothing."""
        asking = self._schedule.asking(ticked, beginning)
        for reference, interval in self._calls.intervals(asking) if asking else ():
            if problem := self.amiss(reference, interval):
                return problem
            self._schedule.told(reference, interval, time)
        unknown = self._schedule.unknown
        return f"gives its {unknown[0]} no interval" if beginning and unknown else ""

    def amiss(self, reference: int, interval: float) -> str:
        """What is wrong with an interval that the FMU gives for a clock [s], or nothing."""
        clock = self._by_reference[reference]
        if math.isfinite(interval) and (interval > 0 or (interval == 0 and not clock.periodic)):
            return ""
        return f"gives its {clock} the interval {interval:g} s"

    def saved(self) -> Saved:
        """A copy of where they are."""
        return Saved(self._schedule.saved(), tuple(self._arrivals))

    def restore(self, saved: Saved) -> None:
        """Go back to a copy."""
        self._schedule.restore(saved.schedule)
        self._arrivals = [*saved.arrivals]
