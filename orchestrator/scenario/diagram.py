"""The wiring of a run's system as a diagram, with rates and units."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from fmus.modelling.model import Model
from orchestrator.assembly.stimulus import Stimulus
from orchestrator.display.titles import with_unit
from orchestrator.network import carriers
from orchestrator.rational import written
from orchestrator.report.wiring import DiagramBox, DiagramWire, WiringDiagram
from orchestrator.scenario.run import ScenarioResult
from orchestrator.system import COMPUTED, Connection, Endpoint, System
from orchestrator.trace import Trace


def wiring_of(result: ScenarioResult, system: System, received: Collection[str] = ()) -> WiringDiagram:
    """Components with their steps, what drives them, and what is connected.

    Args:
        received: inputs that a bus has driven.
    """
    driven = dict(sorted(result.scenario.stimuli.items()))
    sources = [
        DiagramBox(
            _source(name), "from the bus" if name in received else _about(given), "", {}, {"y": ""}, outside=True
        )
        for name, given in driven.items()
    ]
    wires = [DiagramWire((_source(name), "y"), _ends(Endpoint.parse(name))) for name in driven]
    numbers = (*system.connections, *system.settled)
    wires += [DiagramWire(_ends(link.source), _ends(link.target), _conversion(link)) for link in numbers]
    wires += [DiagramWire(_ends(link.source), _ends(link.target), "ticks") for link in system.clocks]
    wires += [DiagramWire(_ends(link.source), _ends(link.target), "") for link in system.texts]
    buses = result.assembled.system.buses
    wires += [
        DiagramWire(_ends(Endpoint.parse(node)), (name, node), "frames")
        for name, bus in buses.items()
        for node in bus.nodes
    ]
    return WiringDiagram([*sources, *(_box(result, system, name, wires) for name in system.parts)], wires)


def source_of(result: ScenarioResult, component: str) -> str:
    """What a component is made of: the name of a model or of a file; of a bus, what it is."""
    if component in result.assembled.system.buses:
        return carriers.interface(result.assembled.system.buses[component]).model_name
    source = result.scenario.system.components[component].source
    return source.name if isinstance(source, Model | Path) else str(source)


def _source(name: str) -> str:
    return f"→ {name}"


def _ends(endpoint: Endpoint) -> tuple[str, str]:
    return endpoint.component, endpoint.variable


def _about(stimulus: Stimulus) -> str:
    """What a stimulus is, in words."""
    if isinstance(stimulus.source, Trace):
        return stimulus.file.name if stimulus.file else stimulus.source.name
    return f"{stimulus.source:g}" if isinstance(stimulus.source, float | int) else stimulus.source


def _conversion(link: Connection) -> str:
    parts = [f"× {link.factor:.6g}"] if link.factor != 1.0 else []
    parts += [f"+ {link.offset:.6g}"] if link.offset else []
    return " ".join(parts)


def _box(result: ScenarioResult, system: System, name: str, wires: list[DiagramWire]) -> DiagramBox:
    """A component with those of its ports that are connected or driven, and its outputs."""
    part = system.parts[name]
    ports = part.interface.ports
    used = {wire.target[1] for wire in wires if wire.target[0] == name}
    given = {wire.source[1] for wire in wires if wire.source[0] == name}
    outputs = [port.name for port in part.interface.of("output")]
    outputs += [port.name for cause in COMPUTED for port in part.interface.of(cause) if port.name in given]
    step = result.scenario.timing.step if part.step is None else part.step
    component = result.assembled.system.components.get(name)
    how = f"{component.solver.method} " if component is not None and component.solver is not None else ""
    taken = [port.name for cause in ("input", "parameter") for port in part.interface.of(cause) if port.name in used]
    shown = [one for one in outputs if one in given or len(outputs) <= 6]
    return DiagramBox(
        name,
        source_of(result, name),
        "when frames come" if part.carries else f"{how}every {written(step)} s",
        {one: with_unit(one, ports[one].unit) for one in taken} | {node: node for node in used - ports.keys()},
        {one: with_unit(one, ports[one].unit) for one in shown} | {one: one for one in given - ports.keys()},
    )
