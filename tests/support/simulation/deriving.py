"""An FMU with a calculated parameter and a local variable, compiled from `deriving.c`."""

from __future__ import annotations

from pathlib import Path

import fmpy

from fmus.packaging import archive
from tests.support.from_c import SUFFIX, compiled

_XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="deriving" guid="deriving">
  <CoSimulation modelIdentifier="deriving" canHandleVariableCommunicationStepSize="true" canGetAndSetFMUstate="true"/>
  <UnitDefinitions>
    <Unit name="m"><BaseUnit m="1"/></Unit><Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit>
  </UnitDefinitions>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="0" causality="input"><Real start="1"/></ScalarVariable>
    <ScalarVariable name="k" valueReference="1" causality="parameter" variability="fixed" initial="exact">
      <Real start="1" unit="mm" max="5000"/>
    </ScalarVariable>
    <ScalarVariable name="b" valueReference="2" causality="parameter" variability="fixed" initial="exact">
      <Real start="0"/>
    </ScalarVariable>
    <ScalarVariable name="double" valueReference="3" causality="calculatedParameter" variability="fixed"
      initial="calculated"><Real unit="{unit}"/></ScalarVariable>
    <ScalarVariable name="triple" valueReference="4" causality="local" variability="discrete"><Real/></ScalarVariable>
    <ScalarVariable name="y" valueReference="5" causality="output" variability="discrete"><Real/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="6" dependencies="1"/></Outputs>
    <InitialUnknowns><Unknown index="4" dependencies="2"/><Unknown index="6" dependencies="1 2 3"/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""


def build(folder: Path, unit: str = "mm") -> Path:
    """The FMU, in this folder, with its calculated parameter in a unit; skipped where there is no C compiler."""
    files = {"modelDescription.xml": _XML.format(unit=unit).encode()}
    files[f"binaries/{fmpy.platform}/deriving{SUFFIX}"] = compiled(Path(__file__).with_suffix(".c"))
    archive.write(folder / "deriving.fmu", files)
    return folder / "deriving.fmu"
