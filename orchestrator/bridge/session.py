"""A system in real time on a bus, from its first step to its last and to the safe values at the end."""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass
from fractions import Fraction

from fmus.errors import BusError, ServotwinError
from orchestrator.bridge.traffic import BusTraffic
from orchestrator.engine import LiveRun, Result
from orchestrator.progress import Progress
from orchestrator.realtime.deadlines import Deadlines
from orchestrator.realtime.pacing import Pace
from orchestrator.realtime.stopping import Stop
from orchestrator.trace import FloatArray

_LEAD = 0.02  # from the end of all preparations to the first step [s]
_LINGERING = 0.05  # before the bus may be closed: adapters forget what they have not sent by then [s]
_REPORTS = 0.1  # between two reports of progress [s]


@dataclass(frozen=True)
class Course:
    """How long to go on, and what drives inputs besides the bus.

    Attributes:
        steps: None: until told to end.
        endures: whether it goes on without a bus, as a machine would.
        stimuli: (K, m) values from each step on, the last one for good; `columns` says of which inputs.
    """

    steps: int | None
    endures: bool
    stimuli: FloatArray
    columns: list[int]


@dataclass(frozen=True)
class Ending:
    """How a session ended: by itself, told to, or by a failure; and after how long [s]."""

    stopped: bool
    failure: ServotwinError | None
    elapsed: float


class Session:
    """Steps a live run in real time.

    Attributes:
        deadlines: how they were kept.
    """

    def __init__(self, live: LiveRun[Result], traffic: BusTraffic, step: Fraction, course: Course, place: str) -> None:
        self._live, self._traffic, self._step, self._course, self._place = live, traffic, step, course, place
        self.deadlines = Deadlines(float(step))

    def run(self, stop: Stop, progress: Progress) -> Ending:
        """Go on to the end; whatever it is, the safe values are sent."""
        failure: ServotwinError | None = None
        stopped = False
        start = time.monotonic() + _LEAD
        try:
            stopped = self._go(start, stop, progress)
        except ServotwinError as error:
            failure = error
        except KeyboardInterrupt:
            stopped = stop.interrupted = True
        finally:
            elapsed = max(time.monotonic() - start, 0.0)
            self._traffic.send_safe_values()
            time.sleep(_LINGERING)
        if failure is None and self._traffic.trouble and not self._course.endures:
            failure = BusError(
                self._place,
                f"failed at t = {elapsed:.3f} s ({self._traffic.trouble})",
                "see to the adapter and the wiring",
            )
        return Ending(stopped, failure, elapsed)

    def _go(self, start: float, stop: Stop, progress: Progress) -> bool:
        """Step until the course or the bus ends; True where it was told to end before."""
        pace = Pace(start, self._step)
        live, traffic, deadlines, course = self._live, self._traffic, self.deadlines, self._course
        reports = max(1, round(_REPORTS / float(self._step)))
        last = len(course.stimuli) - 1
        for number in itertools.count():
            deadline = pace.deadline(number)
            now = pace.wait(deadline, stop)
            if number == course.steps or (traffic.trouble and not course.endures):
                break
            if stop.requested:
                return True
            deadlines.begun(now - deadline)
            if course.columns:
                live.given[course.columns] = course.stimuli[min(number, last)]
            traffic.receive(now - start, live.given)
            live.step()
            traffic.send(number, live.outputs)
            deadlines.work.add(time.monotonic() - now)
            if number % reports == 0:
                progress(number / course.steps if course.steps else 0.0, f"{now - start:.0f} s")
        return False
