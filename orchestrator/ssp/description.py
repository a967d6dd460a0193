"""What a System Structure Description says, in plain values; elements and connectors have the names that it gives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from fmus.units import Unit

Entries = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Transformation:
    """What a value is changed by, once it is in the unit of its target: target = factor * value + offset, or a table.

    Attributes:
        entries: source -> target of a table, as they are written; of booleans, integers or names of items.
    """

    factor: float = 1.0
    offset: float = 0.0
    entries: Entries = ()


@dataclass(frozen=True)
class Connector:
    """A connector: of a component a variable of its FMU.

    Attributes:
        kind: input, output, parameter, calculatedParameter, inout, ...
        type: Real, Integer, Boolean, Float64, ...; "" where it does not say.
        unit: None where it does not say.
        sizes: of an array, as they are written; () where it does not say.
    """

    name: str
    kind: str
    type: str = ""
    unit: str | None = None
    sizes: tuple[str, ...] = ()


@dataclass(frozen=True)
class SsdConnection:
    """From a connector to another, each (element, connector); the element "" is the system itself.

    Attributes:
        by_unit: whether units are converted on the way.
    """

    start: tuple[str, str]
    end: tuple[str, str]
    transformation: Transformation | None = None
    by_unit: bool = True

    def __str__(self) -> str:
        return " -> ".join(".".join(filter(None, end)) for end in (self.start, self.end))


@dataclass(frozen=True)
class SsvParameter:
    """A value of a parameter set.

    Attributes:
        value: of an array a tuple of all elements, row by row.
        shape: of an array; () of a scalar.
        line: of its file.
    """

    value: float | int | bool | str | tuple[float | int | bool | str, ...]
    unit: str | None = None
    shape: tuple[int, ...] = ()
    line: int = field(default=0, compare=False)


@dataclass(frozen=True)
class MappingEntry:
    """Which parameter of a set gives its value to which variable, and how."""

    source: str
    target: str
    transformation: Transformation | None = None
    by_unit: bool = True


@dataclass(frozen=True)
class Binding:
    """A parameter set for an element.

    Attributes:
        place: file and name of the set, for messages.
        units: what the units of the set are, by its own word.
        mapping: None where names are used as they are.
        outside: whether it stands with the component that a system in a file of its own is for.
    """

    place: str
    values: Mapping[str, SsvParameter]
    units: Mapping[str, Unit] = field(default_factory=dict)
    mapping: tuple[MappingEntry, ...] | None = None
    outside: bool = False


@dataclass(frozen=True)
class Element:
    """What components, systems and references to signal dictionaries have in common."""

    name: str
    connectors: Mapping[str, Connector]
    bindings: tuple[Binding, ...] = ()

    def declared(self, name: str) -> Connector | None:
        """The connector of this name, of an element of an array that of the array; None where there is none."""
        return self.connectors.get(name) or self.connectors.get(name.partition("[")[0])


@dataclass(frozen=True)
class SsdComponent(Element):
    """An FMU.

    Attributes:
        file: where it is in the archive.
        exchange: whether it is to be run by model exchange.
    """

    file: str = ""
    exchange: bool = False


@dataclass(frozen=True)
class DictionaryReference(Element):
    """Stands for a signal dictionary, whose entries its connectors are."""

    dictionary: str = ""


@dataclass(frozen=True)
class SystemElement(Element):
    """A system: elements by name, and what is connected.

    Attributes:
        dictionaries: names of the signal dictionaries that are defined here -> their entries.
        units: what units are by the word of its file.
        outside: its connectors by the word of the component that it is for, where it is in a file of its own.
    """

    elements: Mapping[str, Element] = field(default_factory=dict)
    connections: tuple[SsdConnection, ...] = ()
    dictionaries: Mapping[str, Mapping[str, Connector]] = field(default_factory=dict)
    units: Mapping[str, Unit] = field(default_factory=dict)
    outside: Mapping[str, Connector] = field(default_factory=dict)


@dataclass(frozen=True)
class Description:
    """A whole description.

    Attributes:
        start, stop: of the default experiment [s]; as they are written, so that no digit is lost.
        step: communication step that some tool has noted [s].
        notes: what was seen and not understood, a line each.
    """

    name: str
    version: str
    system: SystemElement
    start: str | None = None
    stop: str | None = None
    step: str | None = None
    notes: tuple[str, ...] = ()
