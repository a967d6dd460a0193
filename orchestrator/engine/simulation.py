"""A system that is instantiated once and run as often as wanted, with other parameters and stimuli each time."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cached_property
from time import perf_counter
from typing import NamedTuple

import numpy as np

from fmus.errors import BusError, FmuEnded, FmuError, WiringError
from fmus.words import listed
from orchestrator.engine.account import Account
from orchestrator.engine.compiled import Engine
from orchestrator.engine.given import GivenValues
from orchestrator.engine.initialisation import initialise
from orchestrator.engine.iterated import IteratedLoop, check_control
from orchestrator.engine.live import FARTHEST, HELD, LiveRun
from orchestrator.engine.loop import Loop, Stepper
from orchestrator.engine.planning.plan import Plan, make_plan
from orchestrator.engine.planning.tangents import NOTHING, Carried, Sensitivities, carried
from orchestrator.engine.preparation import PreparedLoops
from orchestrator.engine.recording import ROWS, Recorder, Sink, require_room
from orchestrator.engine.run import Interrupted, Result, Run, RunFailed, Timing
from orchestrator.engine.tuned import Tuned
from orchestrator.fmi.component import Component
from orchestrator.fmi.interface import Value
from orchestrator.network.carriers import CanBus
from orchestrator.processes.interrupts import requested
from orchestrator.rational import clock, multiples, written
from orchestrator.settable import settable
from orchestrator.system import Endpoint, System
from orchestrator.trace import FloatArray, Trace

LOG = logging.getLogger("servotwin.engine")
_WIDE, _EXACT = ("Int64", "UInt64"), 2.0**53


class _Done(NamedTuple):
    """A run that is over: its record, its loop, why that was Python's, and how long the steps took [s]."""

    recorder: Recorder
    loop: Loop
    reason: str
    spent: float
    ended: str = ""


