"""The study file of a linear model that is identified from records alone."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from identification.linear.modes import ReductionMethod
from identification.linear.poles import Poles
from identification.linear.preparation import Preparation
from identification.linear.schema import ConditioningBlock
from identification.linear.updating import UpdatedMatrix
from identification.recordings.schema import RecordedStudyBlock, UsedSignals
from identification.subspace.orders import Best, Gap, OrderRule, Threshold
from identification.subspace.prediction_error import Refinement
from identification.subspace.range_space import SubspaceSettings
from identification.subspace.weightings import Weighting
from orchestrator.yaml_file import Block


class PreparationBlock(ConditioningBlock):
    """What is done to recordings before a linear model is fitted.

    Attributes:
        scaled: whether outputs are brought to the size of the input.
        compensation: magnitude of a friction compensation that is taken off the input.
    """

    scaled: bool = Preparation.scaled
    compensation: float = Field(0.0, ge=0)


class OrderBlock(Block):
    """How many states: by a threshold on the singular values, by their largest gap, or the best of a range."""

    threshold: float | None = Field(None, gt=0, lt=1)
    gap: tuple[int, int] | None = None
    best: tuple[int, int] | None = None

    @model_validator(mode="after")
    def _one_rule(self) -> OrderBlock:
        if sum(rule is not None for rule in (self.threshold, self.gap, self.best)) != 1:
            raise ValueError("give one of `threshold`, `gap` and `best`")
        for name, limits in (("gap", self.gap), ("best", self.best)):
            if limits is not None and not 1 <= limits[0] <= limits[1]:
                raise ValueError(f"`{name}` is [least, most], from 1 up")
        return self

    @property
    def rule(self) -> OrderRule:
        """The one that was given."""
        if self.threshold is not None:
            return Threshold(self.threshold)
        if self.gap is not None:
            return Gap(*self.gap)
        assert self.best is not None
        return Best(range(self.best[0], self.best[1] + 1))


class ReductionBlock(Block):
    """Which modes a model keeps, and what is computed anew afterwards.

    Attributes:
        order: states that are kept.
        flexible: known frequencies [Hz] for `by: mrmc`.
    """

    order: int = Field(ge=1)
    by: ReductionMethod = "mrm"
    flexible: list[float] = []
    update: UpdatedMatrix = "output"

    @model_validator(mode="after")
    def _known(self) -> ReductionBlock:
        if (self.by == "mrmc") != bool(self.flexible):
            raise ValueError("`flexible` frequencies belong to `by: mrmc`")
        return self


class SubspaceBlock(RecordedStudyBlock):
    """A study that identifies a linear model of any order from records, without a system to start from.

    Attributes:
        inputs, outputs: signals of the traces.
        sample: even distance of samples that the traces are brought to [s], inputs held and outputs interpolated; None
            takes them as they are.
        block: block rows of the data matrices (q of the flexible-manipulator thesis).
        weightings: methods that are compared; the first is the one that is refined and reduced.
        refine: whether the free-run error is minimised from there.
        take: which model is written: a weighting, "refined" or "reduced"; by default the last of these that there is.
        start: seconds at the beginning of a trace kept aside that its initial state is estimated from.
        name: of the FMU.
    """

    method: Literal["subspace"]
    inputs: list[str] = Field(min_length=1)
    outputs: list[str] = Field(min_length=1)
    sample: float | None = Field(None, gt=0)
    preparation: PreparationBlock = PreparationBlock()
    block: int = Field(ge=2)
    past: int | None = Field(SubspaceSettings.past, ge=1)
    weightings: list[Weighting] = Field(["orse"], min_length=1)
    order: int | OrderBlock
    feedthrough: bool = SubspaceSettings.feedthrough
    closed_loop: bool = SubspaceSettings.closed_loop
    poles: Poles = SubspaceSettings.poles
    initial_states: bool = SubspaceSettings.initial_states
    refine: bool = False
    reduce: ReductionBlock | None = None
    take: str | None = None
    start: float = Field(0.0, ge=0)
    at_least: float | None = None
    name: str = "plant"

    @model_validator(mode="after")
    def _consistent(self) -> SubspaceBlock:
        if self.take is not None and self.take not in self.models:
            raise ValueError(f"`take` is one of {', '.join(self.models)}")
        stray = [name for name in self.preparation.zero_mean if name not in self.outputs]
        if stray:
            raise ValueError(f"`preparation.zero_mean`: {stray[0]} is no output")
        if self.traces.values:
            raise ValueError("`traces.values` mean nothing here; remove them")
        if not self.name.isidentifier():
            raise ValueError("`name`: use letters, digits and underscores")
        return self

    @property
    def signals(self) -> UsedSignals:
        """What it uses of the traces."""
        return UsedSignals(frozenset(self.inputs), frozenset(self.outputs))

    @property
    def shortest(self) -> int:
        """Samples that a piece of a trace between marks has at least; enough to fit it, and to judge it."""
        return self.block * (2 + max(2, len(self.outputs)))

    @property
    def models(self) -> list[str]:
        """Names of the models that the study makes, the most worked on last."""
        return [*self.weightings, *(["refined"] if self.refine else []), *(["reduced"] if self.reduce else [])]

    @property
    def taken(self) -> str:
        """Name of the one that is written."""
        return self.take or self.models[-1]

    @property
    def rule(self) -> OrderRule:
        """How the order is found."""
        return self.order if isinstance(self.order, int) else self.order.rule

    def settings(self, weighting: Weighting) -> SubspaceSettings:
        """How a model is estimated with one of the weightings."""
        return SubspaceSettings(
            self.block,
            weighting,
            past=self.past,
            closed_loop=self.closed_loop,
            feedthrough=self.feedthrough,
            initial_states=self.initial_states,
            poles=self.poles,
        )

    @property
    def refinement(self) -> Refinement:
        """How the first weighting's model is refined."""
        return Refinement(
            "innovations" if self.closed_loop else "output-error",
            feedthrough=self.feedthrough,
            poles=self.poles,
            initial_states=self.initial_states,
        )
