"""FMUs with quirks: a first-order lag of `quirks.c`, whose functions do more, or less, than they should.

Its library has only the functions that a plain run calls. `u` is its input, `x` its state (1 at the start), `k` a
parameter (0.5), `on` a Boolean input that does nothing; `said` is a text, the expression that `ON_TEXT` stands for.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import fmpy

from fmus.packaging import archive
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.slave import Slave
from tests.support.from_c import SUFFIX, compiled

_XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="quirks" guid="quirks">
  <CoSimulation modelIdentifier="quirks" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="0" causality="input"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="x" valueReference="1" causality="{causality}" initial="exact">
      <Real start="1"/>
    </ScalarVariable>
    <ScalarVariable name="k" valueReference="2" causality="parameter" variability="fixed">
      <Real start="0.5"/>
    </ScalarVariable>
    <ScalarVariable name="on" valueReference="0" causality="input" variability="discrete">
      <Boolean start="false"/>
    </ScalarVariable>
    <ScalarVariable name="said" valueReference="0" causality="{causality}" variability="discrete">
      <String/>
    </ScalarVariable>
  </ModelVariables>
  <ModelStructure>{outputs}</ModelStructure>
</fmiModelDescription>
"""
_OUTPUTS = '<Outputs><Unknown index="2" dependencies=""/><Unknown index="5" dependencies=""/></Outputs>'


def build(path: Path, *, output: bool = True, **quirks: str) -> Path:
    """The FMU at this path; the test is skipped where there is no C compiler.

    Args:
        output: whether its state is an output, or else a local variable.
        quirks: macros of `quirks.c`, such as ON_RESET, and the statements that they stand for.
    """
    code = compiled(Path(__file__).with_suffix(".c"), *(f"-D{name}={text}" for name, text in quirks.items()))
    xml = _XML.format(causality="output" if output else "local", outputs=_OUTPUTS if output else "")
    archive.write(path, {"modelDescription.xml": xml.encode(), f"binaries/{fmpy.platform}/quirks{SUFFIX}": code})
    return path


def count(slave: Slave, name: str) -> int:
    """Value of a counter in its library: "terminated", "instances" or "broken"."""
    return ctypes.c_int.in_dll(slave._fmi.fmu.dll, name).value


def opened(stack: Any, path: Path, name: str = "lag") -> Slave:
    """An instance, closed with the stack."""
    slave = Slave(stack.enter_context(FmuFile(path)), name)
    stack.callback(slave.close)
    return slave
