"""Parameter sets as SSV files (SSP 1.0; 2.0 where it is asked for), and the SSP archive that binds one to an FMU."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

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


@dataclass(frozen=True)
class ArrayValue:
    """Values of a type that SSP 2.0 knows, by its name.

    Attributes:
        kind: Float64, Int32, Binary, ..., or one of SSP 1.0.
        values: of an array all elements, row by row.
        shape: of an array; () of a scalar.
    """

    kind: str
    values: tuple[Number | str, ...]
    shape: tuple[int, ...] = ()


SetValue = Number | str  # what a parameter set holds; a plain str is the value of a String
_KINDS = {bool: "Boolean", int: "Integer", Item: "Enumeration", str: "String"}
_REAL = ("Real", "Float64", "Float32")


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


def parameter_set_element(
    name: str, values: Mapping[str, SetValue | ArrayValue], units: Mapping[str, str], version: str = "1.0"
) -> ET.Element:
    """The same as an element, to stand in another document; an `ArrayValue` needs version 2.0."""
    root = ET.Element(f"{{{SSV}}}ParameterSet", {"version": version, "name": name})
    parameters = ET.SubElement(root, f"{{{SSV}}}Parameters")
    for variable, value in values.items():
        parameter = ET.SubElement(parameters, f"{{{SSV}}}Parameter", {"name": variable})
        whole = value if isinstance(value, ArrayValue) else ArrayValue(_KINDS.get(type(value), "Real"), (value,))
        typed = ET.SubElement(parameter, f"{{{SSV}}}{whole.kind}")
        _set(typed, whole)
        if variable in units and whole.kind in _REAL:
            typed.set("unit", units[variable])
        for size in whole.shape:
            ET.SubElement(parameter, f"{{{SSC}}}Dimension", {"size": str(size)})
    _unit_definitions(root, {units[variable] for variable in values if variable in units})
    return root


def _set(typed: ET.Element, whole: ArrayValue) -> None:
    """Numbers of an array stand side by side, texts each in an element of their own."""
    if whole.shape and whole.kind in ("String", "Enumeration", "Binary"):
        for value in whole.values:
            ET.SubElement(typed, f"{{{SSV}}}Value", {"value": _text(value)})
    else:
        typed.set("value", " ".join(map(_text, whole.values)))


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
