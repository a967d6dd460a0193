"""A system that becomes one FMU, in plain values: its parts, how they are wired, and how they are stepped."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

from fmus.modelling.model import Model, Number, Table
from fmus.packaging.system.nested import NestedPart


@dataclass(frozen=True)
class FusedPart:
    """A model in a system.

    Attributes:
        values: of inputs and parameters, in place of the model's own.
        every: its communication step [base steps].
        instant: whether its outputs hold at once, and not from the end of its step on.
    """

    model: Model
    values: Mapping[str, Number]
    tables: Mapping[str, Table]
    every: int
    instant: bool

    @property
    def title(self) -> str:
        return self.model.name

    @property
    def description(self) -> str:
        return self.model.description

    @property
    def parameters(self) -> tuple[str, ...]:
        return tuple(variable.name for variable in self.model.of("parameter"))

    @property
    def outputs(self) -> tuple[str, ...]:
        return tuple(variable.name for variable in self.model.of("output"))

    @property
    def states(self) -> tuple[str, ...]:
        return tuple(state.name for state in self.model.states)


SystemPart = FusedPart | NestedPart


@dataclass(frozen=True)
class Wire:
    """target = factor * source + offset; both ends are part.variable."""

    source: str
    target: str
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class FusedSystem:
    """Models and FMUs wired to a system, and what its FMU shows of them.

    Attributes:
        name: an identifier of C; the FMU's model name.
        parts: in the order in which they are stepped, without circles of direct feed-through.
        base: the step of which all others are multiples [s].
        start, stop, step: of the default experiment [s].
        outputs: part.variable of the outputs and states that are shown.
        parameters: part.parameter of those that are shown; the others keep their values.
        finite: whether an output that is not finite ends a run.
        tolerance: relative, which FMUs inside are told where the importer tells none; 0 is none.
    """

    name: str
    description: str
    parts: Mapping[str, SystemPart]
    wires: tuple[Wire, ...]
    base: Fraction
    start: Fraction
    stop: Fraction
    step: Fraction
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    finite: bool = True
    tolerance: float = 0.0

    @property
    def models(self) -> dict[str, FusedPart]:
        """The parts that are made of models."""
        return {name: part for name, part in self.parts.items() if isinstance(part, FusedPart)}

    @property
    def nested(self) -> dict[str, NestedPart]:
        """The parts that are FMUs."""
        return {name: part for name, part in self.parts.items() if isinstance(part, NestedPart)}
