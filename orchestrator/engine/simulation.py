"""A system that is instantiated once and run as often as wanted, with other parameters and stimuli each time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from time import perf_counter
from types import TracebackType
from typing import NamedTuple

import numpy as np

from fmus.errors import FmuEnded, FmuError, PartialError, ServotwinError, WiringError
from orchestrator.engine.account import Account
from orchestrator.engine.compiled import Engine, Steppers
from orchestrator.engine.live import FARTHEST, HELD, LiveRun
from orchestrator.engine.loop import Loop, Node, Statistics, Stepper
from orchestrator.engine.plan import REFUSED, CycleSettings, Order, Plan, make_plan
from orchestrator.engine.recording import ROWS, Columns, Recorder, Sink, require_room
from orchestrator.engine.tangents import NOTHING, Carried, Sensitivities, carried
from orchestrator.engine.tuned import Change, Tuned
from orchestrator.fmi.component import Component
from orchestrator.fmi.interface import Value
from orchestrator.interrupts import requested
from orchestrator.rational import clock, multiples, written
from orchestrator.realtime.deadlines import Deadlines
from orchestrator.system import Connection, Endpoint, Settable, System, recordable, settable
from orchestrator.trace import FloatArray, Trace


@dataclass(frozen=True)
class Timing:
    """When a run starts and stops and how it steps; exact times [s].

    Attributes:
        tolerance: relative tolerance that co-simulation FMUs are told, None for none.
        tell_stop: whether FMUs are told when the run stops; some then refuse to go beyond by a rounding error.
        finite: whether an output that is not finite ends the run.
    """

    stop: Fraction
    step: Fraction
    start: Fraction = Fraction(0)
    order: Order = Order.GAUSS_SEIDEL
    cycles: CycleSettings = REFUSED
    engine: Engine = Engine.AUTO
    tolerance: float | None = None
    tell_stop: bool = False
    finite: bool = True


@dataclass(frozen=True)
class Run:
    """What may differ from run to run of one system; see `Simulation.run`."""

    values: Mapping[str, Value] = field(default_factory=dict)
    stimuli: Mapping[str, FloatArray] = field(default_factory=dict)
    record: Iterable[str] | None = None
    stop: Fraction | None = None
    record_every: int = 1


@dataclass(frozen=True)
class Result:
    """What a run gave.

    Attributes:
        trace: the recorded variables, named component.variable, one row every so many communication steps; without
            rows where the record went to a sink.
        statistics: component -> calls and seconds.
        warnings: component -> number of warnings its FMU returned.
        iterations: steps of cycles that were taken and taken back.
        account: how it was stepped, and how far.
        ended: what an FMU said that asked to stop before the run was over; nothing where none did.
        changes: what was changed between steps, in order.
        deadlines: how they were kept by a run in real time.
    """

    trace: Trace
    statistics: Mapping[str, Statistics]
    warnings: Mapping[str, int]
    iterations: int
    account: Account
    ended: str = ""
    changes: Sequence[Change] = ()
    deadlines: Deadlines | None = None


class Interrupted(KeyboardInterrupt):
    """A run was interrupted; `result` is what it gave until then, to the last whole tick.

    From one process to another it travels as a plain KeyboardInterrupt.
    """

    def __init__(self, result: Result) -> None:
        super().__init__(f"interrupted at t = {result.account.reached:g} s")
        self.result = result

    def __reduce__(self) -> tuple[type, tuple[str]]:
        return KeyboardInterrupt, (str(self),)


class RunFailed(PartialError):  # noqa: N818 - as what interrupts it
    """An FMU failed while a run was stepped."""

    result: Result


class _Done(NamedTuple):
    """A run that is over: its record, its loop, why that was Python's, and how long the steps took [s]."""

    recorder: Recorder
    loop: Loop
    reason: str
    spent: float
    ended: str = ""


