"""What study files of linear models have in common: how recordings are prepared."""

from __future__ import annotations

from pydantic import Field

from identification.linear.preparation import Offsets, Preparation
from orchestrator.yaml_file import Block


class ConditioningBlock(Block):
    """What is done to every recording before a model is fitted."""

    explained_by = (Preparation,)

    zero_mean: tuple[str, ...] = Preparation.zero_mean
    cutoff: float | None = Field(Preparation.cutoff, gt=0)
    causal: bool = Preparation.causal
    filter_input: bool = Preparation.filter_input

    def preparation(self, *, scaled: bool = Preparation.scaled, offsets: Offsets | None = None) -> Preparation:
        """The steps; `scaled` brings outputs to the size of the input, `offsets` are taken off."""
        return Preparation(self.zero_mean, self.cutoff, self.causal, self.filter_input, scaled, offsets)
