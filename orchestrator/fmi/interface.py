"""What an FMU offers to a system, in plain values: its variables and what acts on what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Value = float | int | bool | str
_NO_NUMBER = ("String", "Binary", "Clock")


@dataclass(frozen=True)
class Port:
    """A scalar variable of an FMU, or an element of an array of parameters, named as in `A[1,2]`.

    Attributes:
        type: FMI type name ("Real", "Float64", "Integer", "Int32", "Boolean", "Enumeration", "String", ...).
        variability: "constant", "fixed", "tunable", "discrete" or "continuous".
        start: start value as the file gives it, None without one.
        items: name -> value of an enumeration.
        array: start values of the array it is an element of, row by row.
        element: its number there, from 0.
    """

    name: str
    reference: int
    type: str
    causality: str
    unit: str | None = None
    start: str | None = None
    minimum: float | None = None
    maximum: float | None = None
    items: Mapping[str, int] | None = None
    description: str = ""
    variability: str = "continuous"
    array: tuple[float, ...] = field(default=(), repr=False)
    element: int = 0

    @property
    def numeric(self) -> bool:
        """Whether its values are numbers (or true and false), so that they can be connected and recorded."""
        return self.type not in _NO_NUMBER

    @property
    def settable(self) -> bool:
        """Whether it can be given a value before a run: parameters, inputs, and states with a start value."""
        causes = ("parameter", "input", "local", "output")
        return self.causality in causes and self.variability != "constant" and self.start is not None


@dataclass(frozen=True)
class Interface:
    """What a component offers to a system.

    Attributes:
        ports: name -> scalar variable.
        feed_through: output -> the inputs that act on it at once; None where the FMU does not say.
    """

    model_name: str
    fmi_version: str
    ports: Mapping[str, Port]
    feed_through: Mapping[str, frozenset[str] | None]
    has_state: bool = False
    fixed_step: float | None = None
    variable_step: bool = True

    def of(self, causality: str) -> tuple[Port, ...]:
        """Ports of one causality."""
        return tuple(port for port in self.ports.values() if port.causality == causality)
