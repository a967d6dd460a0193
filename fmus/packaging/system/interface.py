"""What the FMU of a system shows: the variables of its parts by dotted names, and what depends on what through them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from fmus.modelling.model import element
from fmus.modelling.ports import PhysicalPort
from fmus.modelling.symbolic import feed_through
from fmus.packaging import values
from fmus.packaging.description import exposure
from fmus.packaging.description.interface import Exposed, ModelInterface, connectable
from fmus.packaging.system.fused import FusedSystem, Wire
from fmus.packaging.system.nested import NestedPart


@dataclass(frozen=True)
class SystemInterface:
    """The interface of a system's FMU.

    Attributes:
        models: part that is made of a model -> the interface of that alone.
        inside: part -> its variables, by their dotted names; value references go on from part to part.
        variables: those that importers see.
    """

    system: FusedSystem
    models: Mapping[str, ModelInterface]
    inside: Mapping[str, tuple[Exposed, ...]]
    variables: tuple[Exposed, ...]

    @property
    def name(self) -> str:
        return self.system.name

    @property
    def description(self) -> str:
        return self.system.description

    @property
    def structured(self) -> bool:
        return not self.system.nested  # whose variables may have any names

    @property
    def time_reference(self) -> int:
        return sum(map(len, self.inside.values()))

    @property
    def rates(self) -> Mapping[str, tuple[str, ...]]:
        return {}

    @cached_property
    def by_name(self) -> Mapping[str, Exposed]:
        return {variable.name: variable for variable in self.variables}

    @property
    def ports(self) -> tuple[PhysicalPort, ...]:
        named = (
            replace(one, name=f"{part}.{one.name}", signal=f"{part}.{one.signal}", flow=f"{part}.{one.flow}")
            for part, own in self.models.items()
            for one in own.model.ports
        )
        return connectable(named, self.by_name)

    @cached_property
    def arrays(self) -> Mapping[str, tuple[int, ...]]:
        found = {f"{part}.{name}": shape for part, one in self.models.items() for name, shape in one.arrays.items()}
        shown = {array[0] for array in map(element, self.by_name) if array is not None}
        return {name: shape for name, shape in found.items() if name in shown}

    @cached_property
    def sources(self) -> Mapping[str, Wire]:
        """part.input -> what drives it."""
        return {wire.target: wire for wire in self.system.wires}

    @cached_property
    def references(self) -> Mapping[str, int]:
        """part.variable -> value reference, of those that importers do not see, too."""
        return {variable.name: variable.reference for own in self.inside.values() for variable in own}

    @cached_property
    def outputs(self) -> Mapping[str, tuple[str, ...]]:
        """Each output with the inputs that act on it within the step they are set in."""
        return self._reaching(self._instantly)

    @cached_property
    def initial_unknowns(self) -> Mapping[str, tuple[str, ...]]:
        return self._reaching(self._initially)

    def _reaching(self, direct: Callable[[str], Iterable[str]]) -> dict[str, tuple[str, ...]]:
        """Output -> variables of the FMU that it depends on, by way of wires; `direct` says on what within a part."""
        found = {}
        for variable in self.variables:
            if variable.causality == "output":
                reached, waiting = dict[str, None](), [variable.name]
                while waiting:
                    for name in direct(waiting.pop()):
                        if name not in reached:
                            reached[name] = None
                            waiting += [self.sources[name].source] if name in self.sources else []
                found[variable.name] = tuple(name for name in self.by_name if name in reached)
        return found

    def _instantly(self, output: str) -> list[str]:
        name, _, variable = output.partition(".")
        part = self.system.parts[name]
        if not part.instant:
            return []
        known = part.feed_through if isinstance(part, NestedPart) else feed_through(part.model)
        inputs = known.get(variable)
        return self._of(name, "input") if inputs is None else [f"{name}.{one}" for one in inputs]

    def _initially(self, output: str) -> list[str]:
        part, _, name = output.partition(".")
        if part not in self.models:
            return self._of(part, "input", "parameter")
        return [f"{part}.{one}" for one in self.models[part].initial_unknowns.get(name, ())]

    def _of(self, part: str, *causalities: str) -> list[str]:
        return [variable.name for variable in self.inside[part] if variable.causality in causalities]


def shown(system: FusedSystem) -> SystemInterface:
    """The interface of a system's FMU.

    Raises:
        ModelError: a part's values do not fit its model, or it cannot be traced.
    """
    models, inside, first = {}, {}, 0
    for name, part in system.parts.items():
        if isinstance(part, NestedPart):
            own = [variable.shown for variable in part.variables]
        else:
            starts = values.checked(part.model, part.values, part.tables)
            models[name] = exposure.complete(part.model, starts)
            own = [variable for variable in models[name].variables if variable.reference < models[name].first_rate]
        inside[name] = tuple(
            replace(variable, name=f"{name}.{variable.name}", reference=first + variable.reference) for variable in own
        )
        first += len(own)
    return SystemInterface(system, models, inside, tuple(_seen(system, inside)))


def _seen(system: FusedSystem, inside: Mapping[str, Iterable[Exposed]]) -> Iterable[Exposed]:
    """The variables that importers see: inputs that nothing drives, and what the system is to show."""
    driven, outputs = {wire.target for wire in system.wires}, set(system.outputs)
    parameters = set(system.parameters)
    for variable in (one for variables in inside.values() for one in variables):
        free = variable.causality == "input" and variable.name not in driven
        if free or variable.name in parameters:
            yield variable
        elif variable.name in outputs:
            yield replace(variable, causality="output", initial="calculated")
