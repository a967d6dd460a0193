"""What a scenario would send and receive on a bus: its recorded outputs and its driven inputs, as declared signals."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

from fmus.errors import ScenarioError
from orchestrator.assembly.assembly import OpenSystem, assemble
from orchestrator.can.database.writing import Declared
from orchestrator.fmi.isolation import scratch
from orchestrator.scenario.schema import load_scenario
from orchestrator.scenario.units import by_elements
from orchestrator.system import Endpoint, System

RIG, PEER = "Rig", "Controller"  # who sends outputs, and who sends what the inputs take


def declared(path: Path, every: float | None = None) -> list[Declared]:
    """The signals of a scenario, with the unit and the bounds that the FMUs declare.

    Args:
        every: period of all of them, by default the communication step of the component [s].

    Raises:
        InputError: the scenario does not fit, or has no number to be sent.
    """
    scenario = load_scenario(path)
    with (
        scenario.naming(),
        scratch(None) as folder,
        OpenSystem(assemble(scenario.system, folder, scenario.driven)) as opened,
    ):
        recorded = by_elements(opened.system, scenario).recorded(_outputs(opened.system))
        names = [*recorded, *scenario.driven]
        found = list(_signals(opened.system, dict.fromkeys(names), scenario.timing.step, every))
    if not found:
        raise ScenarioError(path, "records no output and drives no input that is a number", "name some in `record`")
    return found


def _outputs(system: System) -> tuple[str, ...]:
    return tuple(
        f"{component}.{port.name}"
        for component, part in system.parts.items()
        for port in part.interface.ports.values()
        if port.causality == "output"
    )


def _signals(system: System, names: dict[str, None], step: Fraction, every: float | None) -> Iterator[Declared]:
    for name in names:
        endpoint = Endpoint.parse(name)
        port = system.port(endpoint)
        if port.type == "String":
            continue
        own = float(system.parts[endpoint.component].step or step)
        low, high = (0.0, 1.0) if port.type == "Boolean" else (port.minimum, port.maximum)
        sender = PEER if port.causality == "input" else RIG
        yield Declared(name, port.unit or "", low, high, None, every or own, sender)
