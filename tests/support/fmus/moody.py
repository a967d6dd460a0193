"""An FMU that misbehaves on request, compiled from `moody.c`: which statuses its functions return, what it ignores."""

from __future__ import annotations

import ctypes
from pathlib import Path

import fmpy

from fmus.packaging import archive
from orchestrator.fmi.slave import Slave
from tests.support.from_c import SUFFIX, compiled

STATUSES = ("step", "setup", "enter", "exit", "get", "set", "reset", "save")

_XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="moody" guid="moody">
  <CoSimulation modelIdentifier="moody" canGetAndSetFMUstate="true" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <ScalarVariable name="input" valueReference="0" causality="input"><Real start="1"/></ScalarVariable>
    <ScalarVariable name="output" valueReference="1" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="stubborn" valueReference="2" causality="parameter" variability="fixed">
      <Real start="1"/>
    </ScalarVariable>
    {statuses}
  </ModelVariables>
  <ModelStructure><Outputs><Unknown index="2" dependencies="1"/></Outputs></ModelStructure>
</fmiModelDescription>
"""
_STATUS = """<ScalarVariable name="{name}" valueReference="{number}" causality="parameter" variability="tunable">
      <Integer start="0"/>
    </ScalarVariable>"""


def build(folder: Path) -> Path:
    """The FMU, in this folder; the test is skipped where there is no C compiler."""
    statuses = "\n    ".join(_STATUS.format(name=name, number=i) for i, name in enumerate(STATUSES))
    archive.write(
        folder / "moody.fmu",
        {
            "modelDescription.xml": _XML.format(statuses=statuses).encode(),
            f"binaries/{fmpy.platform}/moody{SUFFIX}": compiled(Path(__file__).with_suffix(".c")),
        },
    )
    return folder / "moody.fmu"


def counter(slave: Slave, name: str) -> int:
    """Value of a counter inside the binary: "calls_after_fatal" or "instances"."""
    return ctypes.c_int.in_dll(slave._fmi.fmu.dll, name).value
