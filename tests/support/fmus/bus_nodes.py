"""Network FMUs after FMI-LS-BUS, compiled from `bus_node.c`, where their behaviour is told."""

from __future__ import annotations

from pathlib import Path

import fmpy

from fmus.packaging import archive
from tests.support.from_c import SUFFIX, compiled

PARAMETERS = ("period", "first", "id", "rate", "discard", "spoil", "triggered", "hangs")
OUTPUTS = ("received", "last_id", "last_time", "confirmed", "lost", "complaints")
MIME = "application/org.fmi-standard.fmi-ls-bus.can; version=&quot;1.0.0&quot;"
MEMBERS = ("Tx_Data", "Tx_Clock", "Rx_Data", "Rx_Clock")
_STARTS = {"period": 0.1, "first": 0.1, "id": 256}
_XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="bus_node" instantiationToken="bus_node">
  <CoSimulation modelIdentifier="bus_node" hasEventMode="true" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Binary name="Can.Rx_Data" valueReference="1" causality="input" variability="discrete" clocks="3" maxSize="64"
      mimeType="{mime}"><Start value=""/></Binary>
    <Binary name="Can.Tx_Data" valueReference="2" causality="output" variability="discrete" clocks="4" maxSize="4096"
      mimeType="{mime}"/>
    <Clock name="Can.Rx_Clock" valueReference="3" causality="input" intervalVariability="triggered"/>
    <Clock name="Can.Tx_Clock" valueReference="4" {clock}/>
    {variables}
    <Boolean name="BusNotifications" valueReference="20" causality="parameter" variability="fixed" start="false"/>
  </ModelVariables>
  <ModelStructure>{outputs}</ModelStructure>
</fmiModelDescription>
"""
_TERMINALS = """<?xml version="1.0" encoding="UTF-8"?>
<fmiTerminalsAndIcons fmiVersion="3.0"><Terminals>
  <Terminal name="Can" terminalKind="org.fmi-ls-bus.network-terminal" matchingRule="org.fmi-ls-bus.transceiver">
    {members}
    <Terminal name="Configuration" terminalKind="org.fmi-ls-bus.network-terminal.configuration" matchingRule="bus">
      <TerminalMemberVariable variableKind="signal" variableName="BusNotifications" memberName="BusNotifications"/>
    </Terminal>
  </Terminal>
</Terminals></fmiTerminalsAndIcons>
"""


def build(folder: Path, *replacements: tuple[str, str], triggered: bool = False) -> Path:
    """The FMU, in this folder, with these texts of its XML replaced by others."""
    folder.mkdir(exist_ok=True)
    members = "".join(
        f'<TerminalMemberVariable variableKind="signal" variableName="Can.{name}" memberName="{name}"/>'
        for name in MEMBERS
    )
    texts = {
        "modelDescription.xml": _description(triggered),
        "terminalsAndIcons/terminalsAndIcons.xml": _TERMINALS.format(members=members),
    }
    for old, new in replacements:
        assert any(old in text for text in texts.values()), old
        texts = {name: text.replace(old, new) for name, text in texts.items()}
    files = {name: text.encode() for name, text in texts.items()}
    code = compiled(Path(__file__).with_name("bus_node.c"), completed=True)
    files[f"binaries/{fmpy.platform_tuple}/bus_node{SUFFIX}"] = code
    path = folder / f"node{len(list(folder.glob('*.fmu')))}.fmu"
    archive.write(path, files)
    return path


def _description(triggered: bool) -> str:
    starts = _STARTS | {"triggered": int(triggered)}
    variables = [
        f'<Float64 name="{name}" valueReference="{10 + n}" causality="parameter" variability="fixed" '
        f'start="{starts.get(name, 0)}"/>'
        for n, name in enumerate(PARAMETERS)
    ]
    variables += [
        f'<Float64 name="{name}" valueReference="{30 + n}" causality="output" variability="discrete"/>'
        for n, name in enumerate(OUTPUTS)
    ]
    kind = ("output", "triggered") if triggered else ("input", "countdown")
    return _XML.format(
        mime=MIME,
        clock=f'causality="{kind[0]}" intervalVariability="{kind[1]}"',
        variables="\n    ".join(variables),
        outputs='<Output valueReference="2"/>'
        + "".join(f'<Output valueReference="{30 + n}" dependencies=""/>' for n in range(len(OUTPUTS))),
    )
