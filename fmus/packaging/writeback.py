"""Calibrated values written into FMUs.

One of our FMUs gets new defaults, in modelDescription.xml and in the resources it reads them from; its GUID stays. A
foreign FMU cannot be changed (its binary has the old values): beside it come an SSV parameter set and an SSP that
binds the set to it. Either way the values travel with their provenance.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lxml import etree

from fmus.errors import FmuFileError
from fmus.files import atomic_write
from fmus.model import Number
from fmus.packaging import archive, defaults, ssv
from fmus.packaging.description import GENERATION_TOOL, xml_number

REFERENCES = "extra/org.fmi-standard.fmi-ls-ref"
PROVENANCE = "extra/org.servotwin/provenance.json"
_MANIFEST = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiReferences xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest"
  fmi-ls:fmi-ls-name="org.fmi-standard.fmi-ls-ref" fmi-ls:fmi-ls-version="1.0.0-alpha.1"
  fmi-ls:fmi-ls-description="Layered Standard providing information on related files included in an FMU.">
  <Related type="{ssv.MIME}" source="calibrated.ssv" role="parameter" description="Calibrated parameters"/>
</fmiReferences>
"""


def write_back(source: Path, values: Mapping[str, Number], target: Path, provenance: Mapping[str, Any]) -> list[Path]:
    """Write the FMU `source` with these start values; the files written come back, the FMU or its SSP first.

    Args:
        values: variable -> value, in the variable's unit.
        target: the FMU to write; for a foreign FMU its suffix gives way to .ssp and .ssv.
        provenance: what the values come from, kept as JSON.

    Raises:
        FmuFileError: the FMU has no such parameter, or the value lies outside its bounds.
    """
    files = archive.read(source)
    if "modelDescription.xml" not in files:
        raise FmuFileError(source, "holds no modelDescription.xml", "is it an FMU?")
    root = archive.parse_xml(f"{source}: modelDescription.xml", files["modelDescription.xml"])
    typed = {name: _checked(source, root, name, value) for name, value in values.items()}
    if not is_ours(files, root):
        return _beside(source, root, typed, target, provenance)
    for name, value in typed.items():
        _typed_element(source, root, name).set("start", xml_number(value))
    files["modelDescription.xml"] = etree.tostring(root, encoding="UTF-8", xml_declaration=True, pretty_print=True)
    files[defaults.RESOURCE] = defaults.dump(defaults.load(files[defaults.RESOURCE].decode()) | typed).encode()
    files[f"{REFERENCES}/fmi-ls-manifest.xml"] = _MANIFEST.encode()
    files[f"{REFERENCES}/calibrated.ssv"] = _set(root, typed)
    files[PROVENANCE] = _json(provenance)
    archive.write(target, files)
    return [target]


def is_ours(files: Mapping[str, bytes], root: etree._Element) -> bool:
    """Whether an FMU reads its defaults from its resources, as those built here do."""
    return root.get("generationTool") == GENERATION_TOOL and defaults.RESOURCE in files


def _beside(
    source: Path, root: etree._Element, values: Mapping[str, Number], target: Path, provenance: Mapping[str, Any]
) -> list[Path]:
    connectors = {}
    for variable in root.find("ModelVariables"):
        typed = next(iter(variable), variable)
        causality = variable.get("causality")
        if causality in ("input", "output") and typed.tag in ("Real", "Float64") and not variable.findall("Dimension"):
            connectors[variable.get("name")] = causality
    written = [target.with_suffix(suffix) for suffix in (".ssp", ".ssv", ".provenance.json")]
    ssv.write_ssp(written[0], source, connectors, values)
    atomic_write(written[1], _set(root, values))
    atomic_write(written[2], _json(provenance))
    return written


def _typed_element(source: Path, root: etree._Element, name: str) -> etree._Element:
    """The element that carries a variable's start value: the variable's own (FMI 3) or its child's (FMI 2)."""
    for variable in root.find("ModelVariables"):
        if variable.get("name") == name:
            return variable if variable.tag != "ScalarVariable" else next(iter(variable))
    raise FmuFileError(f"{source}: {name}", "no such variable", "see `servotwin info`")


def _checked(source: Path, root: etree._Element, name: str, value: Number) -> Number:
    """The value in the type of the variable, once it is seen to be a parameter and within its bounds."""
    element = _typed_element(source, root, name)
    variable = element if element.get("causality") else element.getparent()
    if variable.get("causality") not in ("parameter", "structuralParameter", "input"):
        raise FmuFileError(f"{source}: {name}", f"is a {variable.get('causality')}", "calibrate a parameter")
    low, high = element.get("min"), element.get("max")
    if (low is not None and value < float(low)) or (high is not None and value > float(high)):
        raise FmuFileError(
            f"{source}: {name}",
            f"{value} lies outside its bounds [{low or ''}, {high or ''}]",
            "bound the parameter in the study",
        )
    if element.tag in ("Real", "Float64", "Float32"):
        return float(value)
    return bool(value) if element.tag == "Boolean" else int(value)


def _set(root: etree._Element, values: Mapping[str, Number]) -> bytes:
    units = {}
    for variable in root.find("ModelVariables"):
        typed = next(iter(variable), variable) if variable.tag == "ScalarVariable" else variable
        if typed.get("unit"):
            units[variable.get("name")] = typed.get("unit")
    return ssv.parameter_set("calibrated", values, {name: unit for name, unit in units.items() if name in values})


def _json(document: Mapping[str, Any]) -> bytes:
    return (json.dumps(document, indent=2, allow_nan=False) + "\n").encode()
