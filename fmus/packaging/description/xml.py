"""modelDescription.xml of an FMU, FMI 2.0 and 3.0: units, limits, defaults, structure, capabilities."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from fmus import units
from fmus.modelling.instance import REFUSED
from fmus.modelling.model import Number, element, element_names
from fmus.packaging.description.interface import DescribedInterface, Exposed

GENERATION_TOOL = "servotwin"
REAL_DISPLAY_UNITS = {"rad": ("deg", 57.29577951308232), "rad/s": ("deg/s", 57.29577951308232)}
LOG_CATEGORIES = {"logStatusError": "What went wrong", REFUSED: "Parameters that do not fit together"}
STOP_TIME = 10.0
TIME_UNIT = "s"


@dataclass(frozen=True)
class Offer:
    """One interface type of an FMU: "ModelExchange" or "CoSimulation", and its capabilities.

    Attributes:
        sources: C files in the order in which FMI 2.0 lists them here.
    """

    kind: str
    identifier: str
    flags: Mapping[str, Number]
    sources: Sequence[str] = ()


@dataclass(frozen=True)
class Extras:
    """What the description says beside variables.

    Attributes:
        log_categories: with their meaning.
        start, stop, step: of the default experiment [s].
        variables: elements of others, which FMI 3.0 has after the time; `outputs` are the references of those.
    """

    log_categories: Mapping[str, str]
    step: float | None = None
    start: float = 0.0
    stop: float = STOP_TIME
    variables: Sequence[ET.Element] = ()
    outputs: Sequence[int] = ()


PLAIN = Extras(LOG_CATEGORIES)


def fmi2(interface: DescribedInterface, guid: str, offers: Sequence[Offer], extras: Extras = PLAIN) -> bytes:
    """The XML document of an FMI 2.0 FMU."""
    root = _root(interface, "2.0", "guid", guid, offers)
    if any(offer.kind == "ModelExchange" for offer in offers):
        root.set("numberOfEventIndicators", "0")  # optional, but FMI4j wants it
    _unit_definitions(root, _units(interface))
    _type_definitions(root, interface, fmi=2)
    _common(root, extras)
    parent = ET.SubElement(root, "ModelVariables")
    for variable in interface.variables:
        scalar = ET.SubElement(parent, "ScalarVariable", _named(variable))
        ET.SubElement(scalar, variable.type, _type_attributes(interface, variable, _position(interface)))
    structure = ET.SubElement(root, "ModelStructure")
    sections = (
        ("Outputs", interface.outputs),
        ("Derivatives", interface.rates),
        ("InitialUnknowns", interface.initial_unknowns),
    )
    for name, unknowns in sections:
        if unknowns:
            section = ET.SubElement(structure, name)
            _unknowns(section, "Unknown", "index", unknowns, _position(interface))
    return document(root)


def fmi3(interface: DescribedInterface, token: str, offers: Sequence[Offer], extras: Extras = PLAIN) -> bytes:
    """The XML document of an FMI 3.0 FMU; the time takes the value reference after the last one of the model's array.

    Args:
        token: the instantiation token.
    """
    root = _root(interface, "3.0", "instantiationToken", token, offers)
    _unit_definitions(root, _units(interface) | {TIME_UNIT})
    _type_definitions(root, interface, fmi=3)
    _common(root, extras)
    parent = ET.SubElement(root, "ModelVariables")
    for variable, array in _grouped(interface):
        attributes = _named(variable) | _type_attributes(interface, variable, _reference(interface))
        if array is None:
            ET.SubElement(parent, FMI3_TYPES[variable.type], attributes)
        else:
            _array(parent, interface, array, attributes)
    ET.SubElement(
        parent,
        "Float64",
        {
            "name": time_name(interface),
            "valueReference": str(interface.time_reference),
            "causality": "independent",
            "variability": "continuous",
            "description": "Time",
            "unit": TIME_UNIT,
        },
    )
    parent.extend(extras.variables)
    structure = ET.SubElement(root, "ModelStructure")
    sections = (
        ("Output", interface.outputs),
        ("ContinuousStateDerivative", interface.rates),
        ("InitialUnknown", interface.initial_unknowns),
    )
    for name, unknowns in sections:
        _unknowns(structure, name, "valueReference", unknowns, _reference(interface))
        for reference in extras.outputs if name == "Output" else ():
            ET.SubElement(structure, name, valueReference=str(reference))
    return document(root)


FMI3_TYPES = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean", "Enumeration": "Enumeration"}


def clock(interface: DescribedInterface) -> ET.Element:
    """The clock at which samples are taken, after the time; its interval is asked for, as it is that of a parameter."""
    name = "sampling"
    while name in interface.by_name:
        name += "_"
    said = {"name": name, "valueReference": str(interface.time_reference + 1), "causality": "input"}
    said |= {"variability": "discrete", "intervalVariability": "fixed"}
    return ET.Element("Clock", said | {"description": "Ticks where samples are taken; nobody needs to tick it"})


def time_name(interface: DescribedInterface) -> str:
    """Name of the independent variable: "time", unless the model has that name already."""
    return "time" if "time" not in interface.by_name else "independent_time"


def xml_number(value: Number) -> str:
    """A number as FMI writes it; floats keep every bit."""
    return str(value).lower() if isinstance(value, bool) else repr(value)


def base_unit(name: str) -> dict[str, str] | None:
    """The attributes of a unit's BaseUnit element, None for a unit we do not know."""
    unit = units.parse(name)
    if unit is None:
        return None
    powers = {base: str(power) for base, power in zip(units.BASES, unit.exponents, strict=True) if power}
    scale = {"factor": (unit.factor, 1.0), "offset": (unit.offset, 0.0)}
    return powers | {name: repr(value) for name, (value, default) in scale.items() if value != default}


