"""What study files of linear models have in common: how recordings are prepared."""

from __future__ import annotations

from pydantic import Field

from identification.linear.preparation import Offsets, Preparation
from orchestrator.yaml_file import Block


class ConditioningBlock(Block):
    """What is done to every recording before a model is fitted; see `preparation.Preparation`.

    Attributes:
        zero_mean: outputs that are centred; the others start at zero.
        cutoff: corner of a second-order Butterworth low-pass [Hz]; nothing is filtered without.
        causal: whether it filters forwards alone, as an instrument would; else to and fro, without a lag.
        filter_input: whether inputs are filtered as outputs are.
    """

    zero_mean: tuple[str, ...] = Preparation.zero_mean
    cutoff: float | None = Field(Preparation.cutoff, gt=0)
    causal: bool = Preparation.causal
    filter_input: bool = Preparation.filter_input

    def preparation(self, *, scaled: bool = Preparation.scaled, offsets: Offsets | None = None) -> Preparation:
        """The steps; `scaled` brings outputs to the size of the input, `offsets` are taken off."""
        return Preparation(self.zero_mean, self.cutoff, self.causal, self.filter_input, scaled, offsets)
