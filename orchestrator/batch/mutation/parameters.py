"""The parameters of a system that are changed, and to what."""

from __future__ import annotations

from dataclasses import dataclass

from orchestrator.fmi.interface import Port
from orchestrator.scenario.run import ScenarioResult
from orchestrator.scenario.scenario import Case
from orchestrator.system import System

SHARE = 0.01  # of its value by which a parameter is changed


@dataclass(frozen=True)
class MutatedValue:
    """A value before and after [unit of the parameter]."""

    old: float
    new: float

    def __str__(self) -> str:
        return f"{self.old:g} -> {self.new:g}"


def parameters(result: ScenarioResult) -> list[str]:
    """component.parameter of a system whose values are real numbers other than zero in some case."""
    system = result.system
    assert system is not None
    names = [
        f"{component}.{port.name}"
        for component, part in system.parts.items()
        for port in part.interface.ports.values()
        if port.real and port.causality == "parameter" and port.variability != "constant"
    ]
    return [name for name in names if any(value_of(name, case, system) for case in result.scenario.cases)]


def value_of(name: str, case: Case, system: System | None) -> float | None:
    """What a parameter is in a case [its unit]; None where it is zero, or not known."""
    port = _port(system, name)
    given = case.values.get(name, port.start)
    if given is None:
        return None
    try:
        value = float(given)
    except ValueError:
        value = port.quantity(name, str(given))
    return value or None


def changed(name: str, value: float, system: System | None) -> float:
    """The value of a parameter changed by the share, downwards where it would leave its range otherwise."""
    port = _port(system, name)
    more, less = value * (1 + SHARE), value * (1 - SHARE)
    inside = (port.minimum is None or more >= port.minimum) and (port.maximum is None or more <= port.maximum)
    return more if inside else less


def _port(system: System | None, name: str) -> Port:
    assert system is not None
    component, _, variable = name.partition(".")
    return system.parts[component].interface.ports[variable]
