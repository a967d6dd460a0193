"""The states of a system that segments are joined by: what sets them, and what shows them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from orchestrator.fmi.interface import Port, Value
from orchestrator.system import System

_START = re.compile(r"(.+)_start")  # how the parameter of a state's start value is named


@dataclass(frozen=True)
class SettableState:
    """A state of a component.

    Attributes:
        start: component.variable that sets its start value.
        shown: component.variable that shows it.
        value: where it starts [unit].
    """

    start: str
    shown: str
    value: float


def states(system: System, given: Mapping[str, Value]) -> list[SettableState]:
    """Those that can be set and seen: `X` by `X_start`, or by a start value of its own.

    Args:
        given: component.variable -> value over the FMU's own.
    """
    found = [
        (f"{component}.{port.name}", f"{component}.{shown}", port.start)
        for component, part in system.parts.items()
        for port, shown in _pairs(part.interface.ports)
    ]
    return [SettableState(start, shown, float(given.get(start, value or 0.0))) for start, shown, value in found]


def _pairs(ports: Mapping[str, Port]) -> Iterator[tuple[Port, str]]:
    for port in ports.values():
        named = _START.fullmatch(port.name)
        if not port.real or port.start is None:
            continue
        if _is_state(port) and port.exact and port.variability == "continuous":
            yield port, port.name
        elif port.causality == "parameter" and named and named[1] in ports and _is_state(ports[named[1]]):
            yield port, named[1]


def _is_state(port: Port) -> bool:
    return port.real and port.causality in ("output", "local")
