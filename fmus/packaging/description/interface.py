"""What an FMU shows of a model: every variable with its value reference, and what depends on what.

The XML descriptions of both FMI versions and the generated C are written from it, so that they cannot differ.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

from fmus.modelling.model import Model, Number, State, start_values
from fmus.modelling.ports import PhysicalPort

DEFAULT_STEP = 0.01


@dataclass(frozen=True)
class Exposed:
    """One scalar variable as importers see it; `initial` is None where the standards want none."""

    name: str
    reference: int
    causality: str
    variability: str
    initial: str | None
    type: str
    unit: str
    description: str
    start: Number | None = None
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None
    choices: tuple[str, ...] = ()
    derivative_of: str | None = None


class DescribedInterface(Protocol):
    """The variables of an FMU in the order of its description, and its structure: unknown -> what it depends on.

    Attributes:
        arrays: name -> shape of each array, whose elements are variables.
        structured: whether names are made of the names of parts and elements.
        time_reference: value reference of the time, which only FMI 3.0 has as a variable.
        ports: those of which both variables are to be connected.
    """

    @property
    def name(self) -> str: ...
    @property
    def description(self) -> str: ...
    @property
    def arrays(self) -> Mapping[str, tuple[int, ...]]: ...
    @property
    def structured(self) -> bool: ...
    @property
    def variables(self) -> tuple[Exposed, ...]: ...
    @property
    def outputs(self) -> Mapping[str, tuple[str, ...]]: ...
    @property
    def rates(self) -> Mapping[str, tuple[str, ...]]: ...
    @property
    def initial_unknowns(self) -> Mapping[str, tuple[str, ...]]: ...
    @property
    def time_reference(self) -> int: ...
    @property
    def by_name(self) -> Mapping[str, Exposed]: ...
    @property
    def ports(self) -> tuple[PhysicalPort, ...]: ...


@dataclass(frozen=True)
class ModelInterface:
    """The interface of an FMU that is a single model; `networked` where it is on a bus."""

    model: Model
    variables: tuple[Exposed, ...]
    outputs: Mapping[str, tuple[str, ...]]
    rates: Mapping[str, tuple[str, ...]]
    initial_unknowns: Mapping[str, tuple[str, ...]]
    networked: bool = False

    def on_a_bus(self, received: Collection[str]) -> ModelInterface:
        """The same with inputs that frames set: they are no inputs of the FMU any more."""
        variables = tuple(
            replace(one, causality="local", variability="discrete", initial="exact") if one.name in received else one
            for one in self.variables
        )

        def without(unknowns: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
            return {name: tuple(one for one in known if one not in received) for name, known in unknowns.items()}

        return replace(
            self,
            variables=variables,
            outputs=without(self.outputs),
            rates=without(self.rates),
            initial_unknowns=without(self.initial_unknowns),
            networked=True,
        )

    @property
    def name(self) -> str:
        return self.model.name

    @property
    def description(self) -> str:
        return self.model.description

    @property
    def arrays(self) -> Mapping[str, tuple[int, ...]]:
        return self.model.arrays

    @property
    def structured(self) -> bool:
        return bool(self.model.arrays)

    @property
    def first_rate(self) -> int:
        """Value reference of the first state's rate; those of the others follow, then comes the time."""
        return len(self.model.variables) + len(hidden_states(self.model))

    @property
    def time_reference(self) -> int:
        return self.first_rate + len(self.model.continuous)

    @cached_property
    def by_name(self) -> Mapping[str, Exposed]:
        return {variable.name: variable for variable in self.variables}

    @property
    def ports(self) -> tuple[PhysicalPort, ...]:
        return connectable(self.model.ports, self.by_name)


def connectable(ports: Iterable[PhysicalPort], variables: Mapping[str, Exposed]) -> tuple[PhysicalPort, ...]:
    """The ports of which both variables are among these, as inputs and outputs."""
    outside = {name for name, variable in variables.items() if variable.causality in ("input", "output")}
    return tuple(one for one in ports if {one.signal, one.flow} <= outside)


def clocked(model: Model) -> bool:
    """Whether the samples of a model can be taken at the ticks of a clock: not where inputs act late, for then it takes
    steps to know with which."""
    return bool(model.sampled) and not model.delays


def exchangeable(model: Model) -> bool:
    """Whether a model can be offered for model exchange: it has continuous states, no sampled ones, no arrays, and
    no input that acts late, which takes steps to know."""
    return bool(model.continuous) and not (model.sampled or model.arrays or model.delays)


def hidden_states(model: Model) -> tuple[State, ...]:
    """States that are no outputs."""
    return tuple(state for state in model.states if state.name not in model.by_name)


def rate_name(state: str) -> str:
    return f"der({state})"


def default_step(model: Model, defaults: Mapping[str, Number]) -> float:
    """Communication step [s] that suits the model: its sample period, or 10 ms."""
    values = start_values(model) | dict(defaults)
    return float(values[model.sample_time]) if model.sampled and model.sample_time else DEFAULT_STEP
