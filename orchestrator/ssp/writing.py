"""A wired system of FMUs as an SSP: a System Structure Description with what it needs, and nothing that misleads."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

from fmus.files import sha256
from fmus.modelling.model import element_names
from fmus.packaging import archive
from fmus.packaging.description.xml import document
from fmus.parameters.ssv import parameter_set_element
from fmus.units import BASES
from orchestrator.crossing import NamedUnit
from orchestrator.fmi.clocks.declared import Clock
from orchestrator.fmi.file import FmuDescription, FmuKind
from orchestrator.fmi.interface import Interface, Port, Value
from orchestrator.ssp import package
from orchestrator.ssp.annotations import ROOT, SYSTEM
from orchestrator.ssp.names import FMU, SSC, SSD, Version
from orchestrator.ssp.outline import Outline, Tool
from orchestrator.ssp.variables import ConnectorVariable, clock_attributes, indexed, set_values, type_name, variables
from orchestrator.system import COMPUTED, Connection, Endpoint, component_values

OMS = "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"
OSP = "http://opensimulationplatform.com/SSP/OSPAnnotations"
ET.register_namespace("oms", OMS)
ET.register_namespace("osp", OSP)
VALUES = "values"  # name of the parameter sets; one for all, since ecos is told one for all components
_KINDS = ("input", "output", "parameter")


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
        self.links = [*outline.system.connections, *outline.system.settled]
        self.ends = {end for link in self.links for end in (link.source, link.target)}
        self.outer = _outer_names([*outline.driven, *outline.recorded])
        self.units: dict[str, NamedUnit] = {}
        self.enumerations: dict[str, Mapping[str, int]] = {}
        self.notes: list[str] = []
        self.resources: dict[str, tuple[Path, str]] = {}
        for name, file in outline.files.items():
            self.resources.setdefault(sha256(file), (file, f"resources/{name}.fmu"))

    def root(self) -> ET.Element:
        outline = self.outline
        root = ET.Element(f"{SSD}SystemStructureDescription", {"version": outline.version, "name": outline.name})
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
                outer = ConnectorVariable(self.outer[name], self._port(name))
                self._add_connector(connectors, outer, "input" if name in inputs else "output")
        constants = {self.outer[name]: value for name, value in inputs.items() if value is not None}
        self._add_values(
            system, "", constants, {self.outer[name]: replace(self._port(name), array=None) for name in inputs}
        )
        elements = ET.SubElement(system, f"{SSD}Elements")
        for name in self.outline.files:
            elements.append(self._component(name))
        links = [self._connection(link) for link in self._joined()]
        links += [self._link(link.source, link.target) for link in self.outline.system.clocks]
        links += [self._link(link.source, link.target) for link in self.outline.system.texts]
        links += [self._link(Endpoint("", self.outer[name]), Endpoint.parse(name)) for name in inputs]
        links += [self._link(Endpoint.parse(name), Endpoint("", self.outer[name])) for name in outputs]
        if links:
            ET.SubElement(system, f"{SSD}Connections").extend(links)
        self._tell_driven()
        if self.tool is not Tool.ANY:
            self.notes += [
                f"{link.source} -> {link.target}: {self.tool} is not known to give a parameter a calculated value"
                for link in self.outline.system.settled
            ]
        if self.outline.version is Version.ONE:
            self.notes += [
                f"{link}: SSP 1.0 knows no clocks; it joins connectors without a type"
                for link in self.outline.system.clocks
            ]
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
        if interface.clocks and self.tool is Tool.ECOS:
            self.notes.append(f"{name}: ecos aborts where it closes an FMU with clocks; give it one of FMI 2.0")
        way = "CoSimulation" if self.outline.kinds[name] is FmuKind.CO_SIMULATION else "ModelExchange"
        element = ET.Element(f"{SSD}Component", {"name": name, "type": FMU, "source": self.resources[sha256(file)][1]})
        if way == "ModelExchange":
            element.set("implementation", way)
        connectors = ET.Element(f"{SSD}Connectors")
        for variable in variables(interface.ports.values(), self.outline.version):
            if self._is_connector(name, variable):
                clock = interface.clocks.get(variable.name)
                self._add_connector(connectors, variable, self._kind(name, variable), clock)
        if len(connectors):
            element.append(connectors)
        values = self._values(name, interface)
        self._add_values(element, name, values, interface.ports)
        self._add_annotations(element, name)
        return element

    def _kind(self, component: str, variable: ConnectorVariable) -> str:
        """What kind of connector a variable has."""
        kind = variable.port.causality
        if kind != "local" or self.outline.version is not Version.ONE:
            return kind
        self.notes.append(f"{component}.{variable.name}: SSP 1.0 knows no local connectors; it is said to be an output")
        return "output"

    def _add_annotations(self, element: ET.Element, name: str) -> None:
        """Those of other tools, behind our own."""
        kept = self.outline.annotations.get(name, ())
        parent = element.find(f"{SSD}Annotations")
        if kept:
            parent = ET.SubElement(element, f"{SSD}Annotations") if parent is None else parent
            parent.extend(ET.fromstring(one) for one in kept)

    def _is_connector(self, component: str, variable: ConnectorVariable) -> bool:
        """Whether a variable is one: of an array in 1.0 an element that is connected, an enumeration where it is
        known."""
        port, sizes = variable.port, variable.port.causality == "structuralParameter"
        if port.causality in COMPUTED:
            return self._joins(component, variable)
        if port.causality not in _KINDS and not (sizes and self.outline.version is Version.TWO):
            return False
        if port.type == "Clock":
            ends = {end for link in self.outline.system.clocks for end in (link.source, link.target)}
            return self.outline.version is Version.TWO or Endpoint(component, port.name) in ends
        if port.type == "Binary":
            ends = {end for link in self.outline.system.texts for end in (link.source, link.target)}
            return Endpoint(component, port.name) in ends
        if port.items and not self.tool.knows_items:
            return False
        return port.array is None or bool(variable.shape) or self._joins(component, variable)

    def _joins(self, component: str, variable: ConnectorVariable) -> bool:
        """Whether a connection has it, or an element of it, at an end."""
        names = element_names(variable.name, variable.shape) if variable.shape else [variable.name]
        return any(Endpoint(component, name) in self.ends for name in names)

    def _values(self, component: str, interface: Interface) -> dict[str, Value]:
        """Those of a component; what drives an input there, too, where the tool does not take it from outside."""
        given = {**self.outline.values}
        if not self.tool.joins_system:
            given |= {name: value for name, value in self.outline.driven.items() if value is not None}
        own = component_values(component, given)
        taken = {key: value for key, value in own.items() if self.tool.knows_items or not interface.ports[key].items}
        starts = FmuDescription(self.outline.files[component]).interface.ports
        for name in own if not self.tool.sets_values else own.keys() - taken.keys():
            port = starts[name]
            if port.start is None or port.parsed(port.start) != port.typed(name, own[name]):
                self.notes.append(f"{component}.{name}: {self.tool} does not take its value from an SSP")
        return taken

    def _add_connector(
        self, parent: ET.Element, variable: ConnectorVariable, kind: str, clock: Clock | None = None
    ) -> None:
        connector, port = ET.SubElement(parent, f"{SSD}Connector", {"name": variable.name, "kind": kind}), variable.port
        if clock is not None:
            if self.outline.version is Version.TWO:
                ET.SubElement(connector, f"{SSC}Clock", clock_attributes(clock))
            return
        written = type_name(port, self.outline.version)
        typed = ET.SubElement(connector, f"{SSC}{written}")
        if written == "Enumeration":
            typed.set("name", self._enumeration(port))
        if port.real and port.unit:
            typed.set("unit", port.unit)
            self.units.setdefault(port.unit, port.measure)
        for size in variable.shape:
            ET.SubElement(connector, f"{SSC}Dimension", {"size": str(size)})

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
        self, parent: ET.Element, component: str, values: Mapping[str, Value], ports: Mapping[str, Port]
    ) -> None:
        """A parameter set with the values of a component, or of the system where it is named ""."""
        if not values:
            return
        bindings = ET.SubElement(parent, f"{SSD}ParameterBindings")
        inline = ET.SubElement(ET.SubElement(bindings, f"{SSD}ParameterBinding"), f"{SSD}ParameterValues")
        written, torn = set_values(values, ports, self.outline.version)
        for array in torn:
            self.notes.append(
                f"{component}.{array}: some elements have a value, nothing tells the others; these stand one by one"
            )
        real = {key: port for key, port in _by_name(ports).items() if key in written and port.real and port.unit}
        units = {key: str(port.unit) for key, port in real.items()}
        inline.append(parameter_set_element(VALUES, written, units, self.outline.version))

    def _joined(self) -> list[Connection]:
        """The connections; in 2.0 one for all elements of an array that go to those of another in their order."""
        if self.outline.version is Version.ONE:
            return self.links
        found: dict[Connection, None] = {}
        for link in self.links:
            whole = self._whole(link)
            one = whole if whole is not None and self._complete(whole) else link
            found[one] = None
        return list(found)

    def _whole(self, link: Connection) -> Connection | None:
        """That of the arrays whose same elements a connection joins; None where it does not."""
        ends = [(end, self.outline.system.port(end)) for end in (link.source, link.target)]
        arrays = [port.array for _, port in ends]
        if arrays[0] is None or arrays[1] is None or arrays[0].shape != arrays[1].shape:
            return None
        if ends[0][1].element != ends[1][1].element:
            return None
        source, target = (
            replace(end, variable=array.name) for (end, _), array in zip(ends, arrays, strict=True) if array
        )
        return replace(link, source=source, target=target)

    def _complete(self, whole: Connection) -> bool:
        """Whether all elements are joined, and alike."""
        end = whole.source
        shape = self.outline.system.shape(end) or ()
        return sum(self._whole(link) == whole for link in self.links) == math.prod(shape)

    def _connection(self, link: Connection) -> ET.Element:
        element = self._link(link.source, link.target)
        units = {self._measured(end).unit or "" for end in (link.source, link.target)}
        if len(units) > 1 or (link.factor, link.offset) != (1.0, 0.0):
            element.set("suppressUnitConversion", "true")
        if (link.factor, link.offset) != (1.0, 0.0):
            change = {"factor": repr(link.factor), "offset": repr(link.offset)}
            ET.SubElement(element, f"{SSC}LinearTransformation", change)
            if not self.tool.transforms:
                self.notes.append(f"{link.source} -> {link.target}: {self.tool} does not multiply by {link.factor:g}")
        return element

    def _link(self, source: Endpoint, target: Endpoint) -> ET.Element:
        """A connection; the component "" is the system itself."""
        element = ET.Element(f"{SSD}Connection")
        indices: dict[str, str] = {}
        for side, end in (("start", source), ("end", target)):
            connector, places = end.variable, ""
            if end.component:
                element.set(f"{side}Element", end.component)
                connector, places = indexed(end.variable, self._measured(end), self.outline.version)
            element.set(f"{side}Connector", connector)
            indices |= {f"{side}Indices": places} if places else {}
        element.attrib.update(indices)
        return element

    def _measured(self, end: Endpoint) -> Port:
        """The variable at an end of a connection, of an array as a whole its first element."""
        shape = self.outline.system.shape(end)
        name = end.variable if shape is None else element_names(end.variable, shape)[0]
        port = self.outline.system.port(replace(end, variable=name))
        return port if shape is None else replace(port, array=None)

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


def _outer_names(names: Iterable[str]) -> dict[str, str]:
    """component.variable -> name of its connector of the system; with a number where two would have one."""
    found: dict[str, str] = {}
    for name in dict.fromkeys(names):
        plain = name.replace(".", "_", 1)
        numbered = (f"{plain}_{number}" for number in itertools.count(2))
        found[name] = next(one for one in itertools.chain([plain], numbered) if one not in found.values())
    return found


def _by_name(ports: Mapping[str, Port]) -> dict[str, Port]:
    """The variables by their names; arrays by theirs, too."""
    return {port.array.name: port for port in ports.values() if port.array is not None} | dict(ports)
