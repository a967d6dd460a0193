"""The stepping loop in plain Python: the specification of how a system advances.

At tick k, for each component that is due, in the plan's order: its inputs are set from the values that hold, it steps,
and its outputs are read. Ticks of its clocks go to the components that they are connected to, which step later.
Instant outputs hold from now on; the others from the tick at which its step ends. Row k of
the record has outputs as they are reported at t_k (left limits) and inputs as they act from t_k on (right limits).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Protocol

import numpy as np

from fmus.errors import FmuError
from orchestrator.engine.planning.plan import CycleSettings
from orchestrator.engine.recording import Recorder
from orchestrator.fmi.clocks.ticks import Arrival, Tick
from orchestrator.fmi.component import Component, Ticking
from orchestrator.fmi.interface import Value
from orchestrator.fmi.status import stepping
from orchestrator.rational import TickTimes
from orchestrator.trace import FloatArray

CHUNK = 2000  # ticks between two reports of progress


@dataclass
class Statistics:
    """What stepping one component took: calls of its step function, those of iterations included, and the time in
    them and around them [s].

    The compiled loop measures the time of steps that take over 5 µs; of shorter ones it measures one in 17 to 48,
    at random, and scales.
    """

    calls: int = 0
    seconds: float = 0.0


@dataclass
class LoopNode:
    """A component in the loop: where its inputs come from and its outputs go to in the vector of values.

    Attributes:
        sources: for each input the slot it takes its value from.
        scale: for each input factor and offset, None where no input needs them.
        first: slot of its first output; the others follow.
        instant: for each output whether it holds at once.
        every: communication step [ticks].
        duration: communication step [s].
        outputs: names of its outputs.
        held: the inputs of its latest step.
        ticks: components whose clocks its own tick.
        tells: its outputs that are texts, or binary, and go to others.
        texts_at_once: whether these hold at once.
        hears: its own input -> component and output from which it has its text.
    """

    component: Component
    sources: Sequence[int]
    scale: Sequence[tuple[float, float]] | None
    first: int
    instant: Sequence[bool]
    every: int
    duration: float
    outputs: Sequence[str]
    statistics: Statistics = field(default_factory=Statistics)
    held: Sequence[float] = ()
    ticks: Sequence[Ticks] = ()
    tells: Sequence[str] = ()
    hears: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    texts_at_once: bool = False

    @property
    def feeds_itself(self) -> bool:
        """Whether one of its instant outputs drives one of its inputs."""
        return any(
            0 <= slot - self.first < len(self.instant) and self.instant[slot - self.first] for slot in self.sources
        )

    def inputs(self, values: Sequence[float]) -> list[float]:
        if self.scale is None:
            return [values[slot] for slot in self.sources]
        return [factor * values[slot] + offset for slot, (factor, offset) in zip(self.sources, self.scale, strict=True)]


@dataclass(frozen=True)
class Ticks:
    """Ticks from a component to another.

    Attributes:
        clocks: output clock -> input clocks of the other.
        inputs: place of an input of the other -> place of the output that it takes its value from, factor and offset.
    """

    target: LoopNode
    clocks: Mapping[str, frozenset[str]]
    inputs: Mapping[int, tuple[int, float, float]]

    def arrival(self, tick: Tick) -> Arrival | None:
        """What a tick is to the other; None where it is not for it."""
        names = frozenset(name for clock in tick.clocks for name in self.clocks.get(clock, ()))
        brought = {place: factor * tick.outputs[own] + offset for place, (own, factor, offset) in self.inputs.items()}
        return Arrival(tick.time, names, brought) if names else None


class Stepper(Protocol):
    """What steps a loop."""

    @property
    def tick(self) -> int:
        """The next tick to take; all before are done."""

    @property
    def recorded(self) -> int:
        """How many rows are complete."""

    def pass_on(self, writing: bool) -> list[float]:
        """Have the values hold that all components give now, in stepping order, each after it was given its inputs
        where `writing`; all values after that."""

    def advance(self, last: int, recorder: Recorder) -> None:
        """Step towards tick `last`, filling the rows of the ticks that are recorded, until the recorder is full or it
        is time to report progress."""

    def finish(self) -> None:
        """See that the loop holds the values and statistics."""

    def held(self, slots: Sequence[int]) -> list[float]:
        """The values of these slots at the next tick, before anything steps from there."""


@dataclass
class Loop:
    """A system ready to step.

    Attributes:
        groups: nodes in stepping order; a group of several is a cycle to be iterated.
        size: number of slots: outputs of all nodes, then stimuli from `first_stimulus` on.
        hold: ticks for which a row of stimuli holds.
        time: tick -> time [s].
        record_slots, record_inputs: what each row of the record takes: slots, and (node, input) pairs.
        finite: whether an output that is not finite ends the run.
        nodes: all nodes in stepping order.
        values: current value of each slot.
        stimuli: (K, s) values of the stimuli.
        pending: tick -> slots and the values that they have from then on.
        said: component and output -> the text that holds.
    """

    groups: Sequence[Sequence[LoopNode]]
    size: int
    first_stimulus: int
    hold: int
    time: TickTimes
    cycles: CycleSettings
    record_slots: Sequence[int]
    record_inputs: Sequence[tuple[LoopNode, int]]
    finite: bool = True

    def __post_init__(self) -> None:
        self.nodes = [node for group in self.groups for node in group]
        self._circular = [(group, len(group) > 1 or group[0].feeds_itself) for group in self.groups]
        self.begin(np.zeros((0, self.size - self.first_stimulus)))

    def begin(self, stimuli: FloatArray) -> None:
        """Have it where a run with these (K, s) stimuli begins, side by side in memory."""
        self.stimuli = stimuli
        self.values = [0.0] * self.size
        self.tick = self.recorded = self.iterations = 0
        self.pending: dict[int, list[tuple[int, float]]] = {}
        self.said: dict[tuple[str, str], Value] = {}
        self._to_say: dict[int, dict[tuple[str, str], Value]] = {}
        self._heard: dict[tuple[str, str], Value] = {}  # component and input -> what it was given last
        for node in self.nodes:
            node.statistics, node.held = Statistics(), ()
        if len(stimuli):
            self.arrive(0)

    def pass_on(self, writing: bool) -> list[float]:
        for node in self.nodes:
            if writing and node.sources:
                node.component.write(node.inputs(self.values))
            outputs = node.component.read()
            self.values[node.first : node.first + len(outputs)] = outputs
        return list(self.values)

    def advance(self, last: int, recorder: Recorder) -> None:
        if self.tick == 0 and not self.said:
            self._begin_texts()
        for node in self.nodes if self.tick == 0 else ():
            self._tick(node)  # what ticked in the initialisation
        for tick in range(self.tick, min(last, self.tick + CHUNK)):
            if recorder.full(self.recorded):
                break
            self.arrive(tick)
            recorded = recorder.row(self.recorded) if tick % recorder.every == 0 else None
            if recorded is not None:
                recorded[: len(self.record_slots)] = [self.values[slot] for slot in self.record_slots]
            self._take(tick)
            if recorded is not None:
                for column, (node, number) in enumerate(self.record_inputs, start=len(self.record_slots)):
                    recorded[column] = node.held[number]
                self.recorded += 1
            self.tick = tick + 1

    def _take(self, tick: int) -> None:
        """Step all components that are due, and hold the inputs that they were given."""
        for group, circular in self._circular:
            due = [node for node in group if tick % node.every == 0]
            for node in due:
                if node.hears:
                    self._hear(node)
            if circular and due:
                self._iterate(due, tick)
            else:
                for node in due:
                    self._advance(node, tick)

    def finish(self) -> None:
        """Nothing: it holds them."""

    def held(self, slots: Sequence[int]) -> list[float]:
        self.arrive(self.tick)
        return [self.values[slot] for slot in slots]

    def record(self, recorder: Recorder, begun: bool = False) -> None:
        """Fill the row of a tick from which no step is taken, or one was `begun` and failed."""
        tick, row = self.tick, recorder.row(self.recorded)
        if not begun:
            self.arrive(tick)
            row[: len(self.record_slots)] = [self.values[slot] for slot in self.record_slots]
        for column, (node, number) in enumerate(self.record_inputs, start=len(self.record_slots)):
            row[column] = node.held[number] if tick % node.every and node.held else node.inputs(self.values)[number]
        self.recorded += 1

    def require_finite(self, node: LoopNode, outputs: Sequence[float], doing: str) -> None:
        """See that outputs are finite, where they have to be.

        Raises:
            FmuError: one is not.
        """
        if not self.finite or math.isfinite(sum(outputs)):
            return
        for name, value in zip(node.outputs, outputs, strict=True):
            if not math.isfinite(value):
                raise FmuError(
                    f"{node.component.name}.{name}",
                    f"is {value} after the {doing}",
                    "see to its inputs, parameters and start values; `nonfinite: allow` in the run lets it pass",
                )

    def defer(self, node: LoopNode, outputs: Sequence[float], tick: int) -> None:
        """Let those outputs of a step hold from this tick on that are not instant."""
        later = [(node.first + place, outputs[place]) for place, instant in enumerate(node.instant) if not instant]
        if later:
            self.pending.setdefault(tick, []).extend(later)

    def arrive(self, tick: int) -> None:
        """Let the values in that hold from this tick on: finished steps and stimuli."""
        for slot, value in self.pending.pop(tick, ()):
            self.values[slot] = value
        self.said |= self._to_say.pop(tick, {})
        if self.first_stimulus < self.size:
            self.values[self.first_stimulus :] = self.stimuli[tick // self.hold].tolist()

    def _advance(self, node: LoopNode, tick: int) -> None:
        outputs = self._step(node, tick)
        if node.ticks:
            self._tick(node)
        if node.tells:
            self._tell(node, tick)
        for place, instant in enumerate(node.instant):
            if instant:
                self.values[node.first + place] = outputs[place]
        self.require_finite(node, outputs, stepping(self.time(tick), node.duration))
        self.defer(node, outputs, tick + node.every)

    def _begin_texts(self) -> None:
        """Have the texts hold that all components give now."""
        for node in self.nodes:
            self.said |= {(node.component.name, name): node.component.get(name) for name in node.tells}

    def _hear(self, node: LoopNode) -> None:
        """Give a component the texts that hold, where they are others than before."""
        for name, source in node.hears.items():
            place, text = (node.component.name, name), self.said[source]
            if self._heard.get(place) != text:
                node.component.tune(name, text)
                self._heard[place] = text

    def _tell(self, node: LoopNode, tick: int) -> None:
        """Let the texts of a step hold, at once or from the tick at which it ends."""
        fresh = {(node.component.name, name): node.component.get(name) for name in node.tells}
        if node.texts_at_once:
            self.said |= fresh
        else:
            self._to_say.setdefault(tick + node.every, {}).update(fresh)

    def _tick(self, node: LoopNode) -> None:
        """Pass its ticks on to the components that step after it."""
        component = node.component
        for ticks in node.ticks:
            target = ticks.target.component
            if isinstance(component, Ticking) and isinstance(target, Ticking):
                target.expect([one for tick in component.passed() if (one := ticks.arrival(tick))])

    def _step(self, node: LoopNode, tick: int) -> Sequence[float]:
        return self.called(node, node.inputs(self.values), self.time(tick), node.duration)

    def called(self, node: LoopNode, inputs: Sequence[float], time: float, duration: float) -> Sequence[float]:
        """The outputs of a component after a step from a time by a duration [s] with these inputs."""
        begun = perf_counter()
        component = node.component
        if node.sources:
            node.held = inputs
            component.write(inputs)
        component.step(time, duration)
        outputs = component.read()
        node.statistics.calls += 1
        node.statistics.seconds += perf_counter() - begun
        return outputs

    def _iterate(self, nodes: Sequence[LoopNode], tick: int) -> None:
        """Repeat the step of a cycle from one saved state until its instant outputs stay put."""
        saved = [node.component.save() for node in nodes]
        try:
            for _ in range(self.cycles.limit):
                before = list(self.values)
                for node in nodes:
                    outputs = self._step(node, tick)
                    for offset, value in enumerate(outputs):
                        if node.instant[offset]:
                            self.values[node.first + offset] = value
                self.iterations += 1
                for node, state in zip(nodes, saved, strict=True):
                    node.component.restore(state)
                if self._settled(before):
                    break
            else:
                names = ", ".join(node.component.name for node in nodes)
                raise FmuError(
                    names,
                    f"the cycle did not settle in {self.cycles.limit} iterations at t = {self.time(tick):g} s",
                    "shorten the step, or relax its tolerance",
                )
        finally:
            for node, state in zip(nodes, saved, strict=True):
                node.component.drop(state)
        for node in nodes:
            self._advance(node, tick)

    def _settled(self, before: Sequence[float]) -> bool:
        """Whether no value moved by more than the tolerance; never where one grew out of bounds."""
        limit = self.cycles.tolerance
        return all(abs(now - then) < limit * (1.0 + abs(now)) for now, then in zip(self.values, before, strict=True))
