"""Which tangents a run carries: from the parameters that it is differentiated by, through connections, to outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fmus.errors import TangentsMissing
from orchestrator.engine.planning.plan import Plan
from orchestrator.fmi.component import Component
from orchestrator.fmi.interface import along as names_along
from orchestrator.fmi.slave import Slave
from orchestrator.system import Connection, Endpoint, System
from orchestrator.trace import FloatArray


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """What a run records, and how that moves with parameters and start values.

    Attributes:
        rows: (K, n) a column a recorded variable [its unit].
        slopes: (K, n, d) their derivatives by d values [unit per unit].
    """

    rows: FloatArray
    slopes: FloatArray


@dataclass(frozen=True)
class Carried:
    """The tangents of a system's variables.

    Attributes:
        by: component.variable of the values that a run is differentiated by, a direction each.
        moved: component whose values move with any of them -> its own of these values -> number of the direction.
    """

    by: tuple[str, ...]
    moved: Mapping[str, Mapping[str, int]] = field(compare=False)

    @property
    def directions(self) -> int:
        return len(self.by)

    def reaches(self, name: str) -> bool:
        """Whether a component.variable is of a component whose values move."""
        return name.partition(".")[0] in self.moved

    def of(self, variables: Sequence[str]) -> list[str]:
        """Names of the tangents of variables."""
        return [name for variable in variables for name in names_along(variable, self.directions)]

    def of_component(self, component: str, variables: Sequence[str]) -> list[str]:
        """The same of variables of a component; nothing where none moves."""
        return self.of(variables) if component in self.moved else []

    def links(self, connections: Sequence[Connection]) -> list[Connection]:
        """How tangents run along connections."""
        return [
            replace(
                link, source=replace(link.source, variable=one), target=replace(link.target, variable=other), offset=0
            )
            for link in connections
            if link.source.component in self.moved
            for one, other in zip(self.of([link.source.variable]), self.of([link.target.variable]), strict=True)
        ]

    def columns(self, recorded: Sequence[str]) -> list[str]:
        """Names of the tangents of recorded variables that move."""
        return self.of([name for name in recorded if self.reaches(name)])

    def parted(self, recorded: Sequence[str], columns: FloatArray) -> Sensitivities:
        """A record and its tangents, of which `columns` (K, n + m d) has those of the m variables that move."""
        count, n, d = len(columns), len(recorded), self.directions
        slopes = np.zeros((count, n, d))
        moving = [place for place, name in enumerate(recorded) if self.reaches(name)]
        slopes[:, moving] = columns[:, n:].reshape(count, len(moving), d)
        return Sensitivities(columns[:, :n], slopes)

    def begin(self, components: Mapping[str, Component]) -> None:
        """Have the components that are reached carry them, each direction along one value.

        Raises:
            TangentsMissing: one cannot.
        """
        for name, along in self.moved.items():
            component = components[name]
            if not isinstance(component, Slave) or not component.carries:
                raise TangentsMissing(name, "its FMU carries no tangents", "take differences")
            component.carry(self.directions, along)


NOTHING = Carried((), {})


def carried(system: System, plan: Plan, by: Sequence[str]) -> Carried:
    """The tangents of a system's variables along these values.

    Raises:
        TangentsMissing: a cycle is iterated: its steps are taken back, and those that carry tangents cannot be.
    """
    if plan.iterated:
        raise TangentsMissing(
            "order", "iterated steps are taken back, and those that carry tangents cannot be", "take differences"
        )
    if carrying := next((name for name, part in system.parts.items() if part.carries), None):
        raise TangentsMissing(carrying, "carries frames, which have no tangents", "take differences")
    for group in plan.groups:
        feeds = (link for link in system.connections if link.source.component == link.target.component == group[0])
        if len(group) > 1 or any(link.source.variable in plan.instant[group[0]] for link in feeds):
            raise TangentsMissing(", ".join(group), "a cycle of direct feed-through is iterated", "take differences")
    moved: dict[str, dict[str, int]] = {}
    for number, value in enumerate(map(Endpoint.parse, by)):
        moved.setdefault(value.component, {})[value.variable] = number
    while True:
        more = {link.target.component for link in system.links if link.source.component in moved} - moved.keys()
        if not more:
            return Carried(tuple(by), moved)
        moved |= {component: {} for component in more}
