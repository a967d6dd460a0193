"""The study file of a linear model that is identified from records alone."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from identification.linear.modes import ReductionMethod
from identification.linear.poles import Poles
from identification.linear.preparation import Preparation
from identification.linear.reduction import UpdatedMatrix
from identification.linear.schema import ConditioningBlock
from identification.recordings.schema import RecordedStudyBlock, UsedSignals
from identification.subspace.orders import Best, Gap, OrderRule, Threshold
from identification.subspace.range_space import SubspaceSettings
from identification.subspace.refinement.prediction_error import Refinement
from identification.subspace.weightings import Weighting
from orchestrator.yaml_file import Block, Time

_BLOCKS = (5, 10, 20, 30)


class PreparationBlock(ConditioningBlock):
    """What is done to recordings before a linear model is fitted.

    Attributes:
        compensation: magnitude of a friction compensation that is taken off the input.
    """

    scaled: bool = Preparation.scaled
    compensation: float = Field(0.0, ge=0)


class OrderBlock(Block):
    """How many states: by a threshold on the singular values, by their largest gap, or the best of a range.

    Attributes:
        threshold: as many states as singular values exceed this share of the largest.
        gap: [least, most]; the order between them after which the singular values fall by the largest factor.
        best: [least, most]; the smallest order between them whose free-run error is within 1 % of the least.
    """

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
        by: how modes are ranked: by `mrm`, by `msv`, or `mrmc`, by MRM but with those of known frequencies kept.
        update: which matrix is computed anew from the records: `input` (B), `output` (C) or `none`.
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
        preparation: what is done to recordings first.
        reduce: how the model is reduced and updated; not at all without.
        block: block rows of the data matrices (q of the flexible-manipulator thesis); some sizes are compared without.
        weightings: methods that are compared; the model with the best free run is refined and reduced.
        order: how many states; the best of up to 10 without.
        feedthrough: whether inputs act on outputs at once; both are compared without.
        poles: without, free ones and stable ones are compared.
        refine: whether the free-run error is minimised from there.
        take: which model is written: a weighting, "refined" or "reduced"; by default the reduced one where there is
            one, else that of the best free run along the traces kept aside (without any, along the fitted ones).
        start: seconds at the beginning of a trace kept aside that its initial state is estimated from; some periods of
            the model without.
        at_least: median FIT that the model that is written has to reach.
        worst_at_least: FIT that it has to reach along every trace and of every output that moves.
        name: of the FMU.
    """

    explained_by = (SubspaceSettings,)

    method: Literal["subspace"]
    inputs: list[str] = Field(min_length=1)
    outputs: list[str] = Field(min_length=1)
    sample: Annotated[Time, Field(gt=0)] | None = None
    preparation: PreparationBlock = PreparationBlock()
    block: int | None = Field(None, ge=2)
    past: int | None = Field(SubspaceSettings.past, ge=1)
    weightings: list[Weighting] = Field(["cva", "moesp", "n4sid"], min_length=1)
    order: int | OrderBlock = OrderBlock(best=(1, 10))
    feedthrough: bool | None = None
    closed_loop: bool = SubspaceSettings.closed_loop
    poles: Poles | None = None
    initial_states: bool = SubspaceSettings.initial_states
    refine: bool = False
    reduce: ReductionBlock | None = None
    take: str | None = None
    start: float | None = Field(None, gt=0)
    at_least: float | None = None
    worst_at_least: float | None = None
    name: str = "plant"

    @model_validator(mode="after")
    def _consistent(self) -> SubspaceBlock:
        if self.take is not None and self.take not in self.models:
            raise ValueError(f"`take` is one of {', '.join(self.models)}")
        named = [*self.inputs, *self.outputs]
        twice = next((name for name in named if named.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f"`inputs` and `outputs`: {twice} is named twice; name each signal once")
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
    def blocks(self) -> tuple[int, ...]:
        """The block sizes that are compared."""
        return _BLOCKS if self.block is None else (self.block,)

    @property
    def shortest(self) -> int:
        """Samples that a piece of a trace between marks has at least; enough to fit it, and to judge it."""
        return min(self.blocks) * (2 + max(2, len(self.outputs)))

    @property
    def models(self) -> list[str]:
        """Names of the models that the study makes, the most worked on last."""
        return [*self.weightings, *(["refined"] if self.refine else []), *(["reduced"] if self.reduce else [])]

    @property
    def rule(self) -> OrderRule:
        """How the order is found."""
        return self.order if isinstance(self.order, int) else self.order.rule

    @property
    def compared_poles(self) -> tuple[Poles, ...]:
        """Where poles may lie, of models that are compared."""
        return ("free", "stable") if self.poles is None else (self.poles,)

    @property
    def compared_feedthrough(self) -> tuple[bool, ...]:
        """Whether models that are compared have a D; in closed loop none has, unless the study asks for one."""
        if self.feedthrough is not None:
            return (self.feedthrough,)
        return (False,) if self.closed_loop else (True, False)

    def ways(self, weighting: Weighting, samples: int) -> list[SubspaceSettings]:
        """How a weighting's models are estimated, one for each block size that so many samples bear, or the least."""
        rows = 2 * (len(self.inputs) + len(self.outputs))
        blocks = [block for block in self.blocks if 2 * block * rows <= samples] or [min(self.blocks)]
        return [self._settings(weighting, block) for block in blocks]

    def _settings(self, weighting: Weighting, block: int) -> SubspaceSettings:
        return SubspaceSettings(
            block,
            weighting,
            past=self.past,
            closed_loop=self.closed_loop,
            feedthrough=self.compared_feedthrough[0],
            initial_states=self.initial_states,
            poles=self.compared_poles[0],
        )

    def refinement(self, settings: SubspaceSettings, *, stable: bool) -> Refinement:
        """How a model that was estimated so is refined; a stable one stays so, unless its poles are to be free."""
        return Refinement(
            "innovations" if self.closed_loop else "output-error",
            feedthrough=settings.feedthrough,
            poles="stable" if stable and self.poles is None else settings.poles,
            initial_states=self.initial_states,
        )
