"""An SSP as the document of a scenario: what a YAML file would say of it."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from fmus.errors import FmuFileError, WiringError
from fmus.files import RawMap
from fmus.units import SAME, Conversion
from fmus.words import nearest
from orchestrator.crossing import Crossing, crossing
from orchestrator.fmi.file import FmuDescription, FmuKind
from orchestrator.fmi.interface import Interface, Port
from orchestrator.settable import check_value
from orchestrator.ssp import flattening, passage
from orchestrator.ssp.assignment import Assignment
from orchestrator.ssp.description import Description
from orchestrator.ssp.flattening import FlatSystem, Hop, Node
from orchestrator.ssp.passage import ValuePassage
from orchestrator.ssp.reading import read
from orchestrator.ssp.variables import contradiction

LOG = logging.getLogger("servotwin.ssp")
_SET_FROM_OUTSIDE = ("input", "parameter", "structuralParameter")  # and as they start where nothing does
STEPS = 1000  # of a run where nothing tells how long one is


@dataclass(frozen=True)
class Imported:
    """A system out of an SSP.

    Attributes:
        document: as `ScenarioBlock` has it; without `run` where there is no default experiment.
        names: component -> where it is in the SSP, dots between elements.
        notes: what is to be known of it, a line each.
    """

    document: RawMap
    names: Mapping[str, str]
    notes: Sequence[str]


def imported(path: Path) -> Imported:
    """The system of an SSP as a document; its FMUs lie unpacked until this process ends.

    Raises:
        FmuFileError: it cannot be read, see `reading.read`.
        WiringError: its connections do not fit together.
    """
    description = read(path)
    return _Importing(path, description, flattening.flattened(description, str(path))).imported()


@dataclass
class _Importing:
    path: Path
    description: Description
    flat: FlatSystem
    notes: list[str] = field(default_factory=list)

    def imported(self) -> Imported:
        """The document, its parts in the order in which people write them."""
        self.fmus = self._described()
        self.interfaces: dict[flattening.Path, Interface] = {path: fmu.interface for path, fmu in self.fmus.items()}
        self.names = flattening.component_names(list(self.flat.components))
        self.used = set[Node]()
        assignment = self._assigned()
        if self._resize():
            assignment = self._assigned()
        self.notes += [*self.description.notes, *assignment.notes, *self._contradictions()]
        self.parameters: dict[flattening.Path, RawMap] = {path: {} for path in self.fmus}
        self.stimuli: RawMap = {}
        connections = [line for node in self.flat.incoming if (line := self._connection(node))]
        self._set_values()
        document: RawMap = {"title": self.description.name or self.path.stem}
        document["components"] = {self.names[path]: self._component(path) for path in self.fmus}
        document["connections"] = connections
        document |= {"stimuli": self.stimuli} if self.stimuli else {}
        document |= {"run": run} if (run := self._run()) else {}
        document |= {"record": record} if (record := self._record()) else {}
        return Imported(document, {name: ".".join(path) for path, name in self.names.items()}, self.notes)

    def _described(self) -> dict[flattening.Path, FmuDescription]:
        """What the FMUs say of themselves, each read once."""
        read_once = cache(FmuDescription)
        fmus = {}
        for path, component in self.flat.components.items():
            with self._naming(path):
                fmus[path] = read_once(Path(component.file))
        return fmus

    def _assigned(self) -> Assignment:
        """What parameter sets give to variables that the FMUs have."""
        assignment = Assignment(self.flat, self.interfaces)
        assignment.gather((), self.description.system)
        self.values = assignment.values
        return assignment

    def _resize(self) -> bool:
        """Describe those FMUs anew whose arrays have the sizes of structural parameters that are given values; whether
        there are any."""
        resized = False
        for path, fmu in self.fmus.items():
            sizing = [((path, port.name), port) for port in fmu.interface.of("structuralParameter")]
            found = {port.name: self._given_to(node, port) for node, port in sizing}
            sizes = {name: size for name, size in found.items() if size is not None}
            if sizes:
                with self._naming(path):
                    self.fmus[path] = FmuDescription(fmu.path, None, sizes)
                self.interfaces[path], resized = self.fmus[path].interface, True
        return resized

    @contextmanager
    def _naming(self, path: flattening.Path) -> Iterator[None]:
        """Errors of an FMU name its component."""
        try:
            yield
        except FmuFileError as error:
            raise FmuFileError(f"{self.path}: {'.'.join(path)}", error.problem, error.fix) from error

    def _component(self, path: flattening.Path) -> RawMap:
        component, fmu = self.flat.components[path], self.fmus[path]
        made: RawMap = {"fmu": component.file}
        if component.exchange or FmuKind.CO_SIMULATION not in fmu.kinds:
            made["solver"] = {}
        return made | ({"parameters": self.parameters[path]} if self.parameters[path] else {})

    def _name(self, node: Node) -> str:
        """component.variable of a component's connector."""
        return f"{self.names[node[0]]}.{node[1]}"

    def _port(self, node: Node, place: str) -> Port:
        """The variable of a component's connector; of an array its first element."""
        path, name = node
        found = self._found(node)
        if found is None:
            ports = self.interfaces[path].ports
            file = Path(self.flat.components[path].file).name
            raise WiringError(place, f"{file} of {'.'.join(path)} has no variable '{name}'", nearest(name, ports))
        return found

    def _found(self, node: Node) -> Port | None:
        path, name = node
        ports = self.interfaces[path].ports
        return ports.get(name) or next((p for key, p in ports.items() if key.startswith(f"{name}[")), None)

    def _connection(self, node: Node) -> str | None:
        """The line of the connection into a component's variable; a value that comes from outside becomes its own."""
        if node[0] not in self.fmus:
            return None
        origin, hops = self.flat.way(node)
        port = self._port(node, hops[-1].place)
        if origin[0] in self.fmus:
            return self._line(origin, hops, node, port)
        given = next((at for at, hop in enumerate(hops) if hop.origin in self.values), None)
        if given is not None:
            here = hops[given].origin
            self._give(node, port, self._value(here, hops[given:], node, port), outermost=not here[0])
        elif self.flat.connector(origin).kind not in _SET_FROM_OUTSIDE:
            self.notes.append(
                f"{hops[0].place}: nothing sets {_dotted(origin)}; {self._name(node)} keeps its own value"
            )
        return None

    def _line(self, origin: Node, hops: list[Hop], node: Node, port: Port) -> str:
        source = self._port(origin, hops[0].place)
        began = passage.begin(source, self.flat.connector(origin), hops[0].units, hops[0].place)
        passed = passage.end(self._passed(began, hops, node, port), port, hops[-1].place)
        own = source.measure.name, port.measure.name  # of which the wiring tells
        self._tell([one for one in passed.doubts if (one.source, one.target) != own])
        conversion = passed.conversion
        if passed.table:
            conversion = passage.line_through(passed.table, source, port, hops[-1].place)
            if source.type not in ("Boolean", "Enumeration"):
                line = "values without an entry lie on the line through those with one, and do not stay as they are"
                self.notes.append(f"{hops[-1].place}: {line}")
        if _alike(conversion, self._by_units(source, port, hops)):
            return f"{self._name(origin)} -> {self._name(node)}"
        offset = f" + {conversion.offset!r}" if conversion.offset else ""
        return f"{conversion.factor!r} * {self._name(origin)}{offset} -> {self._name(node)}"

    def _by_units(self, source: Port, port: Port, hops: list[Hop]) -> Conversion | None:
        """What is done without any word; None where nothing can be."""
        try:
            return crossing("", source.measure, port.measure).conversion
        except WiringError:
            return None

    def _tell(self, doubts: Iterable[Crossing]) -> None:
        self.notes += [text for one in doubts if (text := str(one)) not in self.notes]

    def _contradictions(self) -> Iterator[str]:
        """Where the file says something else of a component's variable than its FMU, which counts."""
        for path, component in self.flat.components.items():
            for connector in component.connectors.values():
                said = contradiction(connector, self._found((path, connector.name)))
                if said:
                    yield f"{'.'.join((*path, connector.name))}: {said}"

    def _passed(self, passed: ValuePassage, hops: Sequence[Hop], node: Node, port: Port) -> ValuePassage:
        """What arrives at the connector of a component's variable."""
        ends = [*(hop.origin for hop in hops[1:]), node] if hops else []
        for hop, there in zip(hops, ends, strict=True):
            connector = self.flat.connector(there)
            if there == node:
                unit = passage.unit_at(port, connector, hop.units) if port.real else None
            else:
                unit = passage.meaning(connector.unit, hop.units)
            passed = passed.over(unit, hop.link.by_unit, hop.link.transformation, hop.place)
        return passed

    def _given_to(self, node: Node, port: Port) -> Any:
        """What a component's variable is given; None where it is nothing."""
        _, hops = self.flat.way(node)
        given = next((at for at, hop in enumerate(hops) if hop.origin in self.values), len(hops))
        here = hops[given].origin if hops[given:] else node
        return self._value(here, hops[given:], node, port) if here in self.values else None

    def _value(self, here: Node, hops: list[Hop], node: Node, port: Port) -> Any:
        """What a value assigned to a connector is in the unit of a component's variable, in nested lists where it is an
        array."""
        assigned = self.values[here]
        how = assigned.how
        self.used.add(here)
        connector, known = self.flat.connector(here), {**self.flat.units_at(here[0]), **assigned.units}
        if here == node:
            unit = passage.unit_at(port, connector, known) if port.real else None
        else:
            unit = passage.meaning(connector.unit, known)
        passed = assigned.passage().over(unit, how.by_unit, how.transformation, assigned.place)
        passed = passage.end(self._passed(passed, hops, node, port), port, assigned.place)
        self._tell(passed.doubts)
        change = _changed(passed, assigned.place)
        given, shape = assigned.parameter.value, assigned.parameter.shape
        values = [change(one) for one in (given if isinstance(given, tuple) else [given])]
        for value in values if port.settable else ():
            check_value(assigned.place, port, value)
        return _nested(values, shape) if isinstance(given, tuple) else values[0]

    def _give(self, node: Node, port: Port, value: Any, outermost: bool = False) -> None:
        name = self._name(node)
        if not port.settable:
            self.notes.append(f"{name} is given a value and cannot be set; it keeps its own")
        elif outermost and port.causality == "input" and port.numeric and not isinstance(value, list):
            self.stimuli[name] = {"constant": float(port.typed(name, value))}
        else:
            self.parameters[node[0]][node[1]] = value

    def _set_values(self) -> None:
        """Values that parameter sets give to variables of components; of what is not used a note."""
        for node in self.values:
            if node[0] in self.fmus:
                origins = [hop.origin for hop in self.flat.way(node)[1]]
                if not any(origin[0] in self.fmus or origin in self.values for origin in origins):
                    port = self._port(node, self.values[node].place)
                    self._give(node, port, self._value(node, [], node, port))
        for node, assigned in self.values.items():
            if node not in self.used:
                hops = self.flat.way(node)[1]
                source = next(
                    (hop.origin for hop in hops if hop.origin in self.values), hops[0].origin if hops else None
                )
                why = f"takes its value from {_dotted(source)}" if source else "leads to no variable; it is not used"
                self.notes.append(f"{assigned.place}: {_dotted(node)} {why}")

    def _record(self) -> list[str]:
        """What the outputs of the whole system show."""
        outputs = [one.name for one in self.description.system.connectors.values() if one.kind == "output"]
        found: dict[str, None] = {}
        for name in outputs:
            origin, hops = self.flat.way(((), name))
            if origin[0] in self.fmus and self._port(origin, hops[0].place).recordable:
                found[self._name(origin)] = None
            elif origin[0] not in self.fmus:
                what = f"has the value of {_dotted(origin)}, which no FMU computes" if hops else "has no source"
                self.notes.append(f"{name} {what}; it is not recorded")
        return list(found)

    def _run(self) -> dict[str, str]:
        """When it runs and how it steps, as far as it says."""
        start, stop = self.description.start, self.description.stop
        if stop is None:
            return {}
        begin, end = (_seconds(self.path, text) for text in (start or "0", stop))
        first = {"start": start} if start is not None and begin else {}
        step = self.description.step
        own = [_own_step(one) for one in self.fmus.values()]
        steps = {float(one): one for one in own if one}
        if step is None and steps:
            step = steps[min(steps)]
            self.notes.append(f"no communication step is said; {step} s is the least that its FMUs say")
        elif step is None:
            step = repr((end - begin) / STEPS)
            self.notes.append(f"no communication step is said; {step} s is a {STEPS}th of the run")
        return {**first, "stop": stop, "step": step}


