"""Parameter sets as SSV files (SSP 1.0), and the SSP archive that binds one to an FMU."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree as ET

from fmus.errors import FmuFileError
from fmus.files import absence
from fmus.modelling.model import Number
from fmus.packaging import archive
from fmus.packaging.description.xml import base_unit, document, xml_number

SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"
MIME = "application/x-ssp-parameter-set"

for _prefix, _uri in (("ssv", SSV), ("ssd", SSD), ("ssc", SSC)):
    ET.register_namespace(_prefix, _uri)


class Item(str):
    """A value of an enumeration: the name of the item."""

    __slots__ = ()


SetValue = Number | str  # what a parameter set holds; a plain str is the value of a String
_KINDS = {bool: "Boolean", int: "Integer", Item: "Enumeration", str: "String"}


def parameter_set(name: str, values: Mapping[str, SetValue], units: Mapping[str, str] | None = None) -> bytes:
    """The SSV document with these values; `units` names the unit of those that have one."""
    return document(parameter_set_element(name, values, units or {}))


def write_ssp(path: Path, fmu: Path, connectors: Mapping[str, str], values: Mapping[str, SetValue]) -> None:
    """An SSP with one component, the FMU, and the values bound to it as an inline parameter set.

    Args:
        connectors: name -> "input" or "output" of the FMU's real variables.
    """
    root = ET.Element(f"{{{SSD}}}SystemStructureDescription", {"name": fmu.stem, "version": "1.0"})
    system = ET.SubElement(root, f"{{{SSD}}}System", {"name": fmu.stem})
    elements = ET.SubElement(system, f"{{{SSD}}}Elements")
    component = ET.SubElement(
        elements,
        f"{{{SSD}}}Component",
        {"name": fmu.stem, "type": "application/x-fmu-sharedlibrary", "source": f"resources/{fmu.name}"},
    )
    ports = ET.SubElement(component, f"{{{SSD}}}Connectors")
    for name, kind in connectors.items():
        connector = ET.SubElement(ports, f"{{{SSD}}}Connector", {"name": name, "kind": kind})
        ET.SubElement(connector, f"{{{SSC}}}Real")
    binding = ET.SubElement(ET.SubElement(component, f"{{{SSD}}}ParameterBindings"), f"{{{SSD}}}ParameterBinding")
    inline = ET.SubElement(binding, f"{{{SSD}}}ParameterValues")
    inline.append(parameter_set_element(f"{fmu.stem}_calibrated", values, {}))
    archive.write(path, {"SystemStructure.ssd": document(root), f"resources/{fmu.name}": fmu.read_bytes()})


def read_values(path: Path) -> dict[str, SetValue]:
    """Name -> value of the parameters in an SSV file.

    Raises:
        FmuFileError: no such file, or not a parameter set.
    """
    if not path.is_file():
        raise FmuFileError(path, absence(path), "check the path")
    root = archive.parse_xml(path, path.read_bytes())
    if root.tag != f"{{{SSV}}}ParameterSet":
        raise FmuFileError(path, "is not an SSV parameter set", "check the path")
    values: dict[str, SetValue] = {}
    for parameter in root.iter(f"{{{SSV}}}Parameter"):
        name, typed = parameter.get("name"), next(iter(parameter), None)
        if name is None or typed is None:
            raise FmuFileError(path, "has a parameter without name or value", "write it again")
        values[name] = _value(path, name, str(typed.tag).rpartition("}")[2], typed.get("value", ""))
    return values


def _value(path: Path, name: str, kind: str, text: str) -> SetValue:
    if kind in ("Enumeration", "String"):
        return Item(text) if kind == "Enumeration" else text
    try:
        if kind == "Boolean":
            return {"true": True, "1": True, "false": False, "0": False}[text]
        return int(text) if kind == "Integer" else float(text)
    except (ValueError, KeyError):
        raise FmuFileError(f"{path}: {name}", f"'{text}' is no {kind}", "write the set again") from None


def parameter_set_element(name: str, values: Mapping[str, SetValue], units: Mapping[str, str]) -> ET.Element:
    """The same as an element, to stand in another document."""
    root = ET.Element(f"{{{SSV}}}ParameterSet", {"version": "1.0", "name": name})
    parameters = ET.SubElement(root, f"{{{SSV}}}Parameters")
    for variable, value in values.items():
        parameter = ET.SubElement(parameters, f"{{{SSV}}}Parameter", {"name": variable})
        kind = _KINDS.get(type(value), "Real")
        typed = ET.SubElement(parameter, f"{{{SSV}}}{kind}", {"value": _text(value)})
        if variable in units and kind == "Real":
            typed.set("unit", units[variable])
    _unit_definitions(root, {units[variable] for variable in values if variable in units})
    return root


def _text(value: SetValue) -> str:
    if isinstance(value, str):
        return str(value)
    return xml_number(value if isinstance(value, int) else float(value))


def _unit_definitions(root: ET.Element, names: set[str]) -> None:
    if not names:
        return
    parent = ET.SubElement(root, f"{{{SSV}}}Units")
    for name in sorted(names):
        entry = ET.SubElement(parent, f"{{{SSC}}}Unit", {"name": name})
        ET.SubElement(entry, f"{{{SSC}}}BaseUnit", base_unit(name) or {})
