"""A counter with values of all plain types, compiled from `counter.c`: an FMU of either version, without states."""

from __future__ import annotations

from pathlib import Path

import fmpy

from fmus.packaging import archive
from tests.support.from_c import SUFFIX, compiled

_XML2 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="counter" guid="counter">
  <CoSimulation modelIdentifier="counter" canHandleVariableCommunicationStepSize="true"/>
  <TypeDefinitions><SimpleType name="Level"><Enumeration><Item name="low" value="2"/><Item name="high" value="5"/>
  </Enumeration></SimpleType></TypeDefinitions>
  <ModelVariables>
    <ScalarVariable name="gain" valueReference="0" causality="parameter" variability="tunable">
      <Real start="1"/></ScalarVariable>
    <ScalarVariable name="total &lt;*/&quot;" valueReference="1" causality="output"><Real unit="m"/></ScalarVariable>
    <ScalarVariable name="by" valueReference="0" causality="input" variability="discrete">
      <Integer start="1"/></ScalarVariable>
    <ScalarVariable name="count" valueReference="1" causality="output" variability="discrete" initial="exact">
      <Integer start="0"/></ScalarVariable>
    <ScalarVariable name="on" valueReference="0" causality="input" variability="discrete">
      <Boolean start="false"/></ScalarVariable>
    <ScalarVariable name="odd" valueReference="1" causality="output" variability="discrete"><Boolean/></ScalarVariable>
    <ScalarVariable name="level" valueReference="2" causality="parameter" variability="fixed">
      <Enumeration declaredType="Level" start="2"/></ScalarVariable>
    <ScalarVariable name="text" valueReference="9" causality="parameter" variability="fixed">
      <String start="a"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure><Outputs>{outputs}</Outputs></ModelStructure>
</fmiModelDescription>
"""
_XML3 = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="counter" instantiationToken="counter">
  <CoSimulation modelIdentifier="counter" canHandleVariableCommunicationStepSize="true"/>
  <TypeDefinitions><EnumerationType name="Level"><Item name="low" value="2"/><Item name="high" value="5"/>
  </EnumerationType></TypeDefinitions>
  <ModelVariables>
    <Float64 name="time" valueReference="99" causality="independent" variability="continuous"/>
    <Float64 name="gain" valueReference="10" causality="parameter" variability="tunable" start="1"/>
    <Float64 name="total &lt;*/&quot;" valueReference="11" causality="output"/>
    <Int32 name="by" valueReference="20" causality="input" start="1"/>
    <Int32 name="count" valueReference="21" causality="output" initial="exact" start="0"/>
    <Boolean name="on" valueReference="30" causality="input" start="false"/>
    <Boolean name="odd" valueReference="31" causality="output"/>
    <Enumeration name="level" declaredType="Level" valueReference="42" causality="parameter" variability="fixed"
      start="2"/>
    <String name="text" valueReference="59" causality="parameter" variability="fixed"><Start value="a"/></String>
  </ModelVariables>
  <ModelStructure>{outputs}</ModelStructure>
</fmiModelDescription>
"""


def build(path: Path, fmi: int, *, once: bool = False) -> Path:
    """The FMU, `once` with only one instance in a process; skipped where there is no C compiler."""
    code = compiled(Path(__file__).with_suffix(".c"), f"-DFMI={fmi}")
    folder = fmpy.platform if fmi == 2 else fmpy.platform_tuple
    if fmi == 2:
        text = _XML2.format(outputs="".join(f'<Unknown index="{i}" dependencies=""/>' for i in (2, 4, 6)))
    else:
        text = _XML3.format(outputs="".join(f'<Output valueReference="{i}" dependencies=""/>' for i in (11, 21, 31)))
    if once:
        text = text.replace("<CoSimulation ", '<CoSimulation canBeInstantiatedOnlyOncePerProcess="true" ')
    files = {
        "modelDescription.xml": text.encode(),
        f"binaries/{folder}/counter{SUFFIX}": code,
        "documentation/licenses/license.txt": b"Only for tests",
    }
    archive.write(path, files)
    return path
