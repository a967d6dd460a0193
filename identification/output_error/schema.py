"""The study file of an output-error calibration."""

from __future__ import annotations

from fractions import Fraction
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from identification.estimation.arrow_least_squares import LossKind
from identification.estimation.parameters import Scale
from identification.recordings.schema import RecordedStudyBlock, Signals
from orchestrator.assembly.schema import SystemBlock
from orchestrator.yaml_file import Block, Seconds, exact


def _number_or_name(value: Any) -> Any:
    number = isinstance(value, str) and value[:1] in "+-.0123456789"
    return float(exact(value)) if number else value


Delay = Annotated[float | str, BeforeValidator(_number_or_name)]  # [s], or the name of a parameter


class SignalBlock(Block):
    """A signal of the traces, and how much later than the system it is (an output) or reaches it (an input).

    Attributes:
        factor: from the signal's unit to the variable's.
        delay: [s] or the name of a parameter of the study; a command with a delay counts by its mean over each
            communication step, one without by its value at the beginning.
    """

    signal: str
    factor: float = 1.0
    delay: Delay | None = None


class InitialBlock(Block):
    """A start value read off a signal around the beginning of each window.

    A polynomial of `degree` is fitted to the samples within `half_width` [s]; its value or derivative there counts,
    times `factor`, which makes a start value of a reading in a converter's units.
    """

    signal: str
    factor: float = 1.0
    derivative: int = Field(0, ge=0, le=2)
    half_width: float = Field(0.018, gt=0)
    degree: int = Field(2, ge=0, le=6)
    estimated: bool = False

    @model_validator(mode="after")
    def _differentiable(self) -> InitialBlock:
        if self.derivative > self.degree:
            raise ValueError(f"a polynomial of degree {self.degree} has no derivative {self.derivative} but 0")
        return self


class WindowsBlock(Block):
    """Free runs of `length` [s], `every` so often [s] (back to back by default), after `skip` [s], at most `most`."""

    length: Seconds
    every: Seconds | None = None
    skip: Seconds = Fraction(0)
    most: int | None = Field(None, ge=1)

    @model_validator(mode="after")
    def _positive(self) -> WindowsBlock:
        if self.length <= 0 or (self.every is not None and self.every <= 0) or self.skip < 0:
            raise ValueError("`length` and `every` must be positive, `skip` not negative")
        return self


class ValidationBlock(WindowsBlock):
    """Windows of the traces kept out of the fit, and the median FIT they have to reach."""

    at_least: float | None = None


class ParameterBlock(Block):
    """A parameter to estimate (start, bounds, scale), or one tied to another by a factor."""

    start: float | None = None
    min: float | None = None
    max: float | None = None
    scale: Scale = "linear"
    fixed: bool = False
    tied: str | None = None
    factor: float = 1.0

    @model_validator(mode="after")
    def _free_or_tied(self) -> ParameterBlock:
        if self.tied is not None and (self.start, self.min, self.max) != (None, None, None):
            raise ValueError("a tied parameter has no start and no bounds")
        return self

    @property
    def spans(self) -> bool:
        """Whether it is told where it may lie."""
        known = self.start is not None and (self.fixed or (self.min is not None and self.max is not None))
        return known or self.tied is not None


class LossBlock(Block):
    """How much a sample counts that lies far off; `scale` is in standard deviations of the weighted output."""

    kind: LossKind = "linear"
    scale: float = Field(1.0, gt=0)


class OptionsBlock(Block):
    """How the estimation searches; see `output_error.Options`."""

    starts: int = Field(1, ge=1)
    seed: int = 0
    max_evaluations: int = Field(60, ge=1)
    cost_tolerance: float = Field(1e-5, gt=0)
    step_tolerance: float = Field(1e-5, gt=0)
    difference_step: float = Field(1e-4, gt=0)


class OutputErrorBlock(RecordedStudyBlock, SystemBlock):
    """A study that fits parameters of a system to traces by the error of free runs.

    Attributes:
        step: communication step of the free runs [s].
        weight: whether outputs are scaled by their spread in each window, over all windows, or not at all.
        compare: name -> parameters that are judged beside the estimate on the same windows.
        truth: values behind synthetic traces, shown beside the estimates.
    """

    method: Literal["output-error"]
    step: Seconds
    inputs: dict[str, SignalBlock] = {}
    outputs: dict[str, SignalBlock] = Field(min_length=1)
    initial: dict[str, InitialBlock] = {}
    windows: WindowsBlock
    validation: ValidationBlock | None = None
    parameters: dict[str, ParameterBlock] = Field(min_length=1)
    weight: Literal["window", "output", "none"] = "output"
    loss: LossBlock = LossBlock()
    options: OptionsBlock = OptionsBlock()
    compare: dict[str, dict[str, float]] = {}
    truth: dict[str, float] = {}

    @model_validator(mode="after")
    def _consistent(self) -> OutputErrorBlock:
        if self.step <= 0:
            raise ValueError("`step` must be positive")
        for name in self.traces.values:
            if name in self.parameters or name in self.initial:
                raise ValueError(f"{name} is given by `traces.values` and by another key; remove one")
        return self

    @model_validator(mode="after")
    def _known_delays(self) -> OutputErrorBlock:
        for name, signal in {**self.inputs, **self.outputs}.items():
            if isinstance(signal.delay, str) and signal.delay not in self.delays:
                raise ValueError(
                    f"{name}: delay '{signal.delay}' is no parameter of the study; declare it, without a dot"
                )
        for name in self.delays:
            block = self.parameters[name]
            if not block.spans:
                raise ValueError(f"{name}: a delay needs `start`, `min` and `max`, or `start` and `fixed: true`")
            if block.tied is not None and (block.tied not in self.delays or self.parameters[block.tied].tied):
                raise ValueError(f"{name}: a delay can only be tied to another delay, itself not tied")
        return self

    @model_validator(mode="after")
    def _one_delay_a_signal(self) -> OutputErrorBlock:
        read: dict[str, Delay | None] = {}
        for block in self.outputs.values():
            if read.setdefault(block.signal, block.delay) != block.delay:
                raise ValueError(f"signal {block.signal} has two delays")
        return self

    @model_validator(mode="after")
    def _compared_within_bounds(self) -> OutputErrorBlock:
        for name, values in self.compare.items():
            for delay in set(values) & set(self.delays):
                block, value = self.parameters[delay], values[delay]
                if (block.min is not None and value < block.min) or (block.max is not None and value > block.max):
                    raise ValueError(f"compare.{name}: {delay} is not within its bounds")
        return self

    @property
    def signals(self) -> Signals:
        """What it uses of the traces."""
        measured = {block.signal for blocks in (self.outputs, self.initial) for block in blocks.values()}
        return Signals(frozenset(block.signal for block in self.inputs.values()), frozenset(measured))

    @property
    def delays(self) -> list[str]:
        """The parameters that are delays and not of a component: named by a signal, or what such a one is tied to."""
        named = {block.delay for block in (*self.inputs.values(), *self.outputs.values())}
        tied = {block.tied for name, block in self.parameters.items() if name in named}
        return [name for name in self.parameters if "." not in name and name in named | tied]