@dataclass(frozen=True)
class _Prepared:
    """What runs share that record the same.

    Attributes:
        loop: to be begun anew for each run.
        outputs: component -> outputs and other variables that are read.
        inputs: component -> inputs that are driven.
    """

    key: tuple[object, ...]
    loop: Loop
    columns: Columns
    outputs: Mapping[str, Sequence[str]]
    inputs: Mapping[str, Sequence[str]]
    steppers: Steppers

    def bind(self, components: Mapping[str, Component]) -> None:
        """Have the components carry these values."""
        for name, component in components.items():
            component.bind(self.inputs[name], self.outputs[name])

    @property
    def slots(self) -> dict[str, int]:
        """component.output -> its slot."""
        names = [f"{component}.{output}" for component, outputs in self.outputs.items() for output in outputs]
        return {name: slot for slot, name in enumerate(names)}


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
        self.outputs = tuple(
            f"{name}.{port.name}"
            for name, part in system.parts.items()
            for port in part.interface.of("output")
            if port.numeric
        )
        self.texts = tuple(
            f"{name}.{port.name}"
            for name, part in system.parts.items()
            for port in part.interface.of("output")
            if port.recordable and not port.numeric
        )
        self.stimuli = tuple(sorted(map(str, system.stimulated)))
        self._every = multiples(timing.step, self.plan.tick, "step")  # ticks of a communication step
        self._start = float(timing.start)
        self._inputs: dict[str, list[str]] = {name: [] for name in system.parts}  # component -> those that are driven
        for target in [link.target for link in system.connections] + [Endpoint.parse(name) for name in self.stimuli]:
            self._inputs[target.component].append(target.variable)
        self._driven_inputs = frozenset(f"{name}.{one}" for name, inputs in self._inputs.items() for one in inputs)
        self._fresh = True
        self._settable: dict[str, Settable] = {}
        self._counts: dict[tuple[int, int], int] = {}
        self._carried = NOTHING  # of the latest run that carried tangents
        self._prepared: list[_Prepared] = []  # that of the latest run, which the components are bound to, comes last

    def instants(self) -> FloatArray:
        """(K,) the communication instants, at which stimuli are wanted and rows recorded [s]."""
        count = self._steps(self.timing.stop) + 1
        require_room(count, 1 + len(self.stimuli))
        return self._times(count)

    def check_record(self, names: Iterable[str]) -> None:
        """See that each name is a variable that a trace can hold: a number, or a text.

        Raises:
            WiringError: one is not; the message names it.
        """
        for name in names:
            recordable(self.system, name, name, texts=True)

    def check_values(self, values: Mapping[str, Value]) -> None:
        """See that a run can be given these values.

        Raises:
            WiringError: it cannot; the message names one.
        """
        self._checked(values)

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

    def run_many(self, runs: Sequence[Run], progress: Callable[[float], None] | None = None) -> list[Result]:
        """The results of runs one after the other, each from reset instances.

        Raises:
            WiringError, FmuError: of the first run that fails; its message says which.
        """
        results = []
        for number, run in enumerate(runs):
            try:
                results.append(self.execute(run))
            except ServotwinError as error:
                raise error.within(f"run {number}") from error
            if progress is not None:
                progress((number + 1) / len(runs))
        return results

    def execute(self, run: Run, progress: Callable[[float], None] | None = None, sink: Sink | None = None) -> Result:
        """The result of a run; see `run`."""
        return self._result(self._executed(run, progress, sink))

    def rows(self, run: Run) -> FloatArray:
        """(K, n) what a run records, a column a variable in the order of `run.record`, without anything around it.

        Raises:
            FmuEnded: an FMU asked to stop before it was over.
        """
        done = self._executed(run)
        if done.ended:
            raise FmuEnded(done.ended, "before the run was over", "shorten it")
        return done.recorder.kept()

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
        along = self._carried
        done = self._executed(run, along=along)
        if done.ended:
            raise FmuEnded(done.ended, "before the run was over", "shorten it")
        chosen = self.outputs if run.record is None else tuple(dict.fromkeys(run.record))
        return along.parted(chosen, done.recorder.kept())

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
        own, stimuli = self._checked(run.values), self.driven(run.stimuli, steps + 1)
        self._reset()
        along.begin(self.components)
        prepared, count = self._prepare(run.record, (), every, along), steps // run.record_every + 1
        if sink is None:
            require_room(count, len(prepared.columns.places))
        loop = prepared.loop
        loop.begin(stimuli)
        engine, reason = prepared.steppers.chosen(steps * every)
        self._initialise(engine, loop, own, stop)
        recorder = Recorder(prepared.columns, loop.time, every * run.record_every, count, sink)
        begun, end = perf_counter(), None
        try:
            _step(engine, steps * every, recorder, progress)
            engine.finish()
            if steps % run.record_every == 0:
                loop.record(recorder)
            recorder.empty(loop.recorded)
        except (KeyboardInterrupt, FmuError) as early:
            end = early
            engine.finish()
            if isinstance(end, FmuError) and loop.tick % recorder.every == 0:
                loop.record(recorder, begun=True)
            recorder.empty(loop.recorded)
        done = _Done(recorder, loop, reason, perf_counter() - begun, str(end) if isinstance(end, FmuEnded) else "")
        if end is not None and (requested() or isinstance(end, KeyboardInterrupt)):
            raise Interrupted(self._result(done)) from None
        self._terminate()
        if isinstance(end, FmuError) and not done.ended:
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
        own, stimuli = self._checked(run.values), self.driven(run.stimuli, 1)
        self._reset()
        prepared = self._prepare(run.record, outputs, HELD)
        loop = prepared.loop
        loop.begin(stimuli)
        engine, reason = prepared.steppers.chosen(FARTHEST)
        self._initialise(engine, loop, own, None)
        changing.begin()
        every, slots = self._every * run.record_every, prepared.slots
        recorder = Recorder(prepared.columns, loop.time, every, ROWS, lambda piece: sink(changing.beside(piece)))

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

    def close(self) -> None:
        """Free all components."""
        for component in self.components.values():
            component.close()

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, traceback: TracebackType | None) -> None:
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

    def _times(self, count: int) -> FloatArray:
        return clock(self.timing.start, self.timing.step).times(0, count)

    def _checked(self, values: Mapping[str, Value]) -> dict[str, dict[str, Value]]:
        """component -> variable -> value; names are looked up when they come for the first time."""
        own: dict[str, dict[str, Value]] = {name: {} for name in self.components}
        for name, value in values.items():
            known = self._settable.get(name)
            if known is None:
                known = self._settable[name] = settable(self.system, name)
            if isinstance(value, str) or not known.lowest <= value <= known.highest:
                known.check(value)
            own[known.component][known.variable] = value
        return own

    def driven(self, stimuli: Mapping[str, FloatArray], count: int) -> FloatArray:
        """(count, s) the stimuli side by side, in the order of `stimuli`.

        Raises:
            WiringError: others are wanted, or they are too short or not finite.
        """
        if (given := sorted(stimuli)) != [*self.stimuli]:
            raise WiringError("stimuli", f"{given} given", f"give {[*self.stimuli]}")
        columns = []
        for name in self.stimuli:
            samples = np.asarray(stimuli[name], dtype=float)
            if samples.ndim != 1 or len(samples) < count:
                raise WiringError(name, f"has samples of shape {samples.shape}", f"give {count}, one an instant")
            finite = np.isfinite(samples)
            if not finite[finite.argmin()]:  # the first that is not, found sooner than by `all` in a short run
                raise WiringError(name, "is driven by a sample that is not finite", "repair the stimulus")
            columns.append(samples[:count])
        side_by_side = np.empty((count, len(columns)))
        for place, samples in enumerate(columns):
            side_by_side[:, place] = samples
        return side_by_side

    def _prepare(
        self, record: Iterable[str] | None, read: Sequence[str], hold: int, carried: Carried = NOTHING
    ) -> _Prepared:
        """A loop that records these, and their tangents, and reads those outputs too; that of one of the two runs
        before where it asked for the same."""
        chosen = self.outputs if record is None else tuple(dict.fromkeys(record))
        key = chosen, tuple(read), hold, carried
        found = next((prepared for prepared in self._prepared if prepared.key == key), None)
        if found is None:
            found = self._newly_prepared(key, chosen, read, hold, carried)
        elif found is not self._prepared[-1]:
            found.bind(self.components)
        self._prepared = [*(one for one in self._prepared[-2:] if one is not found), found][-2:]
        return found

    def _newly_prepared(
        self, key: tuple[object, ...], chosen: tuple[str, ...], read: Sequence[str], hold: int, carried: Carried
    ) -> _Prepared:
        self.check_record([*chosen, *read])
        values, links = self._read([*chosen, *read]), carried.links(self.system.connections)
        outputs = {name: [*of, *carried.of_component(name, of)] for name, of in values.items()}
        inputs = {name: list(driven) for name, driven in self._inputs.items()}
        for link in links:
            inputs[link.target.component].append(link.target.variable)
        columns = [*chosen, *carried.columns(chosen)]
        loop = self._loop(columns, outputs, inputs, links, hold)
        ports = {name: self.system.port(Endpoint.parse(name)) for name in chosen}
        units = {name: port.unit for name, port in ports.items() if port.unit}
        texts = [Endpoint.parse(name) for name, port in ports.items() if not port.numeric]
        names = sorted(columns, key=self._driven_inputs.__contains__)  # what is read comes first, as in the rows
        for name, component in self.components.items():
            component.bind(inputs[name], outputs[name])
        steppers = Steppers(loop, self.timing.engine)
        return _Prepared(
            key, loop, Columns(names, columns, units, partial(self._texts, texts)), outputs, inputs, steppers
        )

    def _texts(self, recorded: Iterable[Endpoint]) -> dict[str, tuple[str, ...]]:
        """What the numbers stand for that components have given for texts by now."""
        return {str(end): self.components[end.component].texts.get(end.variable, ()) for end in recorded}

    def _read(self, recorded: Sequence[str]) -> dict[str, list[str]]:
        """component -> outputs that are recorded or drive an input, all where cycles are iterated, so that when they
        count as settled does not depend on the record; then its other variables that are recorded."""
        wanted = {*recorded, *(str(link.source) for link in self.system.connections)}
        names = [name for name in self.outputs if self.timing.cycles.iterate or name in wanted]
        names += [name for name in recorded if name not in self._driven_inputs]
        outputs: dict[str, list[str]] = {name: [] for name in self.components}
        for endpoint in map(Endpoint.parse, dict.fromkeys(names)):
            outputs[endpoint.component].append(endpoint.variable)
        return outputs

    def _reset(self) -> None:
        """Have the components where a run begins; what is prepared is void where one was loaded anew."""
        fresh, self._fresh = self._fresh, False
        moved = [component.reset() for component in self.components.values() if not fresh]
        if any(moved):
            self._prepared.clear()

    def _terminate(self) -> None:
        for component in self.components.values():
            component.terminate()

    def _initialise(
        self, engine: Stepper, loop: Loop, own: Mapping[str, Mapping[str, Value]], stop: Fraction | None
    ) -> None:
        """Initialise the components, with their own values, for a run until `stop` [s]."""
        told = None if stop is None or not self.timing.tell_stop else float(stop)
        for name, component in self.components.items():
            component.set(own[name])
        for component in self.components.values():
            component.begin(self._start, told, self.timing.tolerance)
        self._propagate(engine, loop)
        for component in self.components.values():
            component.run()
        values = engine.pass_on(writing=False)
        for node in loop.nodes if not math.isfinite(sum(values)) else ():
            loop.require_finite(node, values[node.first : node.first + len(node.outputs)], "initialisation")

    def _loop(
        self,
        chosen: Sequence[str],
        outputs: Mapping[str, Sequence[str]],
        inputs: Mapping[str, Sequence[str]],
        tangents: Sequence[Connection],
        hold: int,
    ) -> Loop:
        read = [f"{name}.{variable}" for name, variables in outputs.items() for variable in variables]
        slots = {name: slot for slot, name in enumerate([*read, *self.stimuli])}
        links = {str(link.target): link for link in [*self.system.connections, *tangents]}
        nodes = {name: self._node(name, inputs[name], outputs[name], links, slots) for name in self.components}
        held = [Endpoint.parse(name) for name in chosen if name in self._driven_inputs]
        return Loop(
            groups=[[nodes[name] for name in group] for group in self.plan.groups],
            size=len(slots),
            first_stimulus=len(read),
            hold=hold,
            time=clock(self.timing.start, self.plan.tick),
            cycles=self.timing.cycles,
            record_slots=[slots[name] for name in chosen if name not in self._driven_inputs],
            record_inputs=[(nodes[e.component], self._inputs[e.component].index(e.variable)) for e in held],
            finite=self.timing.finite,
        )

    def _node(
        self,
        name: str,
        inputs: Sequence[str],
        outputs: Sequence[str],
        links: Mapping[str, Connection],
        slots: Mapping[str, int],
    ) -> Node:
        sources, scale = [], []
        for target in [f"{name}.{variable}" for variable in inputs]:
            link = links.get(target)
            sources.append(slots[str(link.source) if link else target])
            scale.append((link.factor, link.offset) if link else (1.0, 0.0))
        every = self.plan.every[name]
        return Node(
            component=self.components[name],
            sources=sources,
            scale=scale if any(pair != (1.0, 0.0) for pair in scale) else None,
            first=slots[f"{name}.{outputs[0]}"] if outputs else 0,
            instant=[bool(self.plan.instant[name])] * len(outputs),
            every=every,
            duration=float(every * self.plan.tick),
            outputs=outputs,
        )

    def _propagate(self, engine: Stepper, loop: Loop) -> None:
        """Pass outputs to inputs during initialisation until nothing changes.

        A chain of n components is through after n passes; a circle of direct feed-through may need more.

        Raises:
            FmuError: a circle whose values do not settle.
        """
        nodes, before = loop.nodes, engine.pass_on(writing=True)
        for turn in range(1, len(nodes) + 1 + self.timing.cycles.limit):
            after = engine.pass_on(writing=True)
            moving = _moving(before, after, self.timing.cycles.tolerance if turn > len(nodes) else 0.0)
            if not moving:
                return
            before = after
        names = [n.component.name for n in nodes if any(0 <= slot - n.first < len(n.instant) for slot in moving)]
        raise FmuError(
            ", ".join(names),
            f"the initial values run in a circle and do not settle in {turn + 1} passes",
            "break the circle, or give start values that fit",
        )

    def _result(self, done: _Done) -> Result:
        loop, reason = done.loop, done.reason
        return Result(
            done.recorder.trace(),
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
            ),
            done.ended,
        )


def _step(engine: Stepper, ticks: int, recorder: Recorder, progress: Callable[[float], None] | None) -> None:
    """Take all ticks, passing the rows on whenever there is no place for more."""
    while engine.tick < ticks:
        engine.advance(ticks, recorder)
        if recorder.full(engine.recorded):
            recorder.empty(engine.recorded)
        if progress is not None:
            progress(engine.tick / ticks)


def _moving(before: Sequence[float], after: Sequence[float], tolerance: float) -> list[int]:
    """Slots whose value changed by more than the tolerance, relative to 1 + |value|; NaN counts as no change."""
    if before == after:
        return []
    return [
        slot
        for slot, (then, now) in enumerate(zip(before, after, strict=True))
        if now != then and abs(now - then) > tolerance * (1.0 + abs(now))
    ]
