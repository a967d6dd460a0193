"""Nested systems made flat: which component's variable comes from where, whatever connectors lie between."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

from fmus.errors import WiringError
from fmus.units import Unit
from fmus.words import nearest
from orchestrator.ssp.description import (
    Connector,
    Description,
    DictionaryReference,
    Element,
    SsdComponent,
    SsdConnection,
    SystemElement,
)

Path = tuple[str, ...]
Node = tuple[Path, str]
"""A connector: where its element is, from the outermost system in; and its name."""

_GIVES = {  # kinds of connectors: whether values come out of them, seen from outside
    "output": True,
    "calculatedParameter": True,
    "constant": True,
    "local": True,
    "input": False,
    "parameter": False,
    "structuralParameter": False,
}
_DICTIONARY = "(dictionary) "  # before the name of one, in the path of its nodes: no element is named so


@dataclass(frozen=True)
class Hop:
    """A connection, and the node that it comes from.

    Attributes:
        units: what units are where it stands.
    """

    origin: Node
    link: SsdConnection
    place: str
    units: Mapping[str, Unit]


@dataclass
class FlatSystem:
    """A system without systems in it.

    Attributes:
        components: those of all systems, by where they are.
        systems: all systems, by where they are; the outermost one at ().
        units: what units are, by where a system is.
        incoming: connector -> what is connected to it.
        entries: entry of a signal dictionary -> its connector.
    """

    place: str
    components: dict[Path, SsdComponent] = field(default_factory=dict)
    systems: dict[Path, SystemElement] = field(default_factory=dict)
    units: dict[Path, Mapping[str, Unit]] = field(default_factory=dict)
    incoming: dict[Node, Hop] = field(default_factory=dict)
    entries: dict[Node, Connector] = field(default_factory=dict)

    def connector(self, node: Node) -> Connector:
        """What is said of a connector; of a component's that the file does not declare nothing but its name."""
        path, name = node
        if node in self.entries:
            return self.entries[node]
        owner: Element = self.components[path] if path in self.components else self.systems[path]
        return owner.declared(name) or Connector(name, "unspecified")

    def units_at(self, path: Path) -> Mapping[str, Unit]:
        """What units are in the system that holds an element, or in this system."""
        return self.units[path if path in self.units else path[:-1]]

    def way(self, node: Node) -> tuple[Node, list[Hop]]:
        """Where the value of a connector comes from in the end, and what it passes, the source first.

        Raises:
            WiringError: it comes from itself.
        """
        hops: list[Hop] = []
        seen = {node}
        while node in self.incoming:
            hops.append(self.incoming[node])
            node = hops[-1].origin
            if node in seen:
                raise WiringError(hops[-1].place, "is on a circle of connectors without a source", "remove it")
            seen.add(node)
        return node, hops[::-1]


def flattened(description: Description, place: str) -> FlatSystem:
    """The components of a description and its connections.

    Raises:
        WiringError: a connection without an end, two into one connector, or an unknown signal dictionary.
    """
    flat = FlatSystem(place)
    _gather(flat, (), description.system, {}, ())
    return flat


def component_names(paths: Iterator[Path] | list[Path]) -> dict[Path, str]:
    """A name for each component: its own, behind those of the systems that it is in; letters, digits, underscores."""
    names: dict[Path, str] = {}
    taken: set[str] = set()
    for path in paths:
        plain = re.sub(r"\W", "_", "__".join(path)) or "_"
        stem = plain if plain.isidentifier() else f"_{plain}"
        name, number = stem, 2
        while name in taken:
            name, number = f"{stem}_{number}", number + 1
        names[path] = name
        taken.add(name)
    return names


Scopes = tuple[tuple[Path, SystemElement], ...]


def _gather(flat: FlatSystem, path: Path, system: SystemElement, units: Mapping[str, Unit], outer: Scopes) -> None:
    """Take up a system and all in it; `outer` are the systems around it, the nearest first."""
    known = {**units, **system.units}
    scopes = ((path, system), *outer)
    flat.systems[path], flat.units[path] = system, known
    for dictionary, entries in system.dictionaries.items():
        flat.entries |= {_entry(path, dictionary, name): connector for name, connector in entries.items()}
    for name, element in system.elements.items():
        if isinstance(element, SystemElement):
            _gather(flat, (*path, name), element, known, scopes)
        elif isinstance(element, SsdComponent):
            flat.components[*path, name] = element
    for link in system.connections:
        place = f"{flat.place}: {'.'.join(path)}{': ' if path else ''}{link}"
        directed = _directed(link, system, place)
        start, end = (_node(one, path, system, scopes, place) for one in (directed.start, directed.end))
        if end in flat.incoming:
            raise WiringError(place, f"its end has a source already, by {flat.incoming[end].link}", "remove one")
        flat.incoming[end] = Hop(start, directed, place, known)


def _directed(link: SsdConnection, system: SystemElement, place: str) -> SsdConnection:
    """A connection from source to target, which kinds tell and not which end is called the start; as it is written
    where they do not.

    Raises:
        WiringError: it joins two sources, or two targets, and one of them is a connector of a system.
    """
    start, end = (_gives(one, system) for one in (link.start, link.end))
    if start is end and start is not None and not all(_of_component(one, system) for one in (link.start, link.end)):
        what = "give values there, and take none" if start else "take values there, and give none"
        raise WiringError(place, f"joins two connectors that {what}", "correct the kind of one")
    turned = start is False or (start is None and end is True)
    return replace(link, start=link.end, end=link.start) if turned and start is not end else link


def _gives(end: tuple[str, str], system: SystemElement) -> bool | None:
    """Whether values come out of an end of a connection in a system, by its kind; None where that leaves it open."""
    name, connector = end
    owner: Element | None = system.elements.get(name) if name else system
    declared = None if owner is None else owner.declared(connector)
    if declared is None or declared.kind not in _GIVES:
        return None
    return _GIVES[declared.kind] is bool(name)


def _of_component(end: tuple[str, str], system: SystemElement) -> bool:
    """Whether it is a component's, whose FMU has the last word."""
    return isinstance(system.elements.get(end[0]), SsdComponent)


def _node(end: tuple[str, str], path: Path, system: SystemElement, scopes: Scopes, place: str) -> Node:
    """The node at an end of a connection."""
    name, connector = end
    element = system.elements.get(name) if name else system
    if element is None:
        raise WiringError(place, f"there is no element '{name}'", nearest(name, system.elements))
    if isinstance(element, DictionaryReference):
        return _in_dictionary(element, connector, scopes, place)
    if isinstance(element, SystemElement) and element.declared(connector) is None:
        problem = f"there is no connector '{connector}' of {name or 'the system'}"
        raise WiringError(place, problem, nearest(connector, element.connectors))
    return ((*path, name) if name else path), connector


def _in_dictionary(reference: DictionaryReference, connector: str, scopes: Scopes, place: str) -> Node:
    name = reference.dictionary
    found = next((scope for scope in scopes if name in scope[1].dictionaries), None)
    if found is None:
        raise WiringError(place, f"there is no signal dictionary '{name}'", "define it")
    path, system = found
    if connector not in system.dictionaries[name]:
        known = nearest(connector, system.dictionaries[name])
        raise WiringError(place, f"the signal dictionary '{name}' has no entry '{connector}'", known)
    return _entry(path, name, connector)


def _entry(path: Path, dictionary: str, name: str) -> Node:
    return (*path, _DICTIONARY + dictionary), name
