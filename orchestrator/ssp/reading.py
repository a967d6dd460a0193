"""An SSP as a `Description`: SSD 1.0 and 2.0 with any prefixes, systems in files of their own, what they refer to."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from fmus.errors import FmuFileError
from fmus.packaging import archive
from orchestrator.ssp.description import (
    Binding,
    Connector,
    Description,
    DictionaryReference,
    Element,
    SsdComponent,
    SsdConnection,
    SystemElement,
)
from orchestrator.ssp.names import (
    DEFINITION,
    DICTIONARY,
    FMU,
    MAPPING,
    PACKAGE,
    PARAMETERS,
    SSB,
    SSC,
    SSD,
    STEPS,
    Version,
)
from orchestrator.ssp.package import SYSTEM, SspPackage
from orchestrator.ssp.parameters import mapping, parameters, required, transformation, truth, units

if TYPE_CHECKING:
    from lxml import etree

DEEPEST = 20  # files of systems in files of systems
_UNIT = ("Real", "Float64", "Float32")
Named = TypeVar("Named", Element, Connector)


def read(path: Path) -> Description:
    """What an SSP says.

    Raises:
        FmuFileError: it is no SSP, refers to what it does not hold, holds itself, or is not as the standard has it.
    """
    with SspPackage(path) as package:
        found = _DescriptionFile(package, SYSTEM, ()).description()
        others = (f"{name} is another system, which is not used" for name in package.variants)
        return replace(found, notes=(*found.notes, *others))


@dataclass(frozen=True)
class _DescriptionFile:
    """A description on its way: its file in an archive, and those that it is inside of."""

    package: SspPackage
    name: str
    inside: tuple[str, ...]

    @property
    def place(self) -> str:
        return self.package.place(self.name)

    def description(self) -> Description:
        if self.place in self.inside:
            chain = " -> ".join((*self.inside[self.inside.index(self.place) :], self.place))
            raise FmuFileError(self.place, f"is a system within itself: {chain}", "leave one of these out")
        if len(self.inside) >= DEEPEST:
            raise FmuFileError(self.place, f"is nested more than {DEEPEST} files deep", "do not trust it")
        root = self.package.xml(self.name)
        if root.tag != f"{SSD}SystemStructureDescription":
            raise FmuFileError(self.place, "is no System Structure Description", "export the SSP again")
        version = root.get("version", "")
        if version not in list(Version):
            raise FmuFileError(self.place, f"is of SSP version '{version}'", f"export it as {' or '.join(Version)}")
        system = root.find(f"{SSD}System")
        if system is None:
            raise FmuFileError(self.place, "holds no System", "export the SSP again")
        experiment = root.find(f"{SSD}DefaultExperiment")
        times = {} if experiment is None else experiment.attrib
        step, others = _annotated(root)
        return Description(
            root.get("name", ""),
            version,
            replace(self.system(system), units=units(root.find(f"{SSD}Units"), self.place)),
            times.get("startTime"),
            times.get("stopTime"),
            step,
            tuple(f"annotations of {kind} are kept and not used" for kind in others),
        )

    def system(self, entry: etree._Element) -> SystemElement:
        """A system with all that is in it."""
        element, scope = self.element(entry), f"{SSD}SignalDictionaries/{SSD}SignalDictionary"
        elements = [self.child(child) for child in entry.iterfind(f"{SSD}Elements/*")]
        dictionaries = {required(d, "name", self.place): self.dictionary(d) for d in entry.iterfind(scope)}
        links = entry.iterfind(f"{SSD}Connections/{SSD}Connection")
        return SystemElement(
            element.name,
            element.connectors,
            element.bindings,
            self.distinct(elements, element.name),
            tuple(self.connection(link) for link in links),
            dictionaries,
        )

    def child(self, entry: etree._Element) -> Element:
        """An element of a system."""
        kind = str(entry.tag).removeprefix(SSD)
        if kind == "System":
            return self.system(entry)
        element = self.element(entry)
        if kind == "SignalDictionaryReference":
            target = required(entry, "dictionary", self.place)
            return DictionaryReference(element.name, element.connectors, element.bindings, target)
        if kind != "Component":
            raise FmuFileError(f"{self.place}:{entry.sourceline}", f"'{kind}' is no element of a system", "remove it")
        return self.component(entry, element)

    def component(self, entry: etree._Element, element: Element) -> Element:
        """An FMU, or the system in a file that a component stands for."""
        place, kind = f"{self.place}: {element.name}", entry.get("type", FMU)
        source, way = entry.get("source"), entry.get("implementation", "any")
        if source is None:
            raise FmuFileError(place, "has no source", "give it an FMU")
        name = self.package.resolved(source, self.name, place)
        if kind in (DEFINITION, PACKAGE):
            return self.included(kind, name, element)
        if kind != FMU:
            raise FmuFileError(place, f"is of type {kind}, which cannot be run", "export it as an FMU")
        if way not in ("any", "CoSimulation", "ModelExchange"):
            raise FmuFileError(place, f"is to be run by {way}", "export it for co-simulation")
        file = self.package.unpacked(name)
        return SsdComponent(element.name, element.connectors, element.bindings, str(file), way == "ModelExchange")

    def included(self, kind: str, name: str, element: Element) -> SystemElement:
        """The system of another file; the component's own bindings come after those that it has."""
        inside = (*self.inside, self.place)
        if kind == DEFINITION:
            system = _DescriptionFile(self.package, name, inside).description().system
        else:
            with SspPackage(self.package.unpacked(name), self.package.place(name)) as package:
                system = _DescriptionFile(package, SYSTEM, inside).description().system
        outside = (replace(binding, outside=True) for binding in element.bindings)
        bindings = (*system.bindings, *outside)
        return replace(system, name=element.name, bindings=bindings, outside=element.connectors)

    def element(self, entry: etree._Element) -> Element:
        """Name, connectors and bindings."""
        name = entry.get("name", "") if entry.tag == f"{SSD}System" else required(entry, "name", self.place)
        connectors = [self.connector(one) for one in entry.iterfind(f"{SSD}Connectors/{SSD}Connector")]
        place = f"{self.place}: {name}"
        bindings = entry.iterfind(f"{SSD}ParameterBindings/{SSD}ParameterBinding")
        return Element(
            name,
            self.distinct(connectors, name),
            tuple(self.binding(one, place, entry.get("source")) for one in bindings),
        )

    def connector(self, entry: etree._Element) -> Connector:
        kind, unit = typed(entry)
        sizes = tuple(one.get("size", "") for one in entry.iterfind(f"{SSC}Dimension"))
        return Connector(
            required(entry, "name", self.place),
            required(entry, "kind", self.place),
            kind,
            unit,
            sizes if all(sizes) else (),
        )

    def connection(self, entry: etree._Element) -> SsdConnection:
        place = f"{self.place}:{entry.sourceline}"
        ends = [
            (entry.get(f"{end}Element", ""), _indexed(required(entry, f"{end}Connector", self.place), entry, end))
            for end in ("start", "end")
        ]
        by_unit = not truth(entry, "suppressUnitConversion", place)
        return SsdConnection(ends[0], ends[1], transformation(entry, place), by_unit)

    def dictionary(self, entry: etree._Element) -> dict[str, Connector]:
        """The entries of a signal dictionary by name."""
        place = f"{self.place}: {entry.get('name')}"
        root, _ = self.content(entry, entry, DICTIONARY, f"{SSB}SignalDictionary", place, None)
        found = {}
        for line in root.iterfind(f"{SSB}DictionaryEntry"):
            kind, unit = typed(line)
            name = required(line, "name", place)
            found[name] = Connector(name, "inout", kind, unit)
        return found

    def binding(self, entry: etree._Element, place: str, owner: str | None) -> Binding:
        """A parameter set for an element, and how its names are mapped; `owner` is the source of the element."""
        inline = entry.find(f"{SSD}ParameterValues")
        root, place = self.content(entry, inline, PARAMETERS, "ParameterSet", place, owner)
        prefix, mapped = entry.get("prefix", ""), None
        described = entry.find(f"{SSD}ParameterMapping")
        if described is not None:
            mapped = mapping(*self.content(described, described, MAPPING, "ParameterMapping", place, owner))
        values = {prefix + name: value for name, value in parameters(root, place).items()}
        return Binding(place, values, units(root.find("{*}Units"), place), mapped)

    def content(
        self,
        entry: etree._Element,
        inline: etree._Element | None,
        kind: str,
        tag: str,
        place: str,
        owner: str | None,
    ) -> tuple[etree._Element, str]:
        """The document that stands in an element or in the file that it names, and how it is called."""
        if entry.get("type", kind) != kind:
            raise FmuFileError(place, f"uses values of type {entry.get('type')}", f"convert them to {kind}")
        source = entry.get("source")
        if source is None:
            root = None if inline is None else next(inline.iterchildren("{*}*"), None)
            if root is None:
                raise FmuFileError(place, f"has a {tag.rpartition('}')[2]} without source and contents", "remove it")
            return root, place
        if entry.get("sourceBase", "SSD") == "component":
            return self.within(source, owner, place)
        name = self.package.resolved(source, self.name, place)
        return self.package.xml(name), self.package.place(name)

    def within(self, source: str, owner: str | None, place: str) -> tuple[etree._Element, str]:
        """A document inside the FMU of a component."""
        if owner is None:
            raise FmuFileError(place, f"names '{source}' inside a component that has no source", "correct its source")
        file = self.package.unpacked(self.package.resolved(owner, self.name, place))
        there = f"{self.package.place(owner)}: {source}"
        with archive.opened(file) as zipped:
            if source not in zipped.NameToInfo:
                raise FmuFileError(there, "is not in the FMU", "correct the source")
        return archive.parse_xml(there, archive.read(file)[source]), there

    def distinct(self, found: Iterable[Named], owner: str) -> dict[str, Named]:
        """By name, each once."""
        named: dict[str, Named] = {}
        for one in found:
            if one.name in named:
                raise FmuFileError(f"{self.place}: {owner}", f"holds '{one.name}' twice", "rename one")
            named[one.name] = one
        return named


def typed(entry: etree._Element) -> tuple[str, str | None]:
    """Type and unit of a connector or an entry of a dictionary; "" and None where it does not say."""
    for child in entry.iterchildren("{*}*"):
        kind = str(child.tag).removeprefix(SSC)
        if kind not in ("Dimension", "Annotations") and child.tag != kind:
            return kind, child.get("unit") if kind in _UNIT else None
    return "", None


def _indexed(name: str, entry: etree._Element, end: str) -> str:
    """A connector, or the element of it that a connection is restricted to."""
    indices = entry.get(f"{end}Indices", "").split()
    return f"{name}[{','.join(indices)}]" if indices else name


def _annotated(root: etree._Element) -> tuple[str | None, list[str]]:
    """The communication step that a tool has noted, and who wrote other annotations."""
    step, others = None, dict[str, None]()
    for annotation in root.iter(f"{SSC}Annotation"):
        found: dict[str, str] = {}
        for child in annotation.iterdescendants("{*}*"):
            found |= {key: str(value) for key, value in child.attrib.items() if key in STEPS}
        step = step or next(iter(found.values()), None)
        if not found:
            others[annotation.get("type", "")] = None
    return step, list(others)
