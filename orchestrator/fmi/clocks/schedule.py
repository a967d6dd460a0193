"""When the clocks of one instance tick that do so by time: counted from their first tick, never added up."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction

from orchestrator.fmi.clocks.declared import PERIODIC, Clock, TickInterval
from orchestrator.rational import TickTimes as Count
from orchestrator.rational import clock as counted

Moment = tuple[int, float, float, bool]  # number and time of the next tick, time of the latest [s], whether it ticked
Position = tuple[int, int, int, int, float, float, bool]  # first, step and denominator of a count, then a moment


@dataclass
class Timed:
    """A clock that ticks by time.

    Attributes:
        next: time of its next tick, infinity where nobody knows it yet [s].
        last: of its latest one, of the start before the first [s].
    """

    clock: Clock
    next: float = math.inf
    last: Fraction = Fraction(0)
    _count: Count | None = None  # from the number of a tick to its time
    _number: int = 0  # of the next tick
    _ticked: bool = False

    def begin(self, start: Fraction) -> None:
        """Have it where a run begins [s]."""
        self.last, self._count, self.next, self._ticked = start, None, math.inf, False
        if self.clock.interval is not None:
            self._every(start + self.clock.shift, self.clock.interval)
        elif self.clock.kind is TickInterval.CHANGING:
            self.next = float(start + self.clock.shift)

    def tick(self) -> None:
        """Go on to the tick after the one that is due."""
        self.last, self._ticked = Fraction(repr(self.next)), True
        if self._count is not None and self.clock.kind in PERIODIC:
            self._number += 1
            self.next = self._count(self._number)
        else:
            self.next = math.inf

    def told(self, interval: Fraction, now: float) -> None:
        """Take an interval that the FMU gives [s] at a time [s]."""
        kind = self.clock.kind
        if kind is TickInterval.COUNTDOWN:
            self.next = float(Fraction(repr(now)) + interval)
        elif kind is TickInterval.CHANGING:
            self.next = float(self.last + interval)
        else:
            self._every(self.last + (interval if self._ticked else self.clock.shift), interval)

    @property
    def position(self) -> Position:
        """Where it is; the denominator is 0 where it does not tick at one interval."""
        count = self._count or Count(0, 0, 0)
        moment = self._number, self.next, float(self.last), self._ticked
        return count.first, count.step, count.denominator, *moment

    def put(self, number: int, next_tick: float, last: float, ticked: bool) -> None:
        """Go to another moment, of those that it comes to by ticking."""
        if ticked and (number, next_tick, last) != (self._number, self.next, float(self.last)):
            self.last = Fraction(repr(last))
        self._number, self.next, self._ticked = number, next_tick, ticked

    def _every(self, first: Fraction, interval: Fraction) -> None:
        self._count, self._number = counted(first, interval), 0
        self.next = float(first)


class ClockSchedule:
    """The clocks of an instance that tick by time."""

    def __init__(self, clocks: Iterable[Clock]) -> None:
        timed = sorted((clock for clock in clocks if clock.timed), key=lambda clock: clock.reference)
        self._timed = {clock.reference: Timed(clock) for clock in timed}

    @property
    def next(self) -> float:
        """Time of the next tick [s], infinity where there is none."""
        return min((timed.next for timed in self._timed.values()), default=math.inf)

    def begin(self, start: float) -> None:
        """Have all where a run begins [s]."""
        for timed in self._timed.values():
            timed.begin(Fraction(repr(start)))

    def due(self, until: float) -> frozenset[int]:
        """Those that tick up to this time [s], by their references; the next of each is the one after that."""
        found = [reference for reference, timed in self._timed.items() if timed.next <= until]
        for reference in found:
            self._timed[reference].tick()
        return frozenset(found)

    def asking(self, ticked: Collection[int], beginning: bool) -> list[int]:
        """Whose intervals are to be asked for: of countdowns and tunable ones always, of those that change when they
        have ticked, of fixed ones at the `beginning`."""
        return [
            reference
            for reference, timed in self._timed.items()
            if timed.clock.kind in (TickInterval.COUNTDOWN, TickInterval.TUNABLE)
            or (timed.clock.kind is TickInterval.CHANGING and reference in ticked)
            or (timed.clock.kind is TickInterval.FIXED and beginning)
        ]

    def told(self, reference: int, interval: float, now: float) -> None:
        """Take an interval that the FMU gives for a clock [s] at a time [s]."""
        self._timed[reference].told(Fraction(repr(interval)), now)

    @property
    def unknown(self) -> list[Clock]:
        """Periodic ones whose interval nothing tells."""
        return [t.clock for t in self._timed.values() if t.clock.kind in PERIODIC and t.next == math.inf]

    @property
    def undeclared(self) -> list[int]:
        """Those whose interval and shift only the FMU tells, as they depend on its parameters."""
        kinds = (TickInterval.FIXED, TickInterval.TUNABLE)
        return [r for r, timed in self._timed.items() if timed.clock.kind in kinds and timed.clock.interval is None]

    def shift(self, reference: int, seconds: float) -> None:
        """Have a clock tick first so long after the start [s]."""
        timed = self._timed[reference]
        timed.clock = dataclasses.replace(timed.clock, shift=Fraction(repr(seconds)))

    @property
    def timed(self) -> Mapping[int, Timed]:
        """Reference -> clock, in rising order."""
        return self._timed

    def saved(self) -> dict[int, Timed]:
        """A copy of where they are."""
        return {reference: dataclasses.replace(timed) for reference, timed in self._timed.items()}

    def restore(self, saved: Mapping[int, Timed]) -> None:
        """Go back to a copy."""
        for reference, timed in saved.items():
            vars(self._timed[reference]).update(vars(timed))
