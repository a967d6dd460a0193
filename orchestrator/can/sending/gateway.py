"""A gateway: what comes from one bus goes onto another as it is, at once or not at all.

Frames that a full or lost bus keeps waiting are dropped and counted: what is sent late would be an old command. What
was sent here is never sent back.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from copy import copy
from dataclasses import dataclass

import can

from fmus.errors import BusError, InputError
from orchestrator.can.database.bus import load_all
from orchestrator.can.database.sources import DatabaseFiles
from orchestrator.can.live.backlog import Backlog
from orchestrator.can.live.bus import BusSettings
from orchestrator.can.live.line import SendingLine
from orchestrator.can.live.link import linked
from orchestrator.can.live.news import ErrorStates, News
from orchestrator.can.live.receiver import Receiver
from orchestrator.can.sending.passed import Passed, PassedFrames
from orchestrator.can.sending.routes import BOTH, RENAMED, TOO_MANY, Routes
from orchestrator.can.sending.safe_end import NOTHING, Last, SafeEnd, frame_text
from orchestrator.can.sending.selection import EVERYTHING, MessageSelection
from orchestrator.can.slcan.flow import Key
from orchestrator.can.statistics import identifier_text
from orchestrator.processes.interrupts import endings, handling
from orchestrator.progress import Figures, Progress, silent
from orchestrator.realtime.pacing import quiet
from orchestrator.realtime.stopping import Stop, stop_requests

LOG = logging.getLogger("servotwin.can")
QUEUE = 4096  # frames of a bus that wait to be passed at most
_REFUSING = 0.2  # for which an adapter may refuse all frames [s]
_WAITING = 0.1  # for which a frame may wait for a full bus, or to be seen [s]
_ROOM = 0.005  # for which an adapter may have no room, once; until it takes a frame again it is not waited for [s]
_PERIOD = 0.25  # between two looks how it goes [s]
_NAP = 0.02  # without frames, between two looks whether to end [s]
_CONFIRMING, _LOOK = 1.0, 0.005  # the longest time for the last frames to get out, and between two looks [s]
_LINGERING = 0.05  # before a bus is left: adapters forget what they have not sent by then [s]
TOO_LONG = "it is of CAN FD, and the other bus is classic"
REMEDY = "see that the adapter is plugged in, and that somebody listens; --reconnect waits for it"


@dataclass(frozen=True)
class Gateway:
    """What passes between two buses.

    Attributes:
        buses: from the first to the second, and back unless it is `one_way`.
        database: of the buses, for messages by name; its text in this `encoding`, or what it seems to be.
        chosen: messages that are passed, all by default.
        renamed: `OLD=NEW`, identifiers of the first bus that are others on the second.
        duration: None: until it is told to end [s].
        last: what is sent last, however it ends; whole frames on both buses.

    Raises:
        InputError: these are not two buses.
    """

    buses: tuple[BusSettings, ...]
    database: DatabaseFiles | None = None
    encoding: str | None = None
    chosen: MessageSelection = EVERYTHING
    renamed: Sequence[str] = ()
    one_way: bool = False
    duration: float | None = None
    last: Last = NOTHING

    def __post_init__(self) -> None:
        if len(self.buses) != 2:
            raise InputError("gateway", f"is given {len(self.buses)} of two buses", "give --channel twice")
        if self.buses[0].place == self.buses[1].place:
            raise InputError(self.buses[0].place, "is to be both buses", "give another --channel")

    @property
    def places(self) -> str:
        """Both buses, in words."""
        return " and ".join(bus.place for bus in self.buses)


def gateway(plan: Gateway, progress: Progress = silent, ready: Callable[[], None] = lambda: None) -> Passed:
    """Pass frames until the duration is over, Ctrl-C or SIGTERM comes, or a bus is lost for good; what passed.

    Args:
        progress: told the share of the duration (0 where there is none), and how it is going.
        ready: called when every frame from now on will be passed.

    Raises:
        InputError: a name or value is not possible, or a database cannot be read.
        BusError: an adapter does not open, failed, or what is sent last may not have got out.
    """
    log = None if plan.database is None else load_all(plan.database, plan.encoding)
    names = {number: bus.channel for number, bus in enumerate(plan.buses)}
    routes, end = Routes(plan.chosen, log, names, plan.renamed, plan.one_way), SafeEnd(plan.last, log)
    came = threading.Event()
    with quiet(), stop_requests() as stop, _lines(plan.buses, came.set) as lines:
        work = _Work(plan, lines, routes, end)
        ready()
        try:
            work.go_on(stop, came, progress)
        finally:
            with handling(lambda number, frame: None, endings()):
                unsent = work.end()
        done = work.report()
    if work.lost:
        passed = " and ".join(f"{way.out:,}" for way in done.ways)
        raise BusError(work.lost, f"{passed} frames had passed{unsent and ', '}{unsent}", REMEDY)
    if unsent:
        raise BusError(plan.places, f"ended, {unsent}", "stop the machine otherwise")
    return done


@contextmanager
def _lines(buses: Sequence[BusSettings], arrived: Callable[[], None]) -> Iterator[list[SendingLine]]:
    """The open buses."""
    with ExitStack() as stack:
        lines = []
        for bus in buses:
            link = stack.enter_context(linked(bus, _REFUSING, lambda line: LOG.warning("%s", line)))
            receiver = stack.enter_context(Receiver(link, QUEUE, arrived, _WAITING))
            lines.append(SendingLine(link, receiver, Backlog(bus), _WAITING, bus.place))
        yield lines


class _Work:
    """A gateway while it runs.

    Attributes:
        lost: which bus is lost for good, and why; "" while none is.
    """

    def __init__(self, plan: Gateway, lines: Sequence[SendingLine], routes: Routes, end: SafeEnd) -> None:
        self._plan, self._lines, self._routes, self._end = plan, lines, routes, end
        there, back = (bus.place for bus in plan.buses)
        self._ways = PassedFrames(there, back), PassedFrames(back, there)
        self._done = Passed(self._ways)
        self._states, self._said = ErrorStates(), set[tuple[int, Key]]()
        self._crowded = [False, False]
        self._begun = time.monotonic()
        self._until = math.inf if plan.duration is None else plan.duration
        self._news = News(lambda line: LOG.warning("%s: %s", plan.places, line))
        self._last: list[Counter[Key]] = [Counter(), Counter()]
        self.lost = ""

    def go_on(self, stop: Stop, came: threading.Event, progress: Progress) -> None:
        """Pass what comes."""
        told = 0.0
        while not stop.requested and not self.lost and self._elapsed < self._until:
            came.wait(_NAP)
            came.clear()
            self._pass_all()
            if self._elapsed - told >= _PERIOD:
                told = self._elapsed
                self._tell(progress)
        self._pass_all()

    def end(self) -> str:
        """Send what goes last, and see that all gets out; in words what may not have."""
        until = time.monotonic() + _CONFIRMING
        frames = self._end.frames(len(self._lines))
        for line in self._lines:
            line.link.persists = True
            line.fails()
        refused = [(number, frame) for number, frame in frames if not self._give_last(number, frame, until)]
        refused = [(number, frame) for number, frame in refused if not self._lines[number].link.insist(frame)]
        while (open_ := self._not_out(frames)) and time.monotonic() < until:
            time.sleep(_LOOK)
        for line in open_:
            line.link.stay()
        time.sleep(_LINGERING)
        waiting = [frame_text(one[1]) for one in frames if self._lines[one[0]] in open_ and one not in refused]
        said = [f"and was NOT followed by {', '.join(frame_text(frame) for _, frame in refused)}"] if refused else []
        why = " and ".join(f"{line.name} {_hindrance(line)}" for line in open_)
        return "; ".join(said + ([f"and {', '.join(waiting)} may not have got out: {why}"] if waiting else []))

    def report(self) -> Passed:
        """What has passed."""
        for way, line, last in zip(self._ways, reversed(self._lines), reversed(self._last), strict=True):
            way.out = max(min((line.link.out - last).total(), way.given.total()), 0)
        for way, line in zip(self._ways, self._lines, strict=True):
            way.dropped = line.receiver.dropped + line.receiver.late
        self._done.seconds, self._done.missing = round(self._elapsed, 3), self._routes.missing
        self._done.told = all(line.link.acknowledges for line in self._lines)
        return self._done

    @property
    def _elapsed(self) -> float:
        return time.monotonic() - self._begun

    def _pass_all(self) -> None:
        """Pass what has come, from either bus."""
        now = time.monotonic()
        for line in self._lines:
            if line.fills(now):
                LOG.warning("%s: is full: frames for it are dropped until it has room", line.name)
            trouble = line.link.trouble or str(line.receiver.failure or "")
            if trouble and not line.link.reopens:
                self.lost = self.lost or f"{line.name}: is lost ({trouble})"
        for number, line in enumerate(self._lines):
            messages = line.take()
            self._states.add(messages)
            for message in messages:
                if message.is_error_frame:
                    self._done.errors += 1
                else:
                    self._pass(message, number)

    def _pass(self, message: can.Message, bus: int) -> None:
        way, target = self._ways[bus], 1 - bus
        route = self._routes.of(message, bus)
        if route.key is None:
            self._leave_out(message, bus, route.why)
            return
        if message.is_fd and not self._plan.buses[target].fd:
            self._leave_out(message, bus, TOO_LONG)
            return
        line = self._lines[target]
        frame = copy(message)
        frame.arbitration_id, frame.is_extended_id = route.key
        frame.is_rx = False
        patience = 0.0 if self._crowded[target] else _ROOM
        taken = not line.full and line.give(frame, time.monotonic(), patience)
        self._crowded[target] = not taken
        if taken:
            way.given[route.name] += 1
            way.lateness.add(time.time() - message.timestamp)
            self._end.note(frame, target)
        else:
            way.unsent += 1

    def _leave_out(self, message: can.Message, bus: int, why: str) -> None:
        """Count a frame that is not passed; what nobody asked for is said the first time."""
        self._ways[bus].left_out[why] += 1
        key = message.arbitration_id, message.is_extended_id
        if why not in (BOTH, RENAMED, TOO_MANY, TOO_LONG) or (bus, key) in self._said or len(self._said) > QUEUE:
            return
        self._said.add((bus, key))
        LOG.warning("%s: %s is not passed: %s", self._lines[bus].name, identifier_text(*key), why)

    def _give_last(self, number: int, frame: can.Message, until: float) -> bool:
        now = time.monotonic()
        taken = self._lines[number].give(frame, now, max(until - now, 0.0))
        if taken:
            self._last[number][frame.arbitration_id, frame.is_extended_id] += 1
            self._done.last.append(frame_text(frame))
        return taken

    def _not_out(self, frames: Sequence[tuple[int, can.Message]]) -> list[SendingLine]:
        """The buses on which not all is that was given; where one has become full, or has refused the last frames, or
        nobody knows what became of them, they are given again."""
        now, open_ = time.monotonic(), list[SendingLine]()
        for number, line in enumerate(self._lines):
            line.take()
            filled, quiet, failed = line.fills(now), line.quiet(), line.fails()
            if filled or failed or not quiet:
                open_.append(line)
            if filled or failed:
                for frame in [frame for bus, frame in frames if bus == number]:
                    line.give(frame, now)
        return [line for line in open_ if not line.link.gone]

    def _tell(self, progress: Progress) -> None:
        lost = {
            f"frames lost to {line.name}": way.unsent + line.blocked
            for way, line in zip(self._ways, reversed(self._lines), strict=True)
        }
        dropped = {"frames dropped": sum(line.receiver.dropped + line.receiver.late for line in self._lines)}
        troubles = {**self._states.counts, "error frames": self._done.errors, **lost, **dropped}
        self._news.look(self._elapsed, lambda: troubles)
        there, back = (way.given.total() for way in self._ways)
        told = {what: count for what, count in troubles.items() if count}
        line = ", ".join([f"{there:,} there, {back:,} back", *(f"{count:,} {what}" for what, count in told.items())])
        share = 0.0 if self._plan.duration is None else min(self._elapsed / self._plan.duration, 1.0)
        progress(share, Figures.of(line, {"there": there, "back": back} | told))


def _hindrance(line: SendingLine) -> str:
    """Why what was given to a bus may not be on it."""
    if line.link.refusing:
        return "refuses frames"
    return "is full" if line.waits else "has stopped to answer"
