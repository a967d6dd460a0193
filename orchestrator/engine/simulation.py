"""A system that is instantiated once and run as often as wanted, with other parameters and stimuli each time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from time import perf_counter
from types import TracebackType

import numpy as np

from fmus.errors import FmuError, ServotwinError, WiringError
from orchestrator.engine.account import Account
from orchestrator.engine.compiled import Engine, stepper
from orchestrator.engine.live import FARTHEST, HELD, LiveRun
from orchestrator.engine.loop import Loop, Node, Statistics, Stepper
from orchestrator.engine.plan import REFUSED, CycleSettings, Order, Plan, make_plan
from orchestrator.engine.recording import ROWS, Recorder, Sink
from orchestrator.fmi.component import Component
from orchestrator.fmi.interface import Value
from orchestrator.interrupts import requested
from orchestrator.rational import clock, multiples, written
from orchestrator.system import Endpoint, System, check_values
from orchestrator.trace import FloatArray, Trace


@dataclass(frozen=True)
class Timing:
    """When a run starts and stops and how it steps; exact times [s]."""

    stop: Fraction
    step: Fraction
    start: Fraction = Fraction(0)
    order: Order = Order.GAUSS_SEIDEL
    cycles: CycleSettings = REFUSED
    engine: Engine = Engine.AUTO


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
    """

    trace: Trace
    statistics: Mapping[str, Statistics]
    warnings: Mapping[str, int]
    iterations: int
    account: Account


class Interrupted(KeyboardInterrupt):
    """A run was interrupted; `result` is what it gave until then, to the last whole tick.

    From one process to another it travels as a plain KeyboardInterrupt.
    """

    def __init__(self, result: Result) -> None:
        super().__init__(f"interrupted at t = {result.account.reached:g} s")
        self.result = result

    def __reduce__(self) -> tuple[type, tuple[str]]:
        return KeyboardInterrupt, (str(self),)


