"""Numbers of a study and its system: what is given like `90 deg`, what a parameter has, and the unit that it needs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from fmus.errors import WiringError
from fmus.units import SAME
from identification.built_system import BuiltSystem
from orchestrator.assembly.assembly import OpenSystem, SystemSpec
from orchestrator.crossing import crossing, named
from orchestrator.fmi.interface import Port
from orchestrator.system import Endpoint, System

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


def number(system: System, values: Mapping[str, object], name: str) -> float:
    """The value of a parameter: the study's, or the FMU's own.

    Raises:
        WiringError: it has none.
    """
    given = values.get(name, system.port(Endpoint.parse(name)).start)
    if not isinstance(given, (int, float, str)):
        raise WiringError(name, "has no value", "give one in its component")
    return float(given)


def must_be_in(system: System, key: str, name: str, what: str, unit: str | None) -> None:
    """See that a variable is in the SI unit of what it is for; `key` of the study names it.

    Raises:
        WiringError: it is in another.
    """
    crossed = crossing(f"{key}.{name}", named(unit), system.port(Endpoint.parse(name)).measure)
    if crossed.conversion != SAME:
        raise WiringError(crossed.place, f"is in {crossed.target}, and {what} in {crossed.source}", "use SI units")
