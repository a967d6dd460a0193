"""Cases of a scenario that are all combinations of some axes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import Field, model_validator

from orchestrator.assembly.whole_arrays import Values
from orchestrator.scenario.schema import combinations
from orchestrator.scenario.schema.variants import CaseBlock, VariantBlock
from orchestrator.yaml_file import Block

Level = int | float | bool | str
Levels = Annotated[list[Level], Field(min_length=1)] | Annotated[dict[str, VariantBlock], Field(min_length=1)]


class SelectionBlock(VariantBlock):
    """Something for some cases of a matrix only.

    Attributes:
        where: axis -> level or levels; of axes that are not named all are meant.
    """

    where: dict[str, Level | list[Level]] = Field(min_length=1)


class MatrixBlock(Block):
    """Cases that are all combinations of the levels of some axes.

    Attributes:
        axes: name -> levels by name, each a variant; or component.variable -> list of its values.
        name: of a case, with every `{axis}` in it, by default the levels with commas between them.
        exclude: combinations that are left out, each as axis -> level or levels.
        also: what goes for some combinations besides.
    """

    axes: dict[str, Levels] = Field(min_length=1)
    name: str | None = None
    exclude: list[dict[str, Level | list[Level]]] = []
    also: list[SelectionBlock] = []

    @model_validator(mode="after")
    def _names_what_is_there(self) -> MatrixBlock:
        axes = self._levels()
        for one in (*self.exclude, *(block.where for block in self.also)):
            combinations.check_selection(_selection(one), axes)
        if self.name is not None:
            combinations.check_template(self.name, axes)
        self._combinations()
        return self

    def cases(self, sets: Mapping[str, Values]) -> list[CaseBlock]:
        """All cases, the last axis changes fastest.

        Raises:
            ValueError: there is no such set, two axes set one variable, or what is for some cases fits none.
        """
        combined = self._combinations()
        for block in self.also:
            if not any(combinations.selects(_selection(block.where), one) for one in combined):
                raise ValueError(f"no case of the matrix fits {block.where}; correct `where`")
        return [self._case(one, sets) for one in combined]

    def _combinations(self) -> list[combinations.Combination]:
        return combinations.combinations(self._levels(), [_selection(one) for one in self.exclude])

    def _levels(self) -> dict[str, list[str]]:
        """axis -> names of its levels."""
        return {axis: [str(level) for level in levels] for axis, levels in self.axes.items()}

    def _case(self, one: combinations.Combination, sets: Mapping[str, Values]) -> CaseBlock:
        values: Values = {}
        parts = [self._variant(axis, level) for axis, level in one.items()]
        for part in parts:
            given = part.values(sets)
            if twice := sorted(values.keys() & given):
                raise ValueError(f"two axes of the matrix set {twice[0]}; leave it out of one")
            values |= given
        also = [block for block in self.also if combinations.selects(_selection(block.where), one)]
        for block in also:
            values |= block.values(sets)
        parts += also
        return CaseBlock(
            name=combinations.named(self.name, one),
            set=values,
            expect=[block for part in parts for block in part.expect],
            components={name: block for part in parts for name, block in part.components.items()},
            connections=[line for part in parts for line in part.connections],
        )

    def _variant(self, axis: str, level: str) -> VariantBlock:
        levels = self.axes[axis]
        if isinstance(levels, dict):
            return levels[level]
        return VariantBlock(set={axis: next(value for value in levels if str(value) == level)})


def _selection(where: Mapping[str, Level | list[Level]]) -> dict[str, list[str]]:
    return {axis: [str(one) for one in (some if isinstance(some, list) else [some])] for axis, some in where.items()}
