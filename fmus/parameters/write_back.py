"""Calibrated values written into FMUs.

One of our FMUs gets new defaults, in modelDescription.xml and in the resources it reads them from; its GUID stays. A
foreign FMU cannot be changed (its binary has the old values): beside it come an SSV parameter set and an SSP that
binds the set to it. Either way the values travel with their provenance.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lxml import etree

from fmus.errors import FmuFileError
from fmus.files import atomic_write
from fmus.json_document import json_text
from fmus.modelling.model import Number, element, element_number
from fmus.packaging import archive, defaults
from fmus.packaging.description.xml import GENERATION_TOOL, xml_number
from fmus.parameters import related, ssv
from fmus.parameters.bounds import span
from fmus.parameters.ssv import SetValue

REFERENCES = related.FOLDER
PROVENANCE = "extra/org.servotwin/provenance.json"
REALS = ("Real", "Float64", "Float32")
SETTABLE = ("parameter", "structuralParameter", "input")
_CALIBRATED = related.Related("calibrated.ssv", ssv.MIME, "parameter", "Calibrated parameters")


def write_back(
    fmu: str | Path,
    values: Mapping[str, SetValue],
    path: str | Path,
    provenance: Mapping[str, Any] | None = None,
    step: float | None = None,
) -> list[Path]:
    """Write an FMU with these start values; the files written come back, the FMU or its SSP first.

    Args:
        fmu: the FMU that is read; it may be the one that is written, too.
        values: variable -> value, in the variable's unit; an item of an enumeration by its name or its number, an
            element of an array as `A[1,2]`.
        path: the FMU to write; for a foreign FMU its suffix gives way to .ssp, .ssv and .provenance.json.
        provenance: what the values come from, kept as JSON.
        step: that importers are to take by default [s], of one of our FMUs; None leaves what it says.

    Raises:
        FmuFileError: no such FMU, it has no such variable, it has no start value that could be set, or the value is not
            of its type or outside its bounds.
        InputError: the path cannot be written.
    """
    source, target, origin = Path(fmu), Path(path), provenance or {}
    files = archive.read(source)
    root = description_of(source, files)
    variables = _variables(source, root)
    starts = {name: _start(source, root, variables, name, value) for name, value in values.items()}
    parameters = ssv.parameter_set(
        "calibrated",
        {name: start.shown for name, start in starts.items()},
        {name: start.unit for name, start in starts.items() if start.unit},
    )
    if not is_ours(files, root):
        ports = _real_ports(variables)
        return _beside(source, ports, {name: s.shown for name, s in starts.items()}, parameters, target, origin)
    for name, start in starts.items():
        _put(*_find(source, variables, name), xml_number(start.value))
    experiment = root.find("DefaultExperiment")
    if step is not None and experiment is not None:
        experiment.set("stepSize", repr(float(step)))
    files["modelDescription.xml"] = etree.tostring(root, encoding="UTF-8", xml_declaration=True, pretty_print=True)
    old = _defaults(source, files[defaults.RESOURCE])
    files[defaults.RESOURCE] = defaults.dump(old | {name: start.value for name, start in starts.items()}).encode()
    related.related(str(source), files)  # of which the manifest has to be XML
    named = files.get(related.MANIFEST)
    files[related.MANIFEST] = related.manifest([_CALIBRATED], {_CALIBRATED.source: parameters}, named)
    files[f"{REFERENCES}/{_CALIBRATED.source}"] = parameters
    files[PROVENANCE] = json_text(origin).encode()
    archive.write(target, files)
    return [target]


def description_of(source: Path, files: Mapping[str, bytes]) -> etree._Element:
    """The root of modelDescription.xml among an FMU's files.

    Raises:
        FmuFileError: it is not there, or no XML.
    """
    if "modelDescription.xml" not in files:
        raise FmuFileError(source, "holds no modelDescription.xml", "is it an FMU?")
    return archive.parse_xml(f"{source}: modelDescription.xml", files["modelDescription.xml"])


def is_ours(files: Mapping[str, bytes], root: etree._Element) -> bool:
    """Whether an FMU reads its defaults from its resources, as those built here do."""
    return root.get("generationTool") == GENERATION_TOOL and defaults.RESOURCE in files


@dataclass(frozen=True)
class _Start:
    """A checked start value: as the FMU's XML has it, as a parameter set shows it, and its unit."""

    value: Any
    shown: SetValue
    unit: str | None


def _beside(
    source: Path,
    ports: Mapping[str, str],
    values: Mapping[str, SetValue],
    parameters: bytes,
    target: Path,
    provenance: Mapping[str, Any],
) -> list[Path]:
    written = [target.with_suffix(suffix) for suffix in (".ssp", ".ssv", ".provenance.json")]
    ssv.write_ssp(written[0], source, ports, values)
    atomic_write(written[1], parameters)
    atomic_write(written[2], json_text(provenance).encode())
    return written


def _variables(source: Path, root: etree._Element) -> dict[str, etree._Element]:
    """Name -> element of each variable."""
    parent = root.find("ModelVariables")
    if parent is None:
        raise FmuFileError(source, "declares no variables", "ask its supplier for a valid FMU")
    return {str(variable.get("name")): variable for variable in parent.iterchildren("*")}


