"""A co-simulation FMU with clocks: a step goes from event to event, and at each its clocks tick.

Within a communication step inputs are held, as between any two communication points; what a tick from another
component brings along is set with it. What happens at the very end of a step (within a billionth of it) belongs to the
beginning of the next one, where the FMU has its new inputs.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from fmus.errors import FmuEnded
from orchestrator.fmi.clocks.schedule import ClockSchedule
from orchestrator.fmi.clocks.ticks import NOTHING, Arrival, Tick
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.functions.co_simulation import EarlyStop, EventFmi3, Fmi2
from orchestrator.fmi.interface import Value
from orchestrator.fmi.slave import Slave
from orchestrator.fmi.status import stepping
from orchestrator.fmi.ticking.calls import ClockCalls
from orchestrator.fmi.ticking.inputs import InputPart, parts
from orchestrator.fmi.ticking.mail import Mail, Post, Variables
from orchestrator.fmi.ticking.ticker import Ticker

_TOGETHER = 1e-9  # times that differ by less than this share of a step are one
_ROUNDING = 16 * sys.float_info.epsilon
_MOST_TURNS = 100  # of one event iteration
_MOST_EVENTS = 1000  # at one time
_MOST_IN_STEP = 10_000_000


@dataclass
class _ClockedMoment:
    """Where an instance is between two calls.

    Attributes:
        next_event: time of the next event of its own that is known in advance [s].
        due: whether an event is to be handled before it goes on.
        in_event_mode: otherwise it is in step mode.
        wanted: its bound inputs as they are to be.
    """

    next_event: float = math.inf
    due: bool = False
    in_event_mode: bool = False
    wanted: Sequence[float] = ()


class ClockedSlave(Slave):
    """An instance of an FMU with clocks and event mode; see `Ticking` for the meaning of the methods."""

    versions = (Fmi2, EventFmi3)
    _fmi: EventFmi3

    def __init__(self, fmu: FmuFile, name: str) -> None:
        self._ticker = Ticker(fmu.interface.clocks.values())
        self._now, self._parts, self._mail = _ClockedMoment(), list[InputPart](), Mail()
        self._running = False
        super().__init__(fmu, name)

    def begin(self, start: float, stop: float | None, tolerance: float | None = None) -> None:
        self._now, self._start = _ClockedMoment(), start
        self._mail.clear()
        super().begin(start, stop, tolerance)
        self._ticker.begin(start, self._fmi, self._check)

    def bind(self, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        super().bind(inputs, outputs)
        self._parts = parts(self.interface, inputs, self._group)

    def set(self, values: Mapping[str, Value]) -> None:
        super().set(values)
        for part in self._parts:
            if part.group.partial:
                part.group.keep([(self._port(name), value) for name, value in self._given.items()])

    def run(self) -> None:
        if problem := self._ticker.ask_shifts():
            self.lost(self._start, problem)
        super().run()
        self._running = self._now.in_event_mode = True
        self._event(self._start, frozenset(), beginning=True)

    def write(self, values: Sequence[float]) -> None:
        """Set the bound inputs: those that are continuous now, others at the event that begins the step, those that
        belong to a clock when it ticks."""
        before, self._now.wanted = self._now.wanted, values
        if not self._running:
            super().write(values)
            return
        for part in self._parts:
            if not (part.discrete or part.clocks):
                self.put(part, values)
            elif not part.clocks and part.changed(before, values):
                self._now.due = True

    def tune(self, name: str, value: Value) -> Value:
        """Give it a value, in event mode; that is an event."""
        if self._running:
            self._enter_event_mode()
            self._now.due = True
        return super().tune(name, value)

    def expect(self, arrivals: Sequence[Arrival]) -> None:
        self._ticker.expect(arrivals)

    def passed(self) -> Sequence[Tick]:
        return self._ticker.passed

    def exchange(self, outgoing: Mapping[str, Variables], incoming: Mapping[str, Variables]) -> None:
        """Have these variables go out when their clocks tick, and those come in with ticks; clock -> variables."""
        self._mail = Mail(outgoing, incoming)

    def fetched(self, clocks: Container[str]) -> list[Post]:
        """What has gone out with these clocks since it was last fetched, in order."""
        return self._mail.fetched(clocks)

    def deliver(self, clock: str, values: Sequence[Value]) -> None:
        """Have a clock tick when the next step begins, and its variables come in."""
        self._mail.waiting.append((clock, values))
        self._now.due = True

    def step(self, time: float, duration: float) -> None:
        if self._asked:
            self.over(time)
        self._ticker.passed = []
        end, now = time + duration, time
        together = max(_TOGETHER * duration, _ROUNDING * abs(end))
        first, crowd, count = now, 0, 0
        while now < end - together and not self._asked:
            while self._now.due or self._next_event <= now + together:
                if now - first > together:
                    first, crowd = now, 0
                crowd, count = crowd + 1, count + 1
                if count > _MOST_IN_STEP:
                    self.flooded(now)
                if crowd == _MOST_EVENTS:
                    self.crowded(now)
                self._event(now, *self._ticker.due(now + together))
            now = self._advance(now, self._next_event if self._next_event < end - together else end, together)

    def save(self) -> Any:
        return super().save(), dataclasses.replace(self._now), self._ticker.saved(), self._mail.copy()

    def restore(self, state: Any) -> None:
        memory, moment, ticker, mail = state
        super().restore(memory)
        self._mail = mail.copy()
        self._now = dataclasses.replace(moment)
        self._ticker.restore(ticker)

    def drop(self, state: Any) -> None:
        super().drop(state[0])

    def reset(self) -> bool:
        self._running = False
        return super().reset()

    @property
    def parts(self) -> Sequence[InputPart]:
        """Its bound inputs by when they are set."""
        return self._parts

    @property
    def schedule(self) -> ClockSchedule:
        """Of its clocks that tick by time."""
        return self._ticker.schedule

    @property
    def calls(self) -> ClockCalls:
        """What its FMU is asked and told about its clocks."""
        return self._ticker.calls

    def where(self) -> tuple[float, bool, bool]:
        """Time of the next event of its own [s], whether one is due, and whether it is in event mode."""
        return self._now.next_event, self._now.due, self._now.in_event_mode

    @property
    def wanted(self) -> Sequence[float]:
        """Its bound inputs as they are to be."""
        return self._now.wanted

    def moved(self, next_event: float, due: bool, in_event_mode: bool, wanted: Sequence[float]) -> None:
        """Take note of where it is after it was stepped from outside, with these inputs."""
        self._now = _ClockedMoment(next_event, due, in_event_mode, wanted)

    def entered(self, status: int) -> None:
        """Take note of how entering event mode went."""
        self._check(status, "enter event mode")

    def left(self, status: int) -> None:
        """Take note of how leaving it went."""
        self._check(status, "enter step mode")

    def updated(self, status: int, time: float) -> None:
        """Take note of how the update of discrete states at a time [s] went."""
        self._check(status, f"update its discrete states at t = {time:g} s")

    def ends(self, time: float) -> NoReturn:
        """Say that it asks to stop at a time [s]."""
        raise FmuEnded(self.name, str(EarlyStop(time, True)))

    def told(self, time: float, reference: int, interval: float) -> None:
        """Take note of an interval that it gives for a clock at a time [s]."""
        if problem := self._ticker.amiss(reference, interval):
            self.lost(time, problem)

    def lost(self, time: float, problem: str) -> NoReturn:
        """Say that what it tells of a clock at a time [s] cannot be."""
        raise self._failure(f"tick at t = {time:g} s", problem, "correct its description or the FMU")

    def unsettled(self, time: float) -> NoReturn:
        """Say that an event at a time [s] does not end."""
        problem = f"the event does not end in {_MOST_TURNS} iterations"
        raise self._failure(f"tick at t = {time:.9g} s", problem, "ask its supplier for a model that settles")

    def crowded(self, time: float) -> NoReturn:
        """Say that there are too many events at a time [s]."""
        problem = f"{_MOST_EVENTS} events at one time"
        raise self._failure(f"tick at t = {time:.9g} s", problem, "ask its supplier for a model that settles")

    def flooded(self, time: float) -> NoReturn:
        """Say that a step has too many events, of which a time [s] is that of the last."""
        problem = f"more than {_MOST_IN_STEP:,} events in one step"
        raise self._failure(
            f"tick at t = {time:.9g} s", problem, "shorten the communication step, or see to its clocks"
        )

    def stuck(self, time: float, duration: float) -> NoReturn:
        """Say that a step from a time by a duration [s] ended early for nothing, or where it cannot have come to."""
        reached = self._fmi.reached.value
        why = "without an event and without getting on" if reached == time else "which is not within it"
        problem = f"returned early at t = {reached:g} s, {why}"
        raise self._failure(stepping(time, duration), problem, "ask its supplier for a repaired one")

    @property
    def _next_event(self) -> float:
        """Time of the next event that is known, of its own, by a clock or from another component [s]."""
        return min(self._ticker.next, self._now.next_event)

    def _advance(self, now: float, target: float, together: float) -> float:
        """Step to a time, or to where the FMU returns before, which with an event may be at once; the time that it
        reached [s]."""
        status = self._fmi.step(now, target - now)
        event, asked, early = (flag.value for flag in self._fmi.flags)
        if status or asked:
            self.stepped(status, now, target - now)
        reached = self._fmi.reached.value if early else target
        if not ((reached > now or (event and reached >= now - together)) and reached <= target + together):
            self.stuck(now, target - now)
        self._now.due = self._now.due or event
        return min(reached, target)

    def _event(
        self, time: float, ticking: frozenset[int], brought: Mapping[int, float] = NOTHING, beginning: bool = False
    ) -> None:
        """Iterate an event to its end, with these clocks ticking, and go on in step mode.

        In each turn: clocks are set, then the inputs, then output clocks and outputs are read, then discrete states
        are updated, which ends the ticks; then intervals are asked for. A countdown of 0 s ticks in the next turn.
        """
        now = self._now
        now.due, now.next_event = False, math.inf
        values = [brought.get(place, value) for place, value in enumerate(now.wanted)]
        arriving = self._mail.arriving()
        ticking |= self._ticker.references(arriving)
        self._enter_event_mode()
        for _ in range(_MOST_TURNS):
            names = self._ticker.activate(ticking)
            for part in () if beginning else self._parts:  # then the initialisation has set them
                if not part.clocks or part.clocks & names:
                    self.put(part, values)
            for clock, given in arriving.items():
                self._check(self._group(*self._mail.incoming[clock]).write(given), f"set what comes with {clock}")
            arriving = {}
            self._send(time, names | self._ticker.tell(time, self.read))
            status, news = self._fmi.update()
            if status:
                self.updated(status, time)
            if problem := self._ticker.learn(time, ticking, beginning):
                self.lost(time, problem)
            if news.ending:
                self.ends(time)
            ticking = frozenset() if beginning else self._ticker.at_once(time)
            if not news.again and not ticking:
                break
        else:
            self.unsettled(time)
        now.next_event, now.due = news.next_event, bool(self._mail.waiting)
        self.left(self._fmi.call("EnterStepMode"))
        now.in_event_mode = False

    def _send(self, time: float, ticking: frozenset[str]) -> None:
        """Have those variables go out whose clocks tick."""
        for clock, variables in self._mail.outgoing.items():
            if clock in ticking:
                status, values = self._group(*variables).taken()
                self._check(status, f"get what goes out with {clock}")
                self._mail.sent.append(Post(time, clock, values))

    def put(self, part: InputPart, values: Sequence[float]) -> None:
        """Set some of the bound inputs, out of the values of all."""
        try:
            status = part.write(values)
        except (ValueError, OverflowError) as error:
            raise self._failure("set inputs", str(error)) from None
        if status:
            self.written(status)

    def _enter_event_mode(self) -> None:
        if not self._now.in_event_mode:
            self.entered(self._fmi.call("EnterEventMode"))
            self._now.in_event_mode = True
