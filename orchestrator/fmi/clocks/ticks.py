"""Ticks on their way from a component to another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

NOTHING: Mapping[int, float] = MappingProxyType({})  # what a tick brings along that comes from inside


@dataclass(frozen=True)
class Tick:
    """That output clocks of a component ticked.

    Attributes:
        time: when [s].
        clocks: their names.
        outputs: the component's bound outputs then.
    """

    time: float
    clocks: frozenset[str]
    outputs: Sequence[float]


@dataclass(frozen=True)
class Arrival:
    """That input clocks of a component tick because others did.

    Attributes:
        time: when [s].
        clocks: their names.
        inputs: place among its bound inputs -> value that came with the tick.
    """

    time: float
    clocks: frozenset[str]
    inputs: Mapping[int, float]
