"""A run stepped at the pace of the clock, that can be changed meanwhile; its result is one like any other."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from fractions import Fraction

from fmus.errors import BusError, FmuEnded, FmuError
from orchestrator.engine import Interrupted, LiveRun, Result, Run, RunFailed, Simulation, Sink
from orchestrator.live.steering import Steering
from orchestrator.progress import Figures, Progress
from orchestrator.realtime.deadlines import Deadlines
from orchestrator.realtime.pacing import Pace, quiet
from orchestrator.realtime.stopping import Stop, stop_requests
from orchestrator.trace import FloatArray, Trace, joined

_LEAD = 0.02  # from the end of all preparations to the first step [s]
_REPORTS = 0.1  # between two reports of progress [s]
_FLUSHES = 1.0  # from one passing on of the record to the next [s]
SHOWN = 6  # outputs whose values are shown while it runs


@dataclass(frozen=True)
class Paced:
    """Runs simulations in real time.

    Attributes:
        stepping: what lasts for as long as steps are taken; it gives what is told before each how late it is [s].
    """

    steering: Steering
    stepping: Callable[[], AbstractContextManager[Callable[[float], None]]] = lambda: nullcontext(lambda lateness: None)

    def execute(self, simulation: Simulation, run: Run, sink: Sink | None = None) -> Result:
        """The result of a run, with what was changed meanwhile and how the deadlines were kept.

        Raises:
            InputError: a value, or what may be changed, does not fit; nothing was stepped.
            Interrupted: it was told to end; it carries the result up to there.
            RunFailed: an FMU, or a bus that it is on, failed while stepping; it carries that, too.
        """
        pieces: list[Trace] = []
        stimuli = simulation.driven(run.stimuli, len(simulation.instants()))
        first = replace(run, stimuli={name: values[:1] for name, values in run.stimuli.items()})
        recorded = list(simulation.outputs if run.record is None else run.record)
        shown = [name for name in simulation.outputs if name in recorded][:SHOWN]
        with stop_requests() as stop:
            live = simulation.live(first, shown, sink or pieces.append, self.steering.tuned)
            going = _Going(live, simulation.timing.step, stimuli, stop)
            failure: FmuError | BusError | None = None
            with self.steering.begun(live, float(simulation.timing.step)) as requests, quiet():
                try:
                    with self.stepping() as begins:
                        going.through(begins, requests.make, self.steering.progress)
                except (FmuError, BusError) as error:
                    failure = error
            result = live.result()
        ended = str(failure) if isinstance(failure, FmuEnded) else ""
        result = replace(result, ended=ended, deadlines=going.deadlines)
        if pieces:
            result = replace(result, trace=joined(pieces))
        if stop.requested:
            raise Interrupted(result)
        if failure is not None and not ended:
            raise RunFailed(failure, result) from failure
        return result


class _Going:
    """A run under way, paced.

    Args:
        step: between two beginnings of steps [s].
        stimuli: (K, s) values from each step on.
    """

    def __init__(self, live: LiveRun[Result], step: Fraction, stimuli: FloatArray, stop: Stop) -> None:
        self._live, self._step, self._stimuli, self._stop = live, step, stimuli, stop
        self.deadlines = Deadlines(float(step))

    def through(self, begins: Callable[[float], None], change: Callable[[], None], progress: Progress) -> None:
        """Step to the end, or until it is told to end.

        Args:
            begins: told before each step how late it is [s].
            change: makes changes, before each step.

        Raises:
            FmuError: an FMU fails, or asks to stop.
            BusError: a bus that it is on fails.
        """
        live, deadlines, last = self._live, self.deadlines, len(self._stimuli) - 1
        reports, flushes = (max(1, round(seconds / float(self._step))) for seconds in (_REPORTS, _FLUSHES))
        start = time.monotonic() + _LEAD
        pace = Pace(start, self._step)
        for number, given in enumerate(self._stimuli[:-1]):
            deadline = pace.deadline(number)
            now = pace.wait(deadline, self._stop)
            if self._stop.requested:
                return
            deadlines.begun(now - deadline)
            begins(now - deadline)
            live.given[:] = given
            change()
            live.step()
            deadlines.work.add(time.monotonic() - now)
            if number % flushes == 0:
                live.flush()
            if number % reports == 0:
                progress(number / last, self._told(number, now - start))
        live.given[:] = self._stimuli[-1]

    def _told(self, number: int, elapsed: float) -> Figures:
        """How it goes after so many steps and so long [s]."""
        step, deadlines = float(self._step), self.deadlines
        figures = {
            **deadlines.going(number * step, elapsed, (len(self._stimuli) - 1) * step),
            "late steps": deadlines.late,
        }
        told = ", ".join(f"{value:g} {name}" for name, value in figures.items())
        return Figures.of(f"{number * step:.1f} s, {told}", figures)