def _root(
    interface: DescribedInterface, version: str, id_name: str, identity: str, offers: Sequence[Offer]
) -> ET.Element:
    root = ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": version,
            "modelName": interface.name,
            id_name: identity,
            "description": interface.description,
            "generationTool": GENERATION_TOOL,
            "variableNamingConvention": "structured" if interface.structured else "flat",
        },
    )
    for offer in offers:
        flags = {name: xml_number(value) for name, value in offer.flags.items()}
        element = ET.SubElement(root, offer.kind, {"modelIdentifier": offer.identifier} | flags)
        if offer.sources:
            files = ET.SubElement(element, "SourceFiles")
            for source in offer.sources:
                ET.SubElement(files, "File", name=source)
    return root


def _common(root: ET.Element, extras: Extras) -> None:
    log = ET.SubElement(root, "LogCategories")
    for name, text in extras.log_categories.items():
        ET.SubElement(log, "Category", name=name, description=text)
    step = {} if extras.step is None else {"stepSize": repr(extras.step)}
    times = {"startTime": repr(extras.start), "stopTime": repr(extras.stop)}
    ET.SubElement(root, "DefaultExperiment", times | step)


def _units(interface: DescribedInterface) -> set[str]:
    return {variable.unit for variable in interface.variables if variable.type == "Real"} - {"1"}


def _unit_definitions(root: ET.Element, names: set[str]) -> None:
    if not names:
        return
    definitions = ET.SubElement(root, "UnitDefinitions")
    for name in sorted(names):
        entry = ET.SubElement(definitions, "Unit", name=name)
        attributes = base_unit(name)
        if attributes is None:
            continue
        ET.SubElement(entry, "BaseUnit", attributes)
        if name in REAL_DISPLAY_UNITS:
            display, scale = REAL_DISPLAY_UNITS[name]
            ET.SubElement(entry, "DisplayUnit", name=display, factor=repr(scale))


