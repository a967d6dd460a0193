"""An FMU of FMI 3.0 that tells of its own steps (intermediate update), compiled from `between.c`."""

from __future__ import annotations

from pathlib import Path

import fmpy
import numpy as np

from fmus.packaging import archive
from orchestrator.trace import FloatArray
from tests.support.from_c import SUFFIX, compiled

COUNT = 4  # of its own steps in one of the importer's
TROUBLES = ("none", "backwards", "beyond", "no values", "silent", "twice")
_XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="between" instantiationToken="between">
  <CoSimulation modelIdentifier="between" canHandleVariableCommunicationStepSize="true" canGetAndSetFMUState="true"
    providesIntermediateUpdate="true" canReturnEarlyAfterIntermediateUpdate="true" hasEventMode="false"/>
  <UnitDefinitions><Unit name="m"><BaseUnit m="1"/></Unit></UnitDefinitions>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Float64 name="input" valueReference="1" causality="input" start="1" intermediateUpdate="true"/>
    <Float64 name="level" valueReference="2" causality="output" unit="m" initial="exact" start="0"
      intermediateUpdate="true"/>
    <Float64 name="rate" valueReference="3" causality="parameter" variability="fixed" start="1"/>
    <Int32 name="trouble" valueReference="4" causality="parameter" variability="fixed" start="0"/>
    <Int32 name="asked" valueReference="5" causality="output"/>
    <Clock name="tick" valueReference="6" causality="input" intervalVariability="constant" intervalDecimal="0.25"/>
    <Int32 name="ticks" valueReference="7" causality="output"/>
    <String name="word" valueReference="8" causality="parameter" variability="fixed" intermediateUpdate="true">
      <Start value="a"/></String>
  </ModelVariables>
  <ModelStructure><Output valueReference="2" dependencies=""/><Output valueReference="5" dependencies=""/>
    <Output valueReference="7" dependencies=""/></ModelStructure>
</fmiModelDescription>
"""


def build(folder: Path, *replacements: tuple[str, str]) -> Path:
    """The FMU, in this folder, with these changes to its description; skipped where there is no C compiler."""
    text = _XML
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    files = {"modelDescription.xml": text.encode()}
    files[f"binaries/{fmpy.platform_tuple}/between{SUFFIX}"] = compiled(Path(__file__).with_suffix(".c"))
    archive.write(folder / "between.fmu", files)
    return folder / "between.fmu"


def levels(step: float, count: int, rate: float = 1.0) -> FloatArray:
    """(n,) the level after each of its own steps, with an input of 1 throughout."""
    return 1 - (1 - step / COUNT * rate) ** np.arange(1, COUNT * count + 1)
