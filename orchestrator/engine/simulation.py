"""A system that is instantiated once and run as often as wanted, with other parameters and stimuli each time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from types import TracebackType

import numpy as np

from fmus.errors import WiringError
from orchestrator.engine.loop import Loop, Node, Statistics
from orchestrator.engine.plan import CycleSettings, Order, Plan, make_plan
from orchestrator.rational import multiples
from orchestrator.slave import Component, Value
from orchestrator.system import Endpoint, System, check_values
from orchestrator.trace import FloatArray, Trace

CHUNK = 2000  # ticks between two reports of progress


@dataclass(frozen=True)
class Timing:
    """When a run starts and stops and how it steps; exact times [s]."""

    stop: Fraction
    step: Fraction
    start: Fraction = Fraction(0)
    order: Order = Order.GAUSS_SEIDEL
    cycles: CycleSettings = field(default_factory=CycleSettings)


@dataclass(frozen=True)
class Result:
    """What a run gave.

    Attributes:
        trace: the recorded variables, named component.variable, one row a communication step.
        statistics: component -> calls and seconds.
        warnings: component -> number of warnings its FMU returned.
        iterations: steps of cycles that were taken and taken back.
    """

    trace: Trace
    statistics: Mapping[str, Statistics]
    warnings: Mapping[str, int]
    iterations: int


class Simulation:
    """Instances of a system's components; a context manager that frees them.

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
        self._outputs = {name: [p.name for p in part.interface.of("output") if p.type != "String"]
                         for name, part in system.parts.items()}  # fmt: skip
        self._inputs: dict[str, list[Endpoint]] = {name: [] for name in system.parts}
        for target in [link.target for link in system.connections] + sorted(system.stimulated, key=str):
            self._inputs[target.component].append(target)
        for name, component in self.components.items():
            component.bind([e.variable for e in self._inputs[name]], self._outputs[name])

    def instants(self) -> FloatArray:
        """(K,) the communication instants, at which stimuli are wanted and rows recorded [s]."""
        ticks = multiples(self.timing.stop - self.timing.start, self.timing.step, "stop") + 1
        return np.array([float(self.timing.start + k * self.timing.step) for k in range(ticks)])

    def run(
        self,
        values: Mapping[str, Value] | None = None,
        stimuli: Mapping[str, FloatArray] | None = None,
        record: Iterable[str] | None = None,
        progress: Callable[[float], None] | None = None,
        stop: Fraction | None = None,
    ) -> Result:
        """Run from start to stop.

        Args:
            values: component.variable -> parameter or start value; the others have the FMU's defaults.
            stimuli: component.input -> (K,) value from each communication instant on.
            record: component.variable of outputs and connected inputs; None takes all outputs.
            progress: called now and then with the fraction done.
            stop: end of this run, at most the timing's [s].
        """
        values, stimuli = values or {}, stimuli or {}
        check_values(self.system, values)
        if set(stimuli) != {str(e) for e in self.system.stimulated}:
            raise WiringError("stimuli", f"{sorted(stimuli)} given", f"give {sorted(map(str, self.system.stimulated))}")
        ticks = multiples((stop or self.timing.stop) - self.timing.start, self.plan.tick, "stop")
        every = multiples(self.timing.step, self.plan.tick, "step")
        self._initialise(values)
        loop = self._loop(stimuli, every, record)
        self._propagate(loop)
        for component in self.components.values():
            component.run()
        self._read_all(loop)
        rows = np.full((ticks // every + 1, len(loop.record_slots) + len(loop.record_inputs)), np.nan)
        for first in range(0, ticks, CHUNK):
            loop.run(first, min(first + CHUNK, ticks), every, rows)
            if progress is not None:
                progress(min(first + CHUNK, ticks) / ticks)
        if ticks % every == 0:
            loop.record(ticks, rows[-1])
        return self._result(loop, rows, every, record)

    def close(self) -> None:
        """Free all components."""
        for component in self.components.values():
            component.close()

    def __enter__(self) -> Simulation:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()

    def _initialise(self, values: Mapping[str, Value]) -> None:
        own: dict[str, dict[str, Value]] = {name: {} for name in self.components}
        for name, value in values.items():
            endpoint = Endpoint.parse(name)
            own[endpoint.component][endpoint.variable] = value
        for name, component in self.components.items():
            if not self._fresh:
                component.reset()
            component.set(own[name])
        self._fresh = False
        for component in self.components.values():
            component.begin(float(self.timing.start), None)

    def _loop(self, stimuli: Mapping[str, FloatArray], every: int, record: Iterable[str] | None) -> Loop:
        slots = self._slots()
        names = sorted(str(e) for e in self.system.stimulated)
        nodes = {name: self._node(name, slots) for name in self.components}
        chosen = list(record) if record is not None else [str(e) for e in self._all_outputs()]
        outputs = [Endpoint.parse(name) for name in chosen if Endpoint.parse(name) in slots]
        inputs = [self._recorded_input(Endpoint.parse(n), nodes) for n in chosen if Endpoint.parse(n) not in slots]
        start, tick = self.timing.start, self.plan.tick
        columns = [np.repeat(np.asarray(stimuli[name], dtype=float), every) for name in names]
        return Loop(
            groups=[[nodes[name] for name in group] for group in self.plan.groups],
            values=[0.0] * (len(slots) + len(names)),
            stimuli=np.column_stack(columns) if columns else np.zeros((0, 0)),
            first_stimulus=len(slots),
            time=lambda k: float(start + k * tick) if start else k * tick.numerator / tick.denominator,
            cycles=self.timing.cycles,
            record_slots=[slots[endpoint] for endpoint in outputs],
            record_inputs=inputs,
        )

    def _all_outputs(self) -> list[Endpoint]:
        return [Endpoint(name, variable) for name, variables in self._outputs.items() for variable in variables]

    def _slots(self) -> dict[Endpoint, int]:
        return {endpoint: slot for slot, endpoint in enumerate(self._all_outputs())}

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

    def _recorded_input(self, endpoint: Endpoint, nodes: Mapping[str, Node]) -> tuple[Node, int]:
        self.system.port(endpoint)
        inputs = self._inputs[endpoint.component]
        if endpoint not in inputs:
            raise WiringError(str(endpoint), "is neither an output nor a connected input", "record another variable")
        return nodes[endpoint.component], inputs.index(endpoint)

    def _propagate(self, loop: Loop) -> None:
        """Pass outputs to inputs during initialisation until nothing changes or each component had a turn."""
        nodes = [node for group in loop.groups for node in group]
        loop.arrive(0)
        for _ in range(len(nodes) + 1):
            before = list(loop.values)
            for node in nodes:
                if node.sources:
                    node.component.write(node.inputs(loop.values))
                self._take(loop, node)
            if loop.values == before:
                return

    def _read_all(self, loop: Loop) -> None:
        for group in loop.groups:
            for node in group:
                self._take(loop, node)

    @staticmethod
    def _take(loop: Loop, node: Node) -> None:
        values = node.component.read()
        loop.values[node.first : node.first + len(values)] = values

    def _result(self, loop: Loop, rows: FloatArray, every: int, record: Iterable[str] | None) -> Result:
        chosen = list(record) if record is not None else [str(e) for e in self._all_outputs()]
        slots = self._slots()
        names = [n for n in chosen if Endpoint.parse(n) in slots] + [
            n for n in chosen if Endpoint.parse(n) not in slots
        ]
        step = self.timing.step
        time = np.array([float(self.timing.start + k * step) for k in range(len(rows))])
        units = {name: self.system.port(Endpoint.parse(name)).unit or "1" for name in names}
        trace = Trace(time, {name: rows[:, i] for i, name in enumerate(names)}, units, "simulation")
        nodes: Sequence[Node] = [node for group in loop.groups for node in group]
        return Result(
            trace,
            {node.component.name: node.statistics for node in nodes},
            {name: getattr(component, "warnings", 0) for name, component in self.components.items()},
            loop.iterations,
        )
