"""modelDescription.xml (FMI 2.0) of a model: units, limits, defaults, structure, capabilities."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree as ET

from fmus import symbolic, units
from fmus.model import Model, Number, Variable, start_values

GENERATION_TOOL = "servotwin"
REAL_DISPLAY_UNITS = {"rad": ("deg", 57.29577951308232), "rad/s": ("deg/s", 57.29577951308232)}


def fmi2(model: Model, guid: str, defaults: Mapping[str, Number], identifier: str, **capabilities: bool) -> bytes:
    """The XML document of a co-simulation FMU; value references are the positions in `model.variables`."""
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=model.name,
        guid=guid,
        description=model.description,
        generationTool=GENERATION_TOOL,
        variableNamingConvention="flat",
    )
    flags = {name: str(value).lower() for name, value in capabilities.items()}
    ET.SubElement(root, "CoSimulation", {"modelIdentifier": identifier} | flags)
    _unit_definitions(root, model)
    _type_definitions(root, model)
    log = ET.SubElement(root, "LogCategories")
    ET.SubElement(log, "Category", name="logStatusError")
    ET.SubElement(root, "DefaultExperiment", startTime="0", stopTime="10")
    _variables(root, model, {**start_values(model), **defaults})
    _structure(root, model)
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True)


def _unit_definitions(root: ET.Element, model: Model) -> None:
    names = sorted({variable.unit for variable in model.variables if variable.type == "Real"} - {"1"})
    if not names:
        return
    definitions = ET.SubElement(root, "UnitDefinitions")
    for name in names:
        entry = ET.SubElement(definitions, "Unit", name=name)
        attributes = base_unit(name)
        if attributes is None:
            continue
        ET.SubElement(entry, "BaseUnit", attributes)
        if name in REAL_DISPLAY_UNITS:
            display, scale = REAL_DISPLAY_UNITS[name]
            ET.SubElement(entry, "DisplayUnit", name=display, factor=repr(scale))


def base_unit(name: str) -> dict[str, str] | None:
    """The attributes of a unit's BaseUnit element, None for a unit we do not know."""
    unit = units.parse(name)
    if unit is None:
        return None
    powers = {base: str(power) for base, power in zip(units.BASES, unit.exponents, strict=True) if power}
    return powers | ({} if unit.factor == 1.0 else {"factor": repr(unit.factor)})


def _type_definitions(root: ET.Element, model: Model) -> None:
    chosen = [variable for variable in model.variables if variable.choices]
    if not chosen:
        return
    definitions = ET.SubElement(root, "TypeDefinitions")
    for variable in chosen:
        simple = ET.SubElement(definitions, "SimpleType", name=f"{model.name}.{variable.name}")
        enumeration = ET.SubElement(simple, "Enumeration")
        for number, choice in enumerate(variable.choices, start=1):
            ET.SubElement(enumeration, "Item", name=choice, value=str(number))


def _variables(root: ET.Element, model: Model, starts: Mapping[str, Number]) -> None:
    parent = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(model.variables):
        attributes = {
            "name": variable.name,
            "valueReference": str(reference),
            "causality": variable.causality,
            "description": variable.description,
        }
        scalar = ET.SubElement(parent, "ScalarVariable", attributes | _kind(variable, bool(model.sampled)))
        kind = "Enumeration" if variable.choices else variable.type
        ET.SubElement(scalar, kind, _type_attributes(model, variable, starts))


def _kind(variable: Variable, sampled: bool) -> dict[str, str]:
    if variable.causality == "parameter":
        return {"variability": "fixed", "initial": "exact"}
    if variable.causality == "input":
        return {"variability": "continuous" if variable.type == "Real" else "discrete"}
    return {"variability": "discrete" if sampled else "continuous", "initial": "calculated"}


def _type_attributes(model: Model, variable: Variable, starts: Mapping[str, Number]) -> dict[str, str]:
    attributes = {"declaredType": f"{model.name}.{variable.name}"} if variable.choices else {}
    if variable.type == "Real":
        attributes |= {"unit": variable.unit} if variable.unit != "1" else {}
        if variable.unit in REAL_DISPLAY_UNITS:
            attributes["displayUnit"] = REAL_DISPLAY_UNITS[variable.unit][0]
    for name, limit in (("min", variable.minimum), ("max", variable.maximum), ("nominal", variable.nominal)):
        if limit is not None:
            attributes[name] = repr(float(limit)) if variable.type == "Real" else str(int(limit))
    if variable.name in starts:
        attributes["start"] = xml_number(starts[variable.name])
    return attributes


def xml_number(value: Number) -> str:
    """A number as FMI writes it; floats keep every bit."""
    return str(value).lower() if isinstance(value, bool) else repr(value)


def _structure(root: ET.Element, model: Model) -> None:
    structure = ET.SubElement(root, "ModelStructure")
    position = {variable.name: str(index) for index, variable in enumerate(model.variables, start=1)}
    direct = symbolic.feed_through(model)
    for section in ("Outputs", "InitialUnknowns"):
        parent = ET.SubElement(structure, section)
        for name, inputs in direct.items():
            unknown = ET.SubElement(parent, "Unknown", index=position[name])
            if section == "Outputs":
                unknown.set("dependencies", " ".join(position[each] for each in inputs))
