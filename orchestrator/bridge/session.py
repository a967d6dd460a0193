"""A system in real time on a bus, from its first step to its last and to the safe values at the end."""

from __future__ import annotations

import itertools
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

from fmus.errors import BusError, FmuError, ServotwinError
from orchestrator.bridge.bus.keeper import Keeper
from orchestrator.bridge.bus.traffic_report import TrafficReport
from orchestrator.can.live.news import News
from orchestrator.engine import LiveRun, Result
from orchestrator.processes.interrupts import endings, handling
from orchestrator.progress import Figures, Progress
from orchestrator.realtime.deadlines import Deadlines
from orchestrator.realtime.pacing import Pace
from orchestrator.realtime.stopping import Stop
from orchestrator.trace import FloatArray

LOG = logging.getLogger("servotwin.can")
_LEAD = 0.02  # from the end of all preparations to the first step [s]
_FLUSHES = 1.0  # from one passing on of the record to the next [s]
_REPORTS = 0.1  # between two reports of progress [s]


@dataclass(frozen=True)
class Course:
    """How long to go on, and what drives inputs besides the bus.

    Attributes:
        steps: None: until told to end.
        endures: whether it goes on without a bus, as a machine would.
        received: numbers of the inputs that are received.
        give_up: how late a step may be [s].
        stimuli: (K, m) values from each step on, the last one for good; `columns` says of which inputs.
    """

    steps: int | None
    endures: bool
    stimuli: FloatArray
    columns: list[int]
    received: list[int]
    give_up: float


@dataclass(frozen=True)
class Ending:
    """How a session ended: by itself, told to, or by a failure; after how long [s]; what had passed over the bus."""

    stopped: bool
    failure: ServotwinError | None
    elapsed: float
    report: TrafficReport


class Session:
    """Steps a live run in real time.

    Args:
        unkept: why the record cannot be kept, None while it can.
        change: makes the changes that are asked for, before each step.

    Attributes:
        deadlines: how they were kept.
    """

    def __init__(
        self,
        live: LiveRun[Result],
        keeper: Keeper,
        step: Fraction,
        course: Course,
        place: str,
        unkept: Callable[[], ServotwinError | None] = lambda: None,
        change: Callable[[], None] = lambda: None,
    ) -> None:
        self._live, self._keeper, self._step, self._course, self._place = live, keeper, step, course, place
        self._unkept, self._change = unkept, change
        self.deadlines = Deadlines(float(step))
        self._news = News(lambda line: LOG.warning("%s: %s", place, line))

    def run(self, stop: Stop, progress: Progress) -> Ending:
        """Go on to the end; whatever it is, the safe values are sent."""
        failure: ServotwinError | None = None
        stopped = False
        start = time.monotonic() + _LEAD
        try:
            self._keeper.begin(start)
            stopped = self._go(start, stop, progress)
        except ServotwinError as error:
            failure = error
        except KeyboardInterrupt:
            stopped = stop.interrupted = True
        with handling(lambda *_: None, endings()):  # too late for another wish
            elapsed = max(time.monotonic() - start, 0.0)
            report = self._keeper.end()
        stopped = stopped or (report.stopped and failure is None)
        return Ending(stopped, failure or self._failure(report, elapsed), elapsed, report)

    def _status(self, now: float) -> Figures:
        """How it goes; late steps are also said, seldom enough."""
        late = {"late steps": self.deadlines.late, "steps late by more than a step": self.deadlines.overrun}
        self._news.look(now, lambda: late)
        status, step = self._keeper.status(now), float(self._step)
        whole = None if self._course.steps is None else self._course.steps * step
        going = self.deadlines.going(self._live.steps * step, now, whole)
        told = {what: count for what, count in late.items() if count}
        words = [f"{value:,g} {what}" for what, value in {**going, **told}.items()]
        line = ", ".join([f"{now:.0f} s", *filter(None, [status]), *words])
        return Figures.of(line, {**status.values, **going, **told})

    def _failure(self, report: TrafficReport, elapsed: float) -> ServotwinError | None:
        """What was wrong that did not end it by itself."""
        if report.trouble and not self._course.endures:
            problem = f"failed at t = {elapsed:.3f} s ({report.trouble})"
            return BusError(self._place, problem, "see to the adapter and the wiring")
        if report.unconfirmed and not report.trouble:
            return BusError(self._place, report.doubt(), "stop the machine by hand")
        if report.over and not report.stopped:
            return BusError(self._place, f"{report.over} (t = {elapsed:.3f} s)", "see to who sends it")
        if report.odd:
            name, count = next(iter(report.odd.items()))
            return FmuError(name, f"was not finite in {count:,} steps", "see to its inputs and parameters")
        return None

    def _go(self, start: float, stop: Stop, progress: Progress) -> bool:
        """Step until the course or the bus ends; True where it was told to end before.

        Raises:
            BusError: steps are too late for too long.
            RecordError: the disk takes no more.
        """
        pace = Pace(start, self._step)
        live, keeper, deadlines, course = self._live, self._keeper, self.deadlines, self._course
        reports, flushes = (max(1, round(seconds / float(self._step))) for seconds in (_REPORTS, _FLUSHES))
        last = len(course.stimuli) - 1
        for number in itertools.count():
            deadline = pace.deadline(number)
            now = pace.wait(deadline, stop)
            if number == course.steps or keeper.ends(course.endures):
                break
            if stop.requested:
                return True
            deadlines.begun(now - deadline)
            if now - deadline > course.give_up and not course.endures:
                problem = f"steps are {now - deadline:.3g} s late at t = {deadline - start:.3f} s"
                raise BusError(self._place, problem, "give it a faster machine, or a longer step")
            if course.columns:
                live.given[course.columns] = course.stimuli[min(number, last)]
            live.given[course.received] = keeper.inputs(now - start)[course.received]
            self._change()
            live.step()
            keeper.send(number, live.outputs, now - start, deadline - start)
            deadlines.work.add(time.monotonic() - now)
            if number % flushes == 0:
                live.flush()
                if unkept := self._unkept():
                    raise unkept
            if number % reports == 0:
                progress(number / course.steps if course.steps else 0.0, self._status(now - start))
        return False