def _type_definitions(root: ET.Element, interface: DescribedInterface, fmi: int) -> None:
    """An enumeration for each variable with choices."""
    choosing = [variable for variable in interface.variables if variable.choices]
    if not choosing:
        return
    definitions = ET.SubElement(root, "TypeDefinitions")
    for variable in choosing:
        name = _type_name(interface, variable)
        if fmi == 2:
            enumeration = ET.SubElement(ET.SubElement(definitions, "SimpleType", name=name), "Enumeration")
        else:
            enumeration = ET.SubElement(definitions, "EnumerationType", name=name)
        for number, choice in enumerate(variable.choices, start=1):
            ET.SubElement(enumeration, "Item", name=choice, value=str(number))


def _type_name(interface: DescribedInterface, variable: Exposed) -> str:
    return f"{interface.name}.{variable.name}"


def _named(variable: Exposed) -> dict[str, str]:
    attributes = {
        "name": variable.name,
        "valueReference": str(variable.reference),
        "causality": variable.causality,
        "variability": variable.variability,
        "description": variable.description,
    }
    return attributes | ({} if variable.initial is None else {"initial": variable.initial})


def _type_attributes(interface: DescribedInterface, variable: Exposed, places: Mapping[str, str]) -> dict[str, str]:
    attributes = {"declaredType": _type_name(interface, variable)} if variable.choices else {}
    if variable.type == "Real":
        attributes |= {"unit": variable.unit} if variable.unit != "1" else {}
        if variable.unit in REAL_DISPLAY_UNITS:
            attributes["displayUnit"] = REAL_DISPLAY_UNITS[variable.unit][0]
    for name, limit in (("min", variable.minimum), ("max", variable.maximum), ("nominal", variable.nominal)):
        if limit is not None:
            attributes[name] = repr(float(limit)) if variable.type == "Real" else str(int(limit))
    if variable.start is not None:
        attributes["start"] = xml_number(variable.start)
    if variable.derivative_of is not None:
        attributes["derivative"] = places[variable.derivative_of]
    return attributes


def _position(interface: DescribedInterface) -> dict[str, str]:
    """Variables by their place in the description, from 1, as FMI 2.0 refers to them."""
    return {variable.name: str(place) for place, variable in enumerate(interface.variables, start=1)}


def _reference(interface: DescribedInterface) -> dict[str, str]:
    """Variables by value reference, as FMI 3.0 refers to them; elements by that of their array."""
    references = {variable.name: str(variable.reference) for variable in interface.variables}
    for name, shape in interface.arrays.items():
        first, *others = element_names(name, shape)
        references |= dict.fromkeys(others, references[first])
    return references


def _grouped(interface: DescribedInterface) -> Iterator[tuple[Exposed, str | None]]:
    """The scalar variables, and of each array its first element with the array's name."""
    for variable in interface.variables:
        found = element(variable.name)
        array = found[0] if found is not None and found[0] in interface.arrays else None
        if found is None or array is None or set(found[1]) == {1}:
            yield variable, array


def _array(parent: ET.Element, interface: DescribedInterface, name: str, of_first: Mapping[str, str]) -> None:
    """The variable of an array; `of_first` are the attributes that its first element would have."""
    shape = interface.arrays[name]
    starts = (interface.by_name[element_name].start or 0.0 for element_name in element_names(name, shape))
    attributes = {**of_first, "name": name, "start": " ".join(map(xml_number, starts))}
    entry = ET.SubElement(parent, "Float64", attributes)
    for size in shape:
        ET.SubElement(entry, "Dimension", start=str(size))


def _unknowns(
    parent: ET.Element, tag: str, key: str, unknowns: Mapping[str, tuple[str, ...]], places: Mapping[str, str]
) -> None:
    for name, dependencies in unknowns.items():
        numbers = sorted({places[dependency] for dependency in dependencies}, key=int)
        ET.SubElement(parent, tag, {key: places[name], "dependencies": " ".join(numbers)})


def document(root: ET.Element) -> bytes:
    """The file of an XML document, indented."""
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="UTF-8", xml_declaration=True))
