"""Variants of a scenario: what a case has that the others do not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from fmus.words import nearest
from orchestrator.assembly.assembly import SystemSpec, link
from orchestrator.assembly.schema import Components, Connections
from orchestrator.assembly.whole_arrays import Values
from orchestrator.scenario.expectations.schema import ExpectationBlock
from orchestrator.yaml_file import Block


class VariantBlock(Block):
    """What differs from the scenario: values, what must hold besides, components and connections that are added.

    Attributes:
        set: component.variable -> value, over those of the scenario, in the unit of the variable or its own: `400 g`.
        expect: what must hold besides what the scenario expects.
        use: names of `sets` whose values it takes; later ones count, and `set` over all.
        components: as those of a scenario, over those of the same name there; a case with any is run with a system of
            its own.
        connections: besides those of the scenario.
    """

    use: list[str] = []
    set: Values = {}
    expect: list[ExpectationBlock] = []
    components: Components = {}
    connections: Connections = []

    @property
    def has_own_system(self) -> bool:
        """Whether it is run with a system of its own."""
        return bool(self.components or self.connections)

    def system(self, common: SystemSpec, base: Path, said: list[str]) -> SystemSpec:
        """Its system: the common one with what it adds; files are relative to `base`."""
        own = {name: block.spec(base, said) for name, block in self.components.items()}
        connections = (*common.connections, *map(link, self.connections))
        return replace(common, components={**common.components, **own}, connections=connections)

    def values(self, sets: Mapping[str, Values]) -> Values:
        """component.variable -> value, of the sets that it uses and its own.

        Raises:
            ValueError: there is no such set.
        """
        if unknown := next((name for name in self.use if name not in sets), None):
            raise ValueError(f"there is no set '{unknown}'; {nearest(unknown, sets)}")
        given: Values = {}
        for name in self.use:
            given |= sets[name]
        return given | self.set


class CaseBlock(VariantBlock):
    """A variant of the scenario with a name.

    Attributes:
        name: of the case, in tables and, as far as letters allow, of the file with its trace.
    """

    name: str
