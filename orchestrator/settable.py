"""Values that are set into a system before it runs: which can be, of what type and within what bounds."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass

from fmus.errors import WiringError
from fmus.parameters.bounds import span
from fmus.words import with_article
from orchestrator.fmi.interface import Port, Value
from orchestrator.system import REAL, Endpoint, System


@dataclass(frozen=True)
class Settable:
    """A parameter or start value that can be set.

    Attributes:
        lowest, highest: a number between them needs no other check; of what is not real none does.
    """

    component: str
    variable: str
    port: Port
    lowest: float
    highest: float

    def check(self, value: Value) -> None:
        """See that a value is of the variable's type and lies within the bounds.

        Raises:
            WiringError: it is of another type, no item of the enumeration, out of bounds, or would change the shapes
                of arrays.
        """
        name = f"{self.component}.{self.variable}"
        typed = check_value(name, self.port, value)
        if self.port.causality == "structuralParameter" and typed != self.port.parsed(self.port.start or "0"):
            problem = f"is {self.port.start} and cannot be {value} in one run only"
            raise WiringError(name, problem, "sizes hold for all runs: give it among the `parameters`, or with --set")


def settable(system: System, name: str) -> Settable:
    """What is set by this name.

    Raises:
        WiringError: there is no such variable, it cannot be set, or something else drives it.
    """
    endpoint = Endpoint.parse(name)
    port = system.port(endpoint)
    if not port.settable:
        kind = "constant" if port.variability == "constant" else port.causality
        raise WiringError(name, f"is {with_article(kind)} and cannot be set", "set a parameter or a start value")
    sources = {link.target: str(link.source) for link in system.links}
    sources |= dict.fromkeys(system.stimulated, "a stimulus")
    if endpoint in sources:
        raise WiringError(name, f"takes its value from {sources[endpoint]}", "do not set it")
    plain = port.type in REAL
    lowest = (-sys.float_info.max if port.minimum is None else port.minimum) if plain else math.inf
    highest = (sys.float_info.max if port.maximum is None else port.maximum) if plain else -math.inf
    return Settable(endpoint.component, endpoint.variable, port, lowest, highest)


def typed(system: System, values: Mapping[str, Value]) -> dict[str, Value]:
    """component.variable -> value in the type and unit of its variable.

    Raises:
        WiringError: there is no such variable, a value is of another type, or a unit of another quantity.
    """
    return {name: settable(system, name).port.typed(name, value) for name, value in values.items()}


def check_values(system: System, values: Mapping[str, Value]) -> None:
    """See that parameters and start values exist, can be set, are not overruled, and lie within their bounds.

    Raises:
        WiringError: one does not; the message names it.
    """
    for name, value in values.items():
        settable(system, name).check(value)


def check_value(name: str, port: Port, value: Value) -> Value:
    """The value in the variable's type, seen to lie within its bounds.

    Raises:
        WiringError: it does not, or is of another type; the message names `name`.
    """
    if not isinstance(value, str) and not math.isfinite(value):
        check_bounds(name, port, value)
    typed = port.typed(name, value)
    if not isinstance(typed, str):
        check_bounds(name, port, typed)
    return typed


def check_bounds(name: str, port: Port, value: float) -> None:
    """See that a value is finite and lies within the variable's bounds.

    Raises:
        WiringError: it does not; the message names `name`.
    """
    if not math.isfinite(value):
        raise WiringError(name, f"is {value}", "give a finite number")
    low, high = port.minimum, port.maximum
    if (low is not None and value < low) or (high is not None and value > high):
        raise WiringError(name, f"is {value:g}, outside its bounds {span(low, high)}", "choose a value inside")
