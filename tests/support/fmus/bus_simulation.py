"""A bus between two nodes as an FMU after FMI-LS-BUS, compiled from `bus_simulation.c`, where its behaviour is told."""

from __future__ import annotations

from pathlib import Path

import fmpy

from fmus.packaging import archive
from tests.support.fmus.bus_nodes import MEMBERS, MIME
from tests.support.from_c import SUFFIX, compiled

_XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="bus_simulation" instantiationToken="bus_simulation">
  <CoSimulation modelIdentifier="bus_simulation" hasEventMode="true" canHandleVariableCommunicationStepSize="true"
    providesEvaluateDiscreteStates="true"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    {nodes}
    <Float64 name="carried" valueReference="30" causality="output" variability="discrete"/>
  </ModelVariables>
  <ModelStructure><Output valueReference="2"/><Output valueReference="6"/><Output valueReference="30"/></ModelStructure>
</fmiModelDescription>
"""
_NODE = """<Binary name="Node{n}.Rx_Data" valueReference="{0}" causality="input" variability="discrete" clocks="{2}"
      maxSize="2048" mimeType="{mime}"><Start value=""/></Binary>
    <Binary name="Node{n}.Tx_Data" valueReference="{1}" causality="output" variability="discrete" clocks="{3}"
      maxSize="2048" mimeType="{mime}"/>
    <Clock name="Node{n}.Rx_Clock" valueReference="{2}" causality="input" intervalVariability="triggered"/>
    <Clock name="Node{n}.Tx_Clock" valueReference="{3}" causality="input" intervalVariability="countdown"/>"""
_TERMINAL = """<Terminal name="Node{n}" terminalKind="org.fmi-ls-bus.network-terminal"
    matchingRule="org.fmi-ls-bus.transceiver">{members}</Terminal>"""


def build(folder: Path) -> Path:
    """The FMU, in this folder; skipped where there is no C compiler."""
    nodes = [_NODE.format(*range(1 + 4 * n, 5 + 4 * n), n=n + 1, mime=MIME) for n in range(2)]
    files = {
        "modelDescription.xml": _XML.format(nodes="\n    ".join(nodes)).encode(),
        "terminalsAndIcons/terminalsAndIcons.xml": _terminals().encode(),
        f"binaries/{fmpy.platform_tuple}/bus_simulation{SUFFIX}": compiled(Path(__file__).with_suffix(".c")),
    }
    archive.write(folder / "bus_simulation.fmu", files)
    return folder / "bus_simulation.fmu"


def _terminals() -> str:
    texts = []
    for n in (1, 2):
        members = "".join(
            f'<TerminalMemberVariable variableKind="signal" variableName="Node{n}.{name}" memberName="{name}"/>'
            for name in MEMBERS
        )
        texts.append(_TERMINAL.format(n=n, members=members))
    return f'<fmiTerminalsAndIcons fmiVersion="3.0"><Terminals>{"".join(texts)}</Terminals></fmiTerminalsAndIcons>'
