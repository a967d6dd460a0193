"""How a study names its procedure, with the keys that each takes."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from identification.estimation.parameters import Scale
from identification.tuning.procedures.search import Search, Unknown
from orchestrator.yaml_file import Block, Quantity


class UnknownBlock(Block):
    """A parameter of the controller that is sought between bounds, in its unit or with their own: `5 V`."""

    start: float | Quantity | None = None
    min: float | Quantity
    max: float | Quantity
    scale: Scale = Unknown.scale


class SearchBlock(Block):
    """A search within bounds; see `search.Search`.

    Attributes:
        starts: points to start from, each parameter -> value, over the unknowns' own; in their units.
        more: how many further starts are drawn between the bounds.
    """

    by: Literal["search"] = "search"
    unknowns: dict[str, UnknownBlock] = Field(min_length=1)
    starts: list[dict[str, float | Quantity]] = []
    more: int = Field(Search.more, ge=0)
    seed: int = Search.seed
    evaluations: int = Field(Search.evaluations, ge=10)

    @model_validator(mode="after")
    def _known(self) -> SearchBlock:
        for start in self.starts:
            for name in start:
                if name not in self.unknowns:
                    raise ValueError(f"`starts`: '{name}' is none of the unknowns")
        return self

    def procedure(self) -> Search:
        """As a plain value."""
        unknowns = {
            name: Unknown(block.min, block.max, block.start, block.scale) for name, block in self.unknowns.items()
        }
        return Search(unknowns, tuple(self.starts), self.more, self.seed, self.evaluations)


DesignBlock = SearchBlock
