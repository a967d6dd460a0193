"""What a study gives like `90 deg`, as numbers in the units of its system's variables."""

from __future__ import annotations

from collections.abc import Iterable

from identification.built_system import BuiltSystem
from orchestrator.assembly.assembly import OpenSystem, SystemSpec
from orchestrator.fmi.interface import Port
from orchestrator.system import Endpoint

SECONDS = Port("delay", 0, "Real", "parameter", unit="s")


def numbers(
    system: SystemSpec, driven: Iterable[str], written: Iterable[tuple[str, str]]
) -> dict[tuple[str, str], float]:
    """(name, text) -> number in the unit of component.variable, or in seconds for the name of a delay.

    Args:
        driven: component.input that a study's traces drive.
        written: names with texts like `90 deg`.

    Raises:
        FmuFileError: a text is no number with a unit, or the unit is not known.
        WiringError: its unit is of another quantity, or there is no such variable.
    """
    delays, others = ([pair for pair in written if ("." in pair[0]) == dotted] for dotted in (False, True))
    found = {pair: SECONDS.quantity(*pair) for pair in delays}
    if others:
        built = BuiltSystem(system, sorted(driven))  # lasts as long as its name
        with OpenSystem(built.assembled) as opened:
            found |= {pair: opened.system.port(Endpoint.parse(pair[0])).quantity(*pair) for pair in others}
    return found
