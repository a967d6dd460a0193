"""Bound inputs by when they may be set: at any time, in events, or when a clock ticks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from orchestrator.fmi.functions.values import VariableGroup
from orchestrator.fmi.interface import Interface


@dataclass(frozen=True)
class InputPart:
    """Inputs that are set together.

    Attributes:
        clocks: those at whose ticks they are set; none of inputs without a clock.
        discrete: whether they are set in events only.
        places: where they are among the bound inputs.
    """

    clocks: frozenset[str]
    discrete: bool
    places: Sequence[int]
    group: VariableGroup

    def write(self, values: Sequence[float]) -> int:
        """Set them out of the values of all bound inputs. The status."""
        return self.group.write([values[place] for place in self.places])

    def changed(self, one: Sequence[float], other: Sequence[float]) -> bool:
        """Whether two sets of values of all bound inputs differ in these."""
        return any(one[place] != other[place] for place in self.places)


def parts(interface: Interface, inputs: Sequence[str], group: Callable[..., VariableGroup]) -> list[InputPart]:
    """The bound inputs by when they are set; `group` binds variables."""
    kinds: dict[tuple[frozenset[str], bool], list[int]] = {}
    for place, name in enumerate(inputs):
        port = interface.ports.get(name)
        clocks = interface.clocked.get(name, frozenset())
        discrete = port is not None and (port.variability != "continuous" or not port.real)
        kinds.setdefault((clocks, discrete), []).append(place)
    return [
        InputPart(clocks, discrete, places, group(*(inputs[place] for place in places)))
        for (clocks, discrete), places in kinds.items()
    ]