class Simulation:
    """Instances of a system's components; a context manager that frees them.

    Attributes:
        outputs: component.variable of all outputs that can be recorded.

    Raises (on entering or running):
        WiringError: values or times that do not fit the system.
        FmuError: an FMU failed.
    """

    def __init__(self, system: System, components: Mapping[str, Component], timing: Timing) -> None:
        self.system = system
        self.components = dict(components)
        self.timing = timing
        self.plan: Plan = make_plan(system, timing.step, timing.order, timing.cycles)
        self._fresh = True
        self.outputs = tuple(
            f"{name}.{port.name}"
            for name, part in system.parts.items()
            for port in part.interface.of("output")
            if port.numeric
        )
        self._outputs: dict[str, list[str]] = {}  # those that are read in a run
        self._inputs: dict[str, list[Endpoint]] = {name: [] for name in system.parts}
        for target in [link.target for link in system.connections] + sorted(system.stimulated, key=str):
            self._inputs[target.component].append(target)
        self._every = multiples(timing.step, self.plan.tick, "step")  # ticks of a communication step

    def instants(self) -> FloatArray:
        """(K,) the communication instants, at which stimuli are wanted and rows recorded [s]."""
        return self._times(self._steps(self.timing.stop) + 1)

    def check_record(self, names: Iterable[str]) -> None:
        """See that each name is an output or a connected input.

        Raises:
            WiringError: one is not; the message names it.
        """
        for name in names:
            endpoint = Endpoint.parse(name)
            self.system.port(endpoint)
            if name not in self.outputs and endpoint not in self._inputs[endpoint.component]:
                raise WiringError(name, "is neither an output nor a connected input", "record another variable")

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
            record: component.variable of outputs and connected inputs; None takes all outputs.
            progress: called now and then with the fraction done.
            stop: end of this run, at most the timing's [s].
            record_every: communication steps from one row of the record to the next, counted from the start.
            sink: is given the record in pieces, in order, instead of the result's trace.

        Raises:
            Interrupted: a KeyboardInterrupt came while stepping; it carries the result up to there.
        """
        return self.execute(Run(values or {}, stimuli or {}, record, stop, record_every), progress, sink)

    def run_many(self, runs: Sequence[Run], progress: Callable[[float], None] | None = None) -> list[Result]:
        """The results of runs one after the other, each from reset instances.

        Raises:
            WiringError, FmuError: of the first run that fails; its message says which.
        """
        results = []
        for number, each in enumerate(runs):
            try:
                results.append(self.execute(each))
            except ServotwinError as error:
                raise type(error)(f"run {number}: {error.place}", error.problem, error.fix) from error
            if progress is not None:
                progress((number + 1) / len(runs))
        return results

    def execute(self, run: Run, progress: Callable[[float], None] | None = None, sink: Sink | None = None) -> Result:
        """The result of a run; see `run`."""
        steps = self._steps(self.timing.stop if run.stop is None else run.stop)
        chosen = self.outputs if run.record is None else tuple(dict.fromkeys(run.record))
        check_values(self.system, run.values)
        self.check_record(chosen)
        self._check_stimuli(run.stimuli, steps + 1)
        if run.record_every < 1:
            raise WiringError("record_every", f"is {run.record_every}", "give 1 or more")
        every = self._every
        loop = self._begun(run.values, run.stimuli, chosen, chosen, every)
        recorder = self._recorder(loop, chosen, every * run.record_every, steps // run.record_every + 1, sink)
        engine, reason = stepper(loop, steps * every, self.timing.engine)
        begun = perf_counter()
        try:
            _step(engine, steps * every, recorder, progress)
            engine.finish()
            if steps % run.record_every == 0:
                loop.record(recorder)
            recorder.empty(loop.recorded)
        except (KeyboardInterrupt, FmuError) as end:
            if isinstance(end, FmuError) and not requested():
                raise
            engine.finish()
            recorder.empty(loop.recorded)
            raise Interrupted(self._result(loop, recorder, reason, perf_counter() - begun)) from None
        return self._result(loop, recorder, reason, perf_counter() - begun)

    def live(self, run: Run, outputs: Sequence[str], sink: Sink) -> LiveRun[Result]:
        """A run that is stepped from outside, without an end; `run` has one value of each stimulus to begin with.

        Args:
            outputs: component.output whose values are wanted after each step.
            sink: is given the record in pieces, in order.
        """
        chosen = self.outputs if run.record is None else tuple(dict.fromkeys(run.record))
        check_values(self.system, run.values)
        self.check_record([*chosen, *outputs])
        self._check_stimuli(run.stimuli, 1)
        loop = self._begun(run.values, run.stimuli, chosen, [*chosen, *outputs], HELD)
        recorder = self._recorder(loop, chosen, self._every * run.record_every, ROWS, sink)
        engine, reason = stepper(loop, FARTHEST, self.timing.engine)
        slots = self._slots()
        read = [
            (name, slots[e], e.variable in self.plan.instant[e.component])
            for name in outputs
            for e in [Endpoint.parse(name)]
        ]
        inputs = sorted(map(str, self.system.stimulated))
        return LiveRun(
            loop, engine, recorder, self._every, inputs, read, lambda spent: self._result(loop, recorder, reason, spent)
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
        start, step = self.timing.start, self.timing.step
        if not start < stop <= self.timing.stop:
            raise WiringError(
                "stop",
                f"{written(stop)} s is not after {written(start)} s and up to {written(self.timing.stop)} s",
                "choose a time between",
            )
        return multiples(stop - start, step, "stop - start" if start else "stop")

    def _times(self, count: int) -> FloatArray:
        return clock(self.timing.start, self.timing.step).times(0, count)

    def _check_stimuli(self, stimuli: Mapping[str, FloatArray], count: int) -> None:
        if set(stimuli) != {str(e) for e in self.system.stimulated}:
            raise WiringError("stimuli", f"{sorted(stimuli)} given", f"give {sorted(map(str, self.system.stimulated))}")
        for name, samples in stimuli.items():
            if np.ndim(samples) != 1 or len(samples) < count:
                raise WiringError(name, f"has samples of shape {np.shape(samples)}", f"give {count}, one an instant")
            if not np.all(np.isfinite(samples)):
                raise WiringError(name, "is driven by a sample that is not finite", "repair the stimulus")

    def _bind(self, recorded: Sequence[str]) -> None:
        """Have those outputs read that are recorded or drive an input; all where cycles are iterated, so that when
        they count as settled does not depend on the record."""
        wanted = {*recorded, *(str(link.source) for link in self.system.connections)}
        outputs: dict[str, list[str]] = {name: [] for name in self.components}
        for endpoint in map(Endpoint.parse, self.outputs):
            if self.timing.cycles.iterate or str(endpoint) in wanted:
                outputs[endpoint.component].append(endpoint.variable)
        for name, component in self.components.items():
            if outputs[name] != self._outputs.get(name):
                component.bind([e.variable for e in self._inputs[name]], outputs[name])
        self._outputs = outputs

    def _initialise(self, values: Mapping[str, Value]) -> None:
        own: dict[str, dict[str, Value]] = {name: {} for name in self.components}
        for name, value in values.items():
            endpoint = Endpoint.parse(name)
            own[endpoint.component][endpoint.variable] = value
        fresh, self._fresh = self._fresh, False
        for name, component in self.components.items():
            if not fresh:
                component.reset()
            component.set(own[name])
        for component in self.components.values():
            component.begin(float(self.timing.start), None)

    def _begun(
        self,
        values: Mapping[str, Value],
        stimuli: Mapping[str, FloatArray],
        recorded: Sequence[str],
        read: Sequence[str],
        hold: int,
    ) -> Loop:
        """A loop over components that are initialised with these values."""
        self._bind(read)
        self._initialise(values)
        loop = self._loop(stimuli, hold, recorded)
        self._propagate(loop)
        for component in self.components.values():
            component.run()
        self._read_all(loop)
        return loop

    def _loop(self, stimuli: Mapping[str, FloatArray], hold: int, chosen: Sequence[str]) -> Loop:
        slots = self._slots()
        names = sorted(str(e) for e in self.system.stimulated)
        nodes = {name: self._node(name, slots) for name in self.components}
        recorded = [Endpoint.parse(name) for name in chosen]
        columns = [np.asarray(stimuli[name], dtype=float) for name in names]
        return Loop(
            groups=[[nodes[name] for name in group] for group in self.plan.groups],
            values=[0.0] * (len(slots) + len(names)),
            stimuli=np.column_stack([c[: min(map(len, columns))] for c in columns]) if columns else np.zeros((0, 0)),
            first_stimulus=len(slots),
            hold=hold,
            time=clock(self.timing.start, self.plan.tick),
            cycles=self.timing.cycles,
            record_slots=[slots[endpoint] for endpoint in recorded if endpoint in slots],
            record_inputs=[
                (nodes[e.component], self._inputs[e.component].index(e)) for e in recorded if e not in slots
            ],
        )

    def _slots(self) -> dict[Endpoint, int]:
        read = [Endpoint(name, variable) for name, variables in self._outputs.items() for variable in variables]
        return {endpoint: slot for slot, endpoint in enumerate(read)}

    def _node(self, name: str, slots: Mapping[Endpoint, int]) -> Node:
        stimuli = {e: len(slots) + i for i, e in enumerate(sorted(self.system.stimulated, key=str))}
        links = {link.target: link for link in self.system.connections}
        sources, scale = [], []
        for endpoint in self._inputs[name]:
            link = links.get(endpoint)
            sources.append(slots[link.source] if link else stimuli[endpoint])
            scale.append((link.factor, link.offset) if link else (1.0, 0.0))
        outputs = self._outputs[name]
        every = self.plan.every[name]
        return Node(
            component=self.components[name],
            sources=sources,
            scale=scale if any(pair != (1.0, 0.0) for pair in scale) else None,
            first=slots[Endpoint(name, outputs[0])] if outputs else 0,
            instant=[variable in self.plan.instant[name] for variable in outputs],
            every=every,
            duration=float(every * self.plan.tick),
        )

    def _propagate(self, loop: Loop) -> None:
        """Pass outputs to inputs during initialisation until nothing changes.

        A chain of n components is through after n passes; a circle of direct feed-through may need more.

        Raises:
            FmuError: a circle whose values do not settle.
        """
        nodes = [node for group in loop.groups for node in group]
        loop.arrive(0)
        for turn in range(len(nodes) + 1 + self.timing.cycles.limit):
            before = list(loop.values)
            for node in nodes:
                if node.sources:
                    node.component.write(node.inputs(loop.values))
                self._take(loop, node)
            tolerance = self.timing.cycles.tolerance if turn > len(nodes) else 0.0
            moving = _moving(before, loop.values, tolerance)
            if not moving:
                return
        names = [n.component.name for n in nodes if any(0 <= slot - n.first < len(n.instant) for slot in moving)]
        raise FmuError(
            ", ".join(names),
            f"the initial values run in a circle and do not settle in {turn + 1} passes",
            "break the circle, or give start values that fit",
        )

    def _read_all(self, loop: Loop) -> None:
        for group in loop.groups:
            for node in group:
                self._take(loop, node)

    @staticmethod
    def _take(loop: Loop, node: Node) -> None:
        values = node.component.read()
        loop.values[node.first : node.first + len(values)] = values

    def _recorder(self, loop: Loop, chosen: Sequence[str], every: int, count: int, sink: Sink | None) -> Recorder:
        names = sorted(chosen, key=lambda name: name not in self.outputs)  # outputs first, as in the rows
        units = {name: self.system.port(Endpoint.parse(name)).unit or "1" for name in chosen}
        return Recorder(names, chosen, units, loop.time, every, count, sink)

    def _result(self, loop: Loop, recorder: Recorder, reason: str, spent: float) -> Result:
        return Result(
            recorder.trace(),
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
                seconds=spent,
            ),
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
    return [
        slot
        for slot, (then, now) in enumerate(zip(before, after, strict=True))
        if now != then and abs(now - then) > tolerance * (1.0 + abs(now))
    ]
