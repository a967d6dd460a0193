"""What runs share that record the same: the loop, its columns, and what the components are asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from orchestrator.engine.compiled import Steppers
from orchestrator.engine.iterated import IteratedLoop, Iteration
from orchestrator.engine.loop import Loop, LoopNode, Ticks
from orchestrator.engine.planning.plan import Plan
from orchestrator.engine.planning.tangents import NOTHING, Carried
from orchestrator.engine.recording import RecordColumns
from orchestrator.engine.run import Timing
from orchestrator.fmi.component import Component
from orchestrator.fmi.interface import Port
from orchestrator.rational import clock
from orchestrator.system import Connection, Endpoint, System, recordable


@dataclass(frozen=True)
class PreparedLoop:
    """What runs share that record the same.

    Attributes:
        loop: to be begun anew for each run.
        outputs: component -> outputs and other variables that are read.
        inputs: component -> inputs that are driven.
    """

    key: tuple[object, ...]
    loop: Loop
    columns: RecordColumns
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


class PreparedLoops:
    """Loops of one system for what runs record, made when they are asked for; those of the latest two are kept.

    Attributes:
        outputs: component.variable of all outputs that are numbers.
        stimuli: component.input of the stimuli that a run needs, sorted.
    """

    def __init__(self, system: System, components: Mapping[str, Component], timing: Timing, plan: Plan) -> None:
        self.outputs = tuple(
            f"{name}.{port.name}"
            for name, part in system.parts.items()
            for port in part.interface.of("output")
            if port.numeric
        )
        self.stimuli = tuple(sorted(map(str, system.stimulated)))
        self._system, self._components, self._timing, self._plan = system, components, timing, plan
        self._inputs: dict[str, list[str]] = {name: [] for name in system.parts}  # component -> those that are driven
        for target in [link.target for link in system.connections] + [Endpoint.parse(name) for name in self.stimuli]:
            self._inputs[target.component].append(target.variable)
        self._driven_inputs = frozenset(f"{name}.{one}" for name, inputs in self._inputs.items() for one in inputs)
        self._prepared: list[PreparedLoop] = []  # that of the latest run, which the components are bound to, comes last

    def clear(self) -> None:
        """Forget what is prepared: a component was loaded anew."""
        self._prepared.clear()

    def check_record(self, names: Iterable[str]) -> None:
        """See that each name is a variable that a trace can hold: a number, or a text.

        Raises:
            WiringError: one is not; the message names it.
        """
        for name in names:
            recordable(self._system, name, name, texts=True)

    def loop(
        self, record: Iterable[str] | None, read: Sequence[str], hold: int, carried: Carried = NOTHING
    ) -> PreparedLoop:
        """A loop that records these, and their tangents, and reads those outputs too; that of one of the two runs
        before where it asked for the same."""
        chosen = self.outputs if record is None else tuple(dict.fromkeys(record))
        key = chosen, tuple(read), hold, carried
        found = next((prepared for prepared in self._prepared if prepared.key == key), None)
        if found is None:
            found = self._newly_prepared(key, chosen, read, hold, carried)
        elif found is not self._prepared[-1]:
            found.bind(self._components)
        self._prepared = [*(one for one in self._prepared[-2:] if one is not found), found][-2:]
        return found

    def _newly_prepared(
        self, key: tuple[object, ...], chosen: tuple[str, ...], read: Sequence[str], hold: int, carried: Carried
    ) -> PreparedLoop:
        self.check_record([*chosen, *read])
        values, links = self._read([*chosen, *read]), carried.links(self._system.connections)
        outputs = {name: [*of, *carried.of_component(name, of)] for name, of in values.items()}
        inputs = {name: list(driven) for name, driven in self._inputs.items()}
        for link in links:
            inputs[link.target.component].append(link.target.variable)
        columns = [*chosen, *carried.columns(chosen)]
        loop = self._new_loop(columns, outputs, inputs, links, hold)
        ports = {name: self._system.port(Endpoint.parse(name)) for name in chosen}
        units = {name: port.unit for name, port in ports.items() if port.unit}
        texts = [Endpoint.parse(name) for name, port in ports.items() if not port.numeric]
        names = sorted(columns, key=self._driven_inputs.__contains__)  # what is read comes first, as in the rows
        for name, component in self._components.items():
            component.bind(inputs[name], outputs[name])
        steppers = Steppers(loop, self._timing.engine)
        return PreparedLoop(
            key, loop, RecordColumns(names, columns, units, partial(self._texts, texts)), outputs, inputs, steppers
        )

    def _texts(self, recorded: Iterable[Endpoint]) -> dict[str, tuple[str, ...]]:
        """What the numbers stand for that components have given for texts by now."""
        return {str(end): self._components[end.component].texts.get(end.variable, ()) for end in recorded}

    def _read(self, recorded: Sequence[str]) -> dict[str, list[str]]:
        """component -> outputs that are recorded or drive an input, all where cycles are iterated, so that when they
        count as settled does not depend on the record; then its other variables that are recorded."""
        sources = [str(link.source) for link in self._system.connections]
        wanted = {*recorded, *sources}
        iterating = self._timing.cycles.iterate or self._plan.iterated
        names = [name for name in self.outputs if iterating or name in wanted]
        names += [name for name in (*sources, *recorded) if name not in self._driven_inputs]
        outputs: dict[str, list[str]] = {name: [] for name in self._components}
        for endpoint in map(Endpoint.parse, dict.fromkeys(names)):
            outputs[endpoint.component].append(endpoint.variable)
        return outputs

    def _new_loop(
        self,
        chosen: Sequence[str],
        outputs: Mapping[str, Sequence[str]],
        inputs: Mapping[str, Sequence[str]],
        tangents: Sequence[Connection],
        hold: int,
    ) -> Loop:
        read = [f"{name}.{variable}" for name, variables in outputs.items() for variable in variables]
        slots = {name: slot for slot, name in enumerate([*read, *self.stimuli])}
        links = {str(link.target): link for link in [*self._system.connections, *tangents]}
        nodes = {name: self._node(name, inputs[name], outputs[name], links, slots) for name in self._components}
        for name, node in nodes.items():
            node.ticks = self._ticks(name, nodes, inputs, outputs)
            texts = self._system.texts
            node.tells = sorted({link.source.variable for link in texts if link.source.component == name})
            node.hears = {
                link.target.variable: (link.source.component, link.source.variable)
                for link in texts
                if link.target.component == name
            }
            node.texts_at_once = bool(self._plan.instant[name])
        held = [Endpoint.parse(name) for name in chosen if name in self._driven_inputs]
        kind: Callable[..., Loop] = Loop
        if self._plan.iterated:
            kind = partial(IteratedLoop, iteration=self._iteration(slots))
        return kind(
            groups=[[nodes[name] for name in group] for group in self._plan.groups],
            size=len(slots),
            first_stimulus=len(read),
            hold=hold,
            time=clock(self._timing.start, self._plan.tick),
            cycles=self._timing.cycles,
            record_slots=[slots[name] for name in chosen if name not in self._driven_inputs],
            record_inputs=[(nodes[e.component], self._inputs[e.component].index(e.variable)) for e in held],
            finite=self._timing.finite,
        )

    def _iteration(self, slots: Mapping[str, int]) -> Iteration:
        """How its steps are iterated."""
        control, step = self._timing.control, self._timing.step
        parts = 1 if control is None else control.parts(step)
        names = dict.fromkeys([*self.outputs, *(str(link.source) for link in self._system.connections)])
        ends = [Endpoint.parse(name) for name in names if name in slots]
        ends = [end for end in ends if _continuous(self._system.port(end))]
        reacting = frozenset(
            end.component
            for end in ends
            if self._system.parts[end.component].interface.feed_through.get(end.variable) != frozenset()
        )
        fine = clock(self._timing.start, step / parts)
        sampling = self._components.keys() - {end.component for end in ends}
        return Iteration([slots[str(end)] for end in ends], frozenset(sampling), reacting, control, fine, parts, step)

    def _ticks(
        self,
        name: str,
        nodes: Mapping[str, LoopNode],
        inputs: Mapping[str, Sequence[str]],
        outputs: Mapping[str, Sequence[str]],
    ) -> list[Ticks]:
        """Whom a component's clocks tick, and which of its outputs go there with a tick."""
        routes: dict[str, dict[str, set[str]]] = {}
        for link in self._system.clocks:
            if link.source.component == name:
                of = routes.setdefault(link.target.component, {})
                of.setdefault(link.source.variable, set()).add(link.target.variable)
        return [
            Ticks(
                nodes[target],
                {clock: frozenset(names) for clock, names in clocks.items()},
                {
                    inputs[target].index(link.target.variable): (
                        outputs[name].index(link.source.variable),
                        link.factor,
                        link.offset,
                    )
                    for link in self._system.connections
                    if (link.source.component, link.target.component) == (name, target)
                },
            )
            for target, clocks in routes.items()
        ]

    def _node(
        self,
        name: str,
        inputs: Sequence[str],
        outputs: Sequence[str],
        links: Mapping[str, Connection],
        slots: Mapping[str, int],
    ) -> LoopNode:
        sources, scale = [], []
        for target in [f"{name}.{variable}" for variable in inputs]:
            link = links.get(target)
            sources.append(slots[str(link.source) if link else target])
            scale.append((link.factor, link.offset) if link else (1.0, 0.0))
        every = self._plan.every[name]
        steady = {port.name for port in self._system.parts[name].interface.of("calculatedParameter")}
        return LoopNode(
            component=self._components[name],
            sources=sources,
            scale=scale if any(pair != (1.0, 0.0) for pair in scale) else None,
            first=slots[f"{name}.{outputs[0]}"] if outputs else 0,
            instant=[bool(self._plan.instant[name]) and one not in steady for one in outputs],
            every=every,
            duration=float(every * self._plan.tick),
            outputs=outputs,
        )


def _continuous(port: Port) -> bool:
    """Whether its mean over a step means something."""
    return port.real and port.variability == "continuous"
