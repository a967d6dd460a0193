"""An FMU of FMI 3.0 with every kind of clock, compiled from `clocks.c`, where its behaviour is told."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import fmpy

from fmus.packaging import archive
from tests.support.from_c import SUFFIX, compiled

OUTPUTS = ("out", "relay", "alarm")
TROUBLES = (
    "none",
    "update fails",
    "ends",
    "endless",
    "tick fails",
    "step fails",
    "warns",
    "stuck",
    "crowded",
    "stops",
    "enter fails",
    "leave fails",
    "behind",
    "beyond",
    "whole",
)
CLOCKS = {
    "tick": 'intervalVariability="constant" intervalDecimal="0.1"',
    "changing": 'intervalVariability="changing"',
    "countdown": 'intervalVariability="countdown"',
    "tune": 'intervalVariability="tunable"',
    "fixed": 'intervalVariability="fixed"',
    "trigger": 'intervalVariability="triggered"',
    "second": 'intervalVariability="triggered"',
    "out": 'intervalVariability="triggered"',
    "relay": 'intervalVariability="triggered"',
    "alarm": 'intervalVariability="triggered"',
}
REFERENCES = {
    "tick": 1,
    "tune": 2,
    "changing": 3,
    "countdown": 4,
    "trigger": 5,
    "out": 6,
    "relay": 7,
    "alarm": 8,
    "fixed": 9,
    "second": 10,
}
PARAMETERS = {
    "divisor": 3,
    "delay": 0.25,
    "growth": 0.1,
    "alarm_at": 1e300,
    "event_at": 1e300,
    "period": 0.2,
    "trouble": 0,
}
_XML = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="clocks" instantiationToken="clocks">
  {interfaces}
  <TypeDefinitions><ClockType name="Slow" intervalVariability="constant" resolution="10" intervalCounter="5"/>
  </TypeDefinitions>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    {variables}
  </ModelVariables>
  <ModelStructure>{outputs}</ModelStructure>
</fmiModelDescription>
"""
_ALL = 'canGetAndSetFMUState="true"'
CO_SIMULATION = (
    f'<CoSimulation modelIdentifier="clocks" hasEventMode="true" canHandleVariableCommunicationStepSize="true" {_ALL}/>'
)
MODEL_EXCHANGE = f'<ModelExchange modelIdentifier="clocks" {_ALL}/>'


def build(
    folder: Path,
    clocks: Mapping[str, str] | tuple[str, ...] = ("tick",),
    interfaces: str = CO_SIMULATION,
    name: str = "clocks",
) -> Path:
    """The FMU, in this folder, with these clocks and what the description says of them.

    Args:
        clocks: names, or name -> attributes.
    """
    folder.mkdir(exist_ok=True)
    code = compiled(Path(__file__).with_suffix(".c"), completed=True)
    said = dict(clocks) if isinstance(clocks, Mapping) else {one: CLOCKS[one] for one in clocks}
    files = {
        "modelDescription.xml": description(said, interfaces).encode(),
        f"binaries/{fmpy.platform_tuple}/clocks{SUFFIX}": code,
    }
    archive.write(folder / f"{name}.fmu", files)
    return folder / f"{name}.fmu"


def description(clocks: Mapping[str, str], interfaces: str = CO_SIMULATION) -> str:
    """modelDescription.xml with these clocks."""
    lines = [
        f'<Clock name="{name}" valueReference="{REFERENCES[name]}" '
        f'causality="{"output" if name in OUTPUTS else "input"}" variability="discrete" {said}/>'
        for name, said in clocks.items()
    ]
    heard = f' clocks="{REFERENCES["trigger"]}"' if "trigger" in clocks else ""
    kept = f' clocks="{REFERENCES["tick"]}"' if "tick" in clocks else ""
    lines += [
        '<Float64 name="u" valueReference="20" causality="input" variability="discrete" start="0"/>',
        f'<Float64 name="w" valueReference="21" causality="input" variability="discrete" start="0"{heard}/>',
        f'<Float64 name="v" valueReference="29" causality="input" variability="discrete" start="0"{kept}/>',
        *(
            f'<Float64 name="{name}" valueReference="{22 + place}" causality="parameter" variability="tunable" '
            f'start="{start:g}"/>'
            for place, (name, start) in enumerate(PARAMETERS.items())
        ),
    ]
    lines.append('<Float64 name="shift" valueReference="30" causality="parameter" variability="fixed" start="0"/>')
    outputs = {"sampled": 40, "heard": 41, "seen": 42, "last_time": 43, "gauge": 44, "kept": 45}
    lines += [
        f'<Float64 name="{name}" valueReference="{reference}" causality="output" variability="discrete"/>'
        for name, reference in outputs.items()
    ]
    counts = {"events": 60} | {f"n_{name}": 60 + reference for name, reference in REFERENCES.items()}
    lines += [
        f'<Int32 name="{name}" valueReference="{reference}" causality="output" variability="discrete"/>'
        for name, reference in counts.items()
    ]
    known = [f'<Output valueReference="{reference}"/>' for reference in [*outputs.values(), *counts.values()]]
    return _XML.format(interfaces=interfaces, variables="\n    ".join(lines), outputs="".join(known))
