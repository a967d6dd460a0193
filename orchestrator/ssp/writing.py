"""A wired system of FMUs as an SSP: a System Structure Description with what it needs, and nothing that misleads."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree as ET

from fmus.files import sha256
from fmus.packaging import archive
from fmus.packaging.description.xml import document
from fmus.parameters.ssv import Item, SetValue, parameter_set_element
from fmus.units import BASES
from orchestrator.crossing import NamedUnit
from orchestrator.fmi.file import FmuDescription, Kind
from orchestrator.fmi.interface import Interface, Port, Value
from orchestrator.ssp import package
from orchestrator.ssp.annotations import ROOT, SYSTEM
from orchestrator.ssp.names import FMU, SSC, SSD
from orchestrator.ssp.outline import Outline, Tool
from orchestrator.system import Connection, Endpoint

OMS = "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"
OSP = "http://opensimulationplatform.com/SSP/OSPAnnotations"
ET.register_namespace("oms", OMS)
ET.register_namespace("osp", OSP)
VALUES = "values"  # name of the parameter sets; one for all, since ecos is told one for all components
_KINDS = {"input": "input", "output": "output", "parameter": "parameter"}
_PLAIN = {"Float64": "Real", "Float32": "Real", "Binary": "", "Clock": ""}


def write(path: Path, outline: Outline, tool: Tool = Tool.ANY) -> list[str]:
    """Write the SSP; what the tool will do otherwise than we do comes back, a line each."""
    written = _Writing(outline, tool)
    description = document(written.root())
    files = {package.SYSTEM: description, **outline.others}
    files |= {name: file.read_bytes() for file, name in written.resources.values()}
    archive.write(path, files)
    return written.notes


class _Writing:
    def __init__(self, outline: Outline, tool: Tool) -> None:
        self.outline, self.tool = outline, tool
        self.units: dict[str, NamedUnit] = {}
        self.enumerations: dict[str, Mapping[str, int]] = {}
        self.notes: list[str] = []
        self.resources: dict[str, tuple[Path, str]] = {}
        for name, file in outline.files.items():
            self.resources.setdefault(sha256(file), (file, f"resources/{name}.fmu"))

    def root(self) -> ET.Element:
        outline = self.outline
        root = ET.Element(f"{SSD}SystemStructureDescription", {"version": "1.0", "name": outline.name})
        root.set("generationTool", "servotwin")
        if outline.description:
            root.set("description", outline.description)
        root.append(self._system())
        self._add_enumerations(root)
        self._add_units(root)
        times = outline.times
        experiment = ET.SubElement(root, f"{SSD}DefaultExperiment")
        experiment.attrib |= {"startTime": repr(times.start), "stopTime": repr(times.stop)}
        if self.tool is Tool.LIBCOSIM:
            inner = _annotation(experiment, "com.opensimulationplatform", f"{{{OSP}}}Algorithm")
            ET.SubElement(inner, f"{{{OSP}}}FixedStepAlgorithm", {"baseStepSize": repr(times.step)})
        self._add_annotations(root, ROOT)
        return root

    def _system(self) -> ET.Element:
        system = ET.Element(f"{SSD}System", {"name": self.outline.name})
        joined = self.tool.joins_system
        inputs, outputs = (self.outline.driven, self.outline.recorded) if joined else ({}, ())
        if inputs or outputs:
            connectors = ET.SubElement(system, f"{SSD}Connectors")
            for name in (*inputs, *outputs):
                self._add_connector(connectors, _outer(name), "input" if name in inputs else "output", self._port(name))
        constants = {_outer(name): value for name, value in inputs.items() if value is not None}
        self._add_values(system, VALUES, constants, {_outer(name): self._port(name) for name in inputs})
        elements = ET.SubElement(system, f"{SSD}Elements")
        for name in self.outline.files:
            elements.append(self._component(name))
        links = [self._connection(link) for link in self.outline.system.connections]
        links += [self._link(None, _outer(name), *_split(name)) for name in inputs]
        links += [self._link(*_split(name), None, _outer(name)) for name in outputs]
        if links:
            ET.SubElement(system, f"{SSD}Connections").extend(links)
        self._tell_driven()
        inner = _annotation(system, "org.openmodelica", f"{{{OMS}}}Annotations")
        information = ET.SubElement(inner, f"{{{OMS}}}SimulationInformation")
        step = {"description": "oms-ma", "stepSize": repr(self.outline.times.step)}
        ET.SubElement(
            information,
            f"{{{OMS}}}FixedStepMaster",
            step | {"absoluteTolerance": "1e-06", "relativeTolerance": "1e-06"},
        )
        self._add_annotations(system, SYSTEM)
        return system

    def _component(self, name: str) -> ET.Element:
        file, interface = self.outline.files[name], self.outline.system.parts[name].interface
        way = "CoSimulation" if self.outline.kinds[name] is Kind.CO_SIMULATION else "ModelExchange"
        element = ET.Element(f"{SSD}Component", {"name": name, "type": FMU, "source": self.resources[sha256(file)][1]})
        if way == "ModelExchange":
            element.set("implementation", way)
        connectors = ET.Element(f"{SSD}Connectors")
        for port in interface.ports.values():
            if self._is_connector(name, port):
                self._add_connector(connectors, port.name, _KINDS[port.causality], port)
        if len(connectors):
            element.append(connectors)
        values = self._values(name, interface)
        self._add_values(element, VALUES, values, interface.ports)
        self._add_annotations(element, name)
        return element

    def _add_annotations(self, element: ET.Element, name: str) -> None:
        """Those of other tools, behind our own."""
        kept = self.outline.annotations.get(name, ())
        parent = element.find(f"{SSD}Annotations")
        if kept:
            parent = ET.SubElement(element, f"{SSD}Annotations") if parent is None else parent
            parent.extend(ET.fromstring(one) for one in kept)

    def _is_connector(self, component: str, port: Port) -> bool:
        """Whether a variable is one: of an array an element that is connected, an enumeration where it is known."""
        if port.causality not in _KINDS or port.alone or (port.items and not self.tool.knows_items):
            return False
        end = Endpoint(component, port.name)
        return port.array is None or any(end in (link.source, link.target) for link in self.outline.system.connections)

    def _values(self, component: str, interface: Interface) -> dict[str, Value]:
        """Those of a component; what drives an input there, too, where the tool does not take it from outside."""
        given = {**self.outline.values}
        if not self.tool.joins_system:
            given |= {name: value for name, value in self.outline.driven.items() if value is not None}
        own = {
            name.removeprefix(f"{component}."): value for name, value in given.items() if _split(name)[0] == component
        }
        taken = {key: value for key, value in own.items() if self.tool.knows_items or not interface.ports[key].items}
        starts = FmuDescription(self.outline.files[component]).interface.ports
        for name in own if not self.tool.sets_values else own.keys() - taken.keys():
            port = starts[name]
            if port.start is None or port.parsed(port.start) != port.typed(name, own[name]):
                self.notes.append(f"{component}.{name}: {self.tool} does not take its value from an SSP")
        return taken

    def _add_connector(self, parent: ET.Element, name: str, kind: str, port: Port) -> None:
        connector = ET.SubElement(parent, f"{SSD}Connector", {"name": name, "kind": kind})
        written = _type_of(port)
        typed = ET.SubElement(connector, f"{SSC}{written}")
        if written == "Enumeration":
            typed.set("name", self._enumeration(port))
        if written == "Real" and port.unit:
            typed.set("unit", port.unit)
            self.units.setdefault(port.unit, port.measure)

    def _enumeration(self, port: Port) -> str:
        """Name of the enumeration with the items of a variable."""
        items = port.items or {}
        for name, known in self.enumerations.items():
            if known == items:
                return name
        name = f"enumeration{len(self.enumerations) + 1}"
        self.enumerations[name] = items
        return name

    def _add_values(
        self, parent: ET.Element, name: str, values: Mapping[str, Value], ports: Mapping[str, Port]
    ) -> None:
        if not values:
            return
        bindings = ET.SubElement(parent, f"{SSD}ParameterBindings")
        inline = ET.SubElement(ET.SubElement(bindings, f"{SSD}ParameterBinding"), f"{SSD}ParameterValues")
        written = {key: _set_value(ports[key], key, value) for key, value in values.items()}
        units = {key: str(ports[key].unit) for key in values if ports[key].real and ports[key].unit}
        inline.append(parameter_set_element(name, written, units))

    def _connection(self, link: Connection) -> ET.Element:
        element = self._link(link.source.component, link.source.variable, link.target.component, link.target.variable)
        units = {self.outline.system.port(end).unit or "" for end in (link.source, link.target)}
        if len(units) > 1 or (link.factor, link.offset) != (1.0, 0.0):
            element.set("suppressUnitConversion", "true")
        if (link.factor, link.offset) != (1.0, 0.0):
            change = {"factor": repr(link.factor), "offset": repr(link.offset)}
            ET.SubElement(element, f"{SSC}LinearTransformation", change)
            if not self.tool.transforms:
                self.notes.append(f"{link.source} -> {link.target}: {self.tool} does not multiply by {link.factor:g}")
        return element

    def _link(self, one: str | None, start: str, other: str | None, end: str) -> ET.Element:
        ends = {"startElement": one, "startConnector": start, "endElement": other, "endConnector": end}
        return ET.Element(f"{SSD}Connection", {key: name for key, name in ends.items() if name is not None})

    def _port(self, name: str) -> Port:
        return self.outline.system.port(Endpoint.parse(name))

    def _tell_driven(self) -> None:
        """What only this project plays back."""
        for name, value in self.outline.driven.items():
            if value is None:
                self.notes.append(f"{name}: its recording goes along, and an SSP cannot say that it is played back")

    def _add_enumerations(self, root: ET.Element) -> None:
        if self.enumerations:
            parent = ET.SubElement(root, f"{SSD}Enumerations")
            for name, items in self.enumerations.items():
                entry = ET.SubElement(parent, f"{SSC}Enumeration", {"name": name})
                for item, number in items.items():
                    ET.SubElement(entry, f"{SSC}Item", {"name": item, "value": str(number)})

    def _add_units(self, root: ET.Element) -> None:
        if not self.units:
            return
        parent = ET.SubElement(root, f"{SSD}Units")
        for name, measure in sorted(self.units.items()):
            base = ET.SubElement(ET.SubElement(parent, f"{SSC}Unit", {"name": name}), f"{SSC}BaseUnit")
            if measure.unit is not None:
                powers = zip(BASES, measure.unit.exponents, strict=True)
                base.attrib |= {power: str(count) for power, count in powers if count}
                scale = {"factor": (measure.unit.factor, 1.0), "offset": (measure.unit.offset, 0.0)}
                base.attrib |= {key: repr(value) for key, (value, default) in scale.items() if value != default}


def _annotation(parent: ET.Element, kind: str, tag: str) -> ET.Element:
    """The element inside a new annotation."""
    annotations = ET.SubElement(parent, f"{SSD}Annotations")
    return ET.SubElement(ET.SubElement(annotations, f"{SSC}Annotation", {"type": kind}), tag)


def _outer(name: str) -> str:
    """Name of the connector of the system for a component's variable."""
    return name.replace(".", "_", 1)


def _split(name: str) -> tuple[str, str]:
    component, _, variable = name.partition(".")
    return component, variable


def _type_of(port: Port) -> str:
    if port.items:
        return "Enumeration"
    if port.real:
        return "Real"
    return port.type if port.type in ("Boolean", "String") else "Integer"


def _set_value(port: Port, name: str, value: Value) -> SetValue:
    typed = port.typed(name, value)
    if port.items:
        return Item(next(item for item, number in port.items.items() if number == typed))
    return typed