def _typed(variable: etree._Element) -> etree._Element:
    """The element that carries type and start value: the variable's own (FMI 3) or its child's (FMI 2)."""
    if variable.tag != "ScalarVariable":
        return variable
    return next(variable.iterchildren("Real", "Integer", "Boolean", "String", "Enumeration"), variable)


def _real_ports(variables: Mapping[str, etree._Element]) -> dict[str, str]:
    """Name -> causality of the scalar real inputs and outputs."""
    return {
        name: variable.get("causality", "local")
        for name, variable in variables.items()
        if variable.get("causality") in ("input", "output")
        and _typed(variable).tag in REALS
        and variable.find("Dimension") is None
    }


def _start(
    source: Path, root: etree._Element, variables: Mapping[str, etree._Element], name: str, value: SetValue
) -> _Start:
    place = f"{source}: {name}"
    variable, _ = _find(source, variables, name)
    typed = _typed(variable)
    causality = variable.get("causality", "local")
    if causality not in SETTABLE and variable.get("initial") not in ("exact", "approx"):
        raise FmuFileError(place, f"is a variable of causality {causality}", "calibrate a parameter")
    declared = _declared_type(root, typed)
    unit = typed.get("unit") or (declared.get("unit") if declared is not None else None)
    if typed.tag == "String":
        return _Start(str(value), str(value), None)
    items = _items(declared) if typed.tag == "Enumeration" else {}
    number = _number(place, typed.tag, value, items)
    _within(place, number, *(_limit(typed, declared, side) for side in ("min", "max")))
    name_of = {item: text for text, item in items.items()}
    if items and number not in name_of:
        raise FmuFileError(place, f"has no item {value}", f"there are {', '.join(items)}")
    return _Start(number, ssv.Item(name_of[int(number)]) if items else number, unit)


def _find(source: Path, variables: Mapping[str, etree._Element], name: str) -> tuple[etree._Element, int | None]:
    """A variable and None; or for the name of an element, as `A[1,2]`, its array and its number there from 0."""
    variable = variables.get(name)
    if variable is not None and variable.find("Dimension") is None:
        return variable, None
    array, place = element(name) or ("", ())
    if array in variables:
        shape = [int(size.get("start", "0")) for size in variables[array].iterfind("Dimension")]
        number = element_number(place, shape)
        if number is not None:
            return variables[array], number
    if variable is not None:
        raise FmuFileError(f"{source}: {name}", "is an array", f"name its elements, as {name}[1]")
    near = difflib.get_close_matches(name, variables, n=1)
    raise FmuFileError(
        f"{source}: {name}", "no such variable", f"did you mean '{near[0]}'?" if near else "see `servotwin info`"
    )


def _put(variable: etree._Element, number: int | None, text: str) -> None:
    """Give a variable, or one element of an array, a start value."""
    typed = _typed(variable)
    if number is not None:
        starts = str(typed.get("start")).split()
        text = " ".join([*starts[:number], text, *starts[number + 1 :]])
    typed.set("start", text)


def _declared_type(root: etree._Element, typed: etree._Element) -> etree._Element | None:
    """The definition of a variable's declared type: what carries its limits, unit and items."""
    for definition in root.iterfind("TypeDefinitions/*"):
        if definition.get("name") == typed.get("declaredType"):
            return next(definition.iterchildren("*"), None) if definition.tag == "SimpleType" else definition
    return None


def _items(declared: etree._Element | None) -> dict[str, int]:
    if declared is None:
        return {}
    return {str(item.get("name")): int(item.get("value", "0")) for item in declared.iterfind("Item")}


def _limit(typed: etree._Element, declared: etree._Element | None, side: str) -> str | None:
    return typed.get(side) or (declared.get(side) if declared is not None else None)


def _number(place: str, kind: str, value: SetValue, items: Mapping[str, int]) -> Number:
    """The value in the type of its variable."""
    if isinstance(value, str):
        if value not in items:
            known = ", ".join(items) or "a number"
            raise FmuFileError(place, f"cannot be '{value}'", f"give {known}")
        return items[value]
    if not math.isfinite(value):
        raise FmuFileError(place, f"cannot be {value}", "give a finite number")
    if kind in REALS:
        return float(value)
    if int(value) != value or (kind == "Boolean" and value not in (0, 1)):
        raise FmuFileError(
            place,
            f"is of type {kind}, not {value}",
            "give true or false" if kind == "Boolean" else "give a whole number",
        )
    return bool(value) if kind == "Boolean" else int(value)


def _within(place: str, value: Number, low: str | None, high: str | None) -> None:
    if (low is not None and value < float(low)) or (high is not None and value > float(high)):
        problem = f"{value} lies outside its bounds {span(low, high)}"
        raise FmuFileError(place, problem, "bound the parameter in the study")


def _defaults(source: Path, text: bytes) -> dict[str, Number]:
    try:
        return defaults.load(text.decode())
    except ValueError as error:
        raise FmuFileError(f"{source}: {defaults.RESOURCE}", f"is damaged ({error})", "build the FMU again") from error