class Simulation:
    """Instances of a system's components; a context manager that frees them.

    Attributes:
        outputs: component.variable of all outputs that are numbers.
        texts: of those that are texts.
        stimuli: component.input of the stimuli that a run needs, sorted.

    Raises (on entering or running):
        WiringError: values or times that do not fit the system.
        FmuError: an FMU failed.
    """

    def __init__(self, system: System, components: Mapping[str, Component], timing: Timing) -> None:
        self.system = system
        self.components = dict(components)
        self.timing = timing
        self.plan: Plan = make_plan(system, timing.step, timing.order, timing.cycles)
        if timing.control is not None:
            check_control(system, timing.control, timing.step)
        self._preparation = PreparedLoops(system, self.components, timing, self.plan)
        self.outputs, self.stimuli = self._preparation.outputs, self._preparation.stimuli
        self.texts = tuple(
            f"{name}.{port.name}"
            for name, part in system.parts.items()
            for port in part.interface.of("output")
            if port.recordable and not port.numeric
        )
        self._every = multiples(timing.step, self.plan.tick, "step")  # ticks of a communication step
        self._buses = {name: one for name, one in components.items() if isinstance(one, CanBus)}
        self._given = GivenValues(system, self.stimuli)
        self._fresh = True
        self._counts: dict[tuple[int, int], int] = {}
        self._carried = NOTHING  # of the latest run that carried tangents
        self._rounded: dict[str, None] = {}  # what is, of the record of this run

    def instants(self) -> FloatArray:
        """(K,) the communication instants, at which stimuli are wanted and rows recorded [s]."""
        count = self._steps(self.timing.stop) + 1
        require_room(count, 1 + len(self.stimuli))
        return clock(self.timing.start, self.timing.step).times(0, count)

    def check_record(self, names: Iterable[str]) -> None:
        """See that each name is a variable that a trace can hold: a number, or a text.

        Raises:
            WiringError: one is not; the message names it.
        """
        self._preparation.check_record(names)

    def check_values(self, values: Mapping[str, Value]) -> None:
        """See that a run can be given these values.

        Raises:
            WiringError: it cannot; the message names one.
        """
        self._given.values(values)

    def run(
        self,
        values: Mapping[str, Value] | None = None,
        stimuli: Mapping[str, FloatArray] | None = None,
        record: Iterable[str] | None = None,
        progress: Callable[[float], None] | None = None,
        stop: Fraction | None = None,
        record_every: int = 1,
        sink: Sink | None = None,
    ) -> Result:
        """Run from start to stop.

        Args:
            values: component.variable -> parameter or start value; the others have the FMU's defaults.
            stimuli: component.input -> (K,) value from each communication instant on, at least until `stop`.
            record: component.variable that are numbers or texts; None takes all outputs that are numbers.
            progress: called now and then with the fraction done.
            stop: end of this run, at most the timing's [s].
            record_every: communication steps from one row of the record to the next, counted from the start.
            sink: is given the record in pieces, in order, instead of the result's trace.

        Raises:
            Interrupted: a KeyboardInterrupt came while stepping; it carries the result up to there.
            RunFailed: an FMU failed while stepping; it carries that, too.
        """
        return self.execute(Run(values or {}, stimuli or {}, record, stop, record_every), progress, sink)

    def execute(self, run: Run, progress: Callable[[float], None] | None = None, sink: Sink | None = None) -> Result:
        """The result of a run; see `run`."""
        return self._result(self._executed(run, progress, sink))

    def rows(self, run: Run) -> FloatArray:
        """(K, n) what a run records, a column a variable in the order of `run.record`, without anything around it.

        Raises:
            FmuEnded: an FMU asked to stop before it was over.
        """
        return self._whole(run)

    def sensitivities(self, run: Run, by: Sequence[str]) -> Sensitivities:
        """What `rows` gives, with its exact derivatives by parameters and start values, in the same run.

        Args:
            by: component.variable of each.

        Raises:
            WiringError: one of them is nothing that can be set.
            TangentsMissing: an FMU that these values reach carries no tangents, or not along one of them.
            FmuError: the run failed, or a derivative is not finite.
        """
        if self._carried.by != tuple(by):
            for name in by:
                settable(self.system, name)
            self._carried = carried(self.system, self.plan, by)
        chosen = self.outputs if run.record is None else tuple(dict.fromkeys(run.record))
        return self._carried.parted(chosen, self._whole(run, self._carried))

    def _whole(self, run: Run, along: Carried = NOTHING) -> FloatArray:
        done = self._executed(run, along=along)
        if done.ended:
            raise FmuEnded(done.ended, "before the run was over", "shorten it")
        return done.recorder.kept()

    def _executed(
        self,
        run: Run,
        progress: Callable[[float], None] | None = None,
        sink: Sink | None = None,
        along: Carried = NOTHING,
    ) -> _Done:
        stop = self.timing.stop if run.stop is None else run.stop
        steps, every = self._steps(stop), self._every
        if run.record_every < 1:
            raise WiringError("record_every", f"is {run.record_every}", "give 1 or more")
        own, stimuli = self._given.values(run.values), self.driven(run.stimuli, steps + 1)
        self._reset()
        along.begin(self.components)
        prepared, count = self._preparation.loop(run.record, (), every, along), steps // run.record_every + 1
        if sink is None:
            require_room(count, len(prepared.columns.places))
        else:
            sink = self._noting(sink)
        loop = prepared.loop
        loop.begin(stimuli)
        engine, reason = prepared.steppers.chosen(steps * every)
        initialise(self.system, self.components, self.timing, engine, loop, own, stop)
        recorder = Recorder(prepared.columns, loop.time, every * run.record_every, count, sink)
        begun, end = perf_counter(), None
        try:
            _step(engine, steps * every, recorder, progress)
            engine.finish()
            if steps % run.record_every == 0:
                loop.record(recorder)
            recorder.empty(loop.recorded)
        except (KeyboardInterrupt, FmuError, BusError) as early:
            end = early
            engine.finish()
            if not isinstance(end, KeyboardInterrupt) and loop.tick % recorder.every == 0:
                loop.record(recorder, begun=True)
            recorder.empty(loop.recorded)
        done = _Done(recorder, loop, reason, perf_counter() - begun, str(end) if isinstance(end, FmuEnded) else "")
        if end is not None and (requested() or isinstance(end, KeyboardInterrupt)):
            raise Interrupted(self._result(done)) from None
        self._terminate()
        if end is not None and not done.ended:
            raise RunFailed(end, self._result(done)) from end
        return done

    def live(self, run: Run, outputs: Sequence[str], sink: Sink, tuned: Iterable[str] | None = ()) -> LiveRun[Result]:
        """A run that is stepped from outside, without an end; `run` has one value of each stimulus to begin with.

        Args:
            outputs: component.output whose values are wanted after each step.
            sink: is given the record in pieces, in order.
            tuned: component.variable of what may be changed between steps, None for all that can be.
        """
        changing = Tuned(self.system, self.components, tuned)
        if run.record is not None:
            run = replace(run, record=[name for name in run.record if name not in changing.ports])
        own, stimuli = self._given.values(run.values), self.driven(run.stimuli, 1)
        self._reset()
        prepared = self._preparation.loop(run.record, outputs, HELD)
        loop = prepared.loop
        loop.begin(stimuli)
        engine, reason = prepared.steppers.chosen(FARTHEST)
        initialise(self.system, self.components, self.timing, engine, loop, own, None)
        changing.begin()
        every, slots, noting = self._every * run.record_every, prepared.slots, self._noting(sink)
        recorder = Recorder(prepared.columns, loop.time, every, ROWS, lambda piece: noting(changing.beside(piece)))

        def conclude(spent: float) -> Result:
            self._terminate()
            return replace(self._result(_Done(recorder, loop, reason, spent)), changes=tuple(changing.changes))

        read = [
            (name, slots[name], e.variable in self.plan.instant[e.component])
            for name in outputs
            for e in [Endpoint.parse(name)]
        ]
        return LiveRun(
            loop,
            engine,
            recorder,
            self._every,
            self.stimuli,
            read,
            conclude,
            changing,
        )

    def driven(self, stimuli: Mapping[str, FloatArray], count: int) -> FloatArray:
        """(count, s) the stimuli side by side, in the order of `stimuli`.

        Raises:
            WiringError: others are wanted, or they are too short or not finite.
        """
        return self._given.driven(stimuli, count)

    def close(self) -> None:
        """Free all components."""
        for component in self.components.values():
            component.close()

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _steps(self, stop: Fraction) -> int:
        """Number of communication steps until a time [s]."""
        key = stop.numerator, stop.denominator
        if key not in self._counts:
            start, step = self.timing.start, self.timing.step
            if not start < stop <= self.timing.stop:
                raise WiringError(
                    "stop",
                    f"{written(stop)} s is not after {written(start)} s and up to {written(self.timing.stop)} s",
                    "choose a time between",
                )
            self._counts[key] = multiples(stop - start, step, "stop - start" if start else "stop")
        return self._counts[key]

    def _reset(self) -> None:
        """Have the components where a run begins; what is prepared is void where one was loaded anew."""
        fresh, self._fresh = self._fresh, False
        self._rounded = {}
        moved = [component.reset() for component in self.components.values() if not fresh]
        if any(moved):
            self._preparation.clear()

    def _terminate(self) -> None:
        for component in self.components.values():
            component.terminate()

    def _noting(self, sink: Sink) -> Sink:
        """What passes pieces of the record on, once it was noted what of them is rounded."""

        def pass_on(piece: Trace) -> None:
            self._note_rounded(piece)
            sink(piece)

        return pass_on

    def _note_rounded(self, trace: Trace) -> None:
        """Take note of whole numbers that doubles do not hold."""
        wide = [name for name in trace.names if name in self._wide and name not in self._rounded]
        self._rounded |= dict.fromkeys(name for name in wide if bool(np.any(np.abs(trace[name]) >= _EXACT)))

    @cached_property
    def _wide(self) -> frozenset[str]:
        """Variables whose numbers may be beyond what doubles hold."""
        parts = self.system.parts.items()
        return frozenset(f"{n}.{p.name}" for n, one in parts for p in one.interface.ports.values() if p.type in _WIDE)

    def _result(self, done: _Done) -> Result:
        loop, reason = done.loop, done.reason
        trace = done.recorder.trace()
        self._note_rounded(trace)
        if self._rounded:
            LOG.warning("%s: whole numbers beyond 2^53 are rounded, as doubles are", listed([*self._rounded]))
        return Result(
            trace,
            {node.component.name: node.statistics for node in loop.nodes},
            {name: getattr(component, "warnings", 0) for name, component in self.components.items()},
            loop.iterations,
            Account(
                engine=Engine.PYTHON if reason else Engine.COMPILED,
                reason=reason,
                steps=loop.tick // self._every,
                step=float(self.timing.step),
                start=float(self.timing.start),
                reached=loop.time(loop.tick),
                seconds=done.spent,
                taken=loop.taken if isinstance(loop, IteratedLoop) and loop.iteration.control else None,
            ),
            done.ended,
            carried={name: bus.carried() for name, bus in self._buses.items()},
            intermediate={
                name: kept
                for name, component in self.components.items()
                if (kept := getattr(component, "intermediate", None)) is not None
            },
        )


def _step(engine: Stepper, ticks: int, recorder: Recorder, progress: Callable[[float], None] | None) -> None:
    """Take all ticks, passing the rows on whenever there is no place for more."""
    while engine.tick < ticks:
        engine.advance(ticks, recorder)
        if recorder.full(engine.recorded):
            recorder.empty(engine.recorded)
        if progress is not None:
            progress(engine.tick / ticks)
