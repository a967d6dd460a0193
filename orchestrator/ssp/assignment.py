"""Which parameter sets give which variables their values, on all levels; what is farther out counts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

from fmus.units import Unit
from orchestrator.fmi.interface import Interface
from orchestrator.ssp.description import Binding, Element, MappingEntry, SsdComponent, SsvParameter, SystemElement
from orchestrator.ssp.flattening import FlatSystem, Node, Path
from orchestrator.ssp.passage import NO_UNIT, ValuePassage, meaning


@dataclass(frozen=True)
class Assigned:
    """A value on its way to a connector or variable.

    Attributes:
        units: what units are by the word of its set and of the file.
        how: the entry of the mapping that brought it here.
    """

    parameter: SsvParameter
    place: str
    units: Mapping[str, Unit]
    how: MappingEntry

    def passage(self) -> ValuePassage:
        """How its number starts its way."""
        return ValuePassage(meaning(self.parameter.unit, self.units) or NO_UNIT)


@dataclass
class Assignment:
    """All values of a system.

    Attributes:
        values: connector of a system or variable of a component -> what it is given.
        notes: names that match nothing, a line each.
    """

    flat: FlatSystem
    interfaces: Mapping[Path, Interface]
    values: dict[Node, Assigned] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def gather(self, path: Path, element: Element) -> None:
        """Take up the values of an element and all in it; those of the element itself count."""
        if isinstance(element, SystemElement):
            for name, child in element.elements.items():
                self.gather((*path, name), child)
        for binding in element.bindings:
            self._bind(path, element, binding)

    def _bind(self, path: Path, element: Element, binding: Binding) -> None:
        known = {**self.flat.units_at(path), **binding.units}
        sources: dict[str, str] = {}
        for entry in _entries(binding):
            parameter = binding.values.get(entry.source)
            if parameter is None:
                self.notes.append(f"{binding.place}: its mapping names '{entry.source}', which is not in the set")
                continue
            if before := sources.get(entry.target):
                twice = f"'{entry.target}' is mapped twice, '{entry.source}' counts, not '{before}'"
                self.notes.append(f"{binding.place}: {twice}")
            sources[entry.target] = entry.source
            nodes = self._targets(path, element, entry.target)
            for node in nodes:
                given = self._from_outside(parameter, node) if binding.outside or node[0] != path else parameter
                self.values[node] = Assigned(given, f"{binding.place}: {entry.source}", known, entry)
            if not nodes:
                where = ".".join(path) or element.name or "the system"
                self.notes.append(f"{binding.place}: '{entry.target}' matches nothing in {where}; it is not used")
        if binding.mapping is not None:
            used = {entry.source for entry in binding.mapping}
            left = [name for name in binding.values if name not in used]
            self.notes += [f"{binding.place}: '{name}' is not mapped, and not used" for name in left]

    def _from_outside(self, parameter: SsvParameter, node: Node) -> SsvParameter:
        """A value without a unit in that which the component of a system in a file of its own says of its connector."""
        system = self.flat.systems.get(node[0])
        connector = system.outside.get(node[1]) if system else None
        return replace(parameter, unit=connector.unit) if connector and parameter.unit is None else parameter

    def _targets(self, path: Path, element: Element, name: str) -> list[Node]:
        """What a name means in an element: connectors of it, and variables of what is in it; all that are called so."""
        if isinstance(element, SsdComponent):
            interface = self.interfaces[path]
            return [(path, name)] if name in interface.ports or interface.shape(name) else []
        found = [(path, name)] if name in element.connectors else []
        if isinstance(element, SystemElement):
            for index in (at for at, letter in enumerate(name) if letter == "."):
                if child := element.elements.get(name[:index]):
                    found += self._targets((*path, name[:index]), child, name[index + 1 :])
        return found


def _entries(binding: Binding) -> Iterator[MappingEntry]:
    if binding.mapping is not None:
        yield from binding.mapping
    else:
        yield from (MappingEntry(name, name) for name in binding.values)