def _own_step(fmu: FmuDescription) -> str:
    """The step that an FMU asks for [s]: of its default experiment, or the one that it takes inside; "" without."""
    experiment, fixed = fmu.description.defaultExperiment, fmu.interface.fixed_step
    return str((experiment.stepSize if experiment else None) or (repr(fixed) if fixed else ""))


def _dotted(node: Node) -> str:
    return ".".join((*node[0], node[1]))


def _seconds(path: Path, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FmuFileError(path, f"has a default experiment with the time '{text}'", "give it in seconds")
    return value


def _alike(one: Conversion, other: Conversion | None) -> bool:
    """The same but for rounding."""
    if other is None:
        return False
    pairs = ((one.factor, other.factor), (one.offset, other.offset))
    return all(math.isclose(a, b, rel_tol=1e-12, abs_tol=1e-300) for a, b in pairs)


def _changed(passed: ValuePassage, place: str) -> Callable[[Any], Any]:
    if passed.table:
        return lambda value: passage.mapped(passed.table, value, place)
    if passed.conversion == SAME:
        return lambda value: value
    return lambda value: passed.conversion(float(value))


def _nested(values: list[Any], shape: tuple[int, ...]) -> list[Any]:
    for size in reversed(shape[1:]):
        values = [values[at : at + size] for at in range(0, len(values), size)]
    return values
