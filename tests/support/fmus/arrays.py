"""An FMU of array variables of every type, compiled from `arrays.c`; it has no functions but those that it needs."""

from __future__ import annotations

from pathlib import Path

import fmpy

from fmus.packaging import archive
from tests.support.from_c import SUFFIX, compiled

WHOLE = ("Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64")
TYPES = ("Float32", *WHOLE, "Boolean", "Enumeration", "String")  # in the order of `arrays.c`
ITEMS = {"none": 0, "low": 1, "high": 3}
STARTS = {"Boolean": "false true", "Enumeration": "1 3"}
_XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="arrays" instantiationToken="arrays">
  <CoSimulation modelIdentifier="arrays" canHandleVariableCommunicationStepSize="true"/>
  <TypeDefinitions><EnumerationType name="Level">{items}</EnumerationType></TypeDefinitions>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <UInt64 name="m" valueReference="1" causality="structuralParameter" variability="fixed" start="2" min="1" max="4"/>
    <Float64 name="gain" valueReference="2" causality="parameter" variability="tunable" start="1 0 0 1">
      <Dimension valueReference="1"/><Dimension valueReference="1"/></Float64>
    <Float64 name="u" valueReference="3" causality="input" start="1 2"><Dimension valueReference="1"/></Float64>
    <Float64 name="y" valueReference="4" causality="output"><Dimension valueReference="1"/></Float64>
    {variables}
  </ModelVariables>
  <ModelStructure>{outputs}</ModelStructure>
</fmiModelDescription>
"""


def build(folder: Path, *replacements: tuple[str, str]) -> Path:
    """The FMU, in this folder, with these changes to its description; skipped where there is no C compiler."""
    xml = _description()
    for old, new in replacements:
        assert old in xml
        xml = xml.replace(old, new)
    files = {
        "modelDescription.xml": xml.encode(),
        f"binaries/{fmpy.platform_tuple}/arrays{SUFFIX}": compiled(Path(__file__).with_suffix(".c")),
    }
    archive.write(folder / "arrays.fmu", files)
    return folder / "arrays.fmu"


def _description() -> str:
    references = {kind: 100 + 10 * number for number, kind in enumerate(TYPES)}
    return _XML.format(
        items="".join(f'<Item name="{name}" value="{value}"/>' for name, value in ITEMS.items()),
        variables="\n    ".join(text for kind in TYPES for text in _of_type(kind, references[kind])),
        outputs="".join(
            f'<Output valueReference="{reference}"/>' for reference in [4, *(r + 2 for r in references.values())]
        ),
    )


def _of_type(kind: str, reference: int) -> list[str]:
    """An input, a parameter and an output of two elements each; of text without an input."""

    def one(number: int, name: str, causality: str, start: str) -> str:
        declared = ' declaredType="Level"' if kind == "Enumeration" else ""
        head = f'{kind} name="{name}_{kind}" valueReference="{reference + number}" causality="{causality}"{declared}'
        texts = '<Start value="a b"/><Start value=""/>' if kind == "String" and start else ""
        given = f' start="{start}"' if start and not texts else ""
        return f'<{head}{given}><Dimension start="2"/>{texts}</{kind}>'

    inputs = [] if kind == "String" else [one(0, "in", "input", STARTS.get(kind, "0 0"))]
    parameter = one(1, "p", "parameter", "false false" if kind == "Boolean" else "0 0")
    return [*inputs, parameter, one(2, "out", "output", "")]
