"""The parts of an output-error study's file: signals, windows, what is known and estimated, and how it is searched."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, StringConstraints, model_validator

from identification.estimation.arrow_least_squares import Loss, LossKind
from identification.estimation.groups import Grouping
from identification.estimation.parameters import Parameter, Scale, Tie
from identification.estimation.prior import LogNormal, Normal, Prior, Uniform
from identification.output_error.search.options import BootstrapKind, IntervalBy, IntervalOptions, SearchOptions
from identification.output_error.study import AutoWindows, StartSpec, WindowSpec
from identification.output_error.times.spans import SpanEntry, WidthEntry, amount
from orchestrator.assembly.schema import ComponentBlock, Connections
from orchestrator.assembly.whole_arrays import Values
from orchestrator.crossing import GivenConversion, quantity
from orchestrator.fmi.interface import Value
from orchestrator.yaml_file import Block, Quantity, Seconds, exact


def _number_or_name(value: Any) -> Any:
    number = isinstance(value, str) and value[:1] in "+-.0123456789"
    return float(exact(value)) if number else value


GroupName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9]([A-Za-z0-9 ._+-]*[A-Za-z0-9])?$")]  # of a file, too
DelayEntry = Annotated[float | str, BeforeValidator(_number_or_name)]  # [s], or the name of a parameter


class SignalBlock(Block):
    """A signal of the traces, and how much later than the system it is (an output) or reaches it (an input).

    Attributes:
        signal: its name in the recordings.
        factor, offset: variable = factor * signal + offset, over what their units say.
        delay: [s] or the name of a parameter of the study; a command with a delay counts by its mean over each
            communication step, one without by its value at the beginning.
    """

    signal: str
    factor: float | None = None
    offset: float | None = None
    delay: DelayEntry | None = None


class InputBlock(SignalBlock):
    """A signal of the traces that drives an input.

    Attributes:
        interpolation: what a command is between its samples, so that it counts by its exact mean over each
            communication step: `hold`, each until the next, or `linear`. Without it and without a delay the value at
            the beginning of the step counts; with a delay alone it is held.
    """

    interpolation: Literal["hold", "linear"] | None = None


class InitialBlock(Block):
    """A start value read off a signal around the beginning of each window.

    Attributes:
        factor, offset: variable = factor * reading + offset, over what their units say.
    """

    explained_by = (StartSpec,)

    signal: str
    factor: float | None = None
    offset: float | None = None
    derivative: int = Field(StartSpec.derivative, ge=0, le=2)
    half_width: WidthEntry = StartSpec.half_width
    degree: int = Field(StartSpec.degree, ge=0, le=6)
    estimated: bool = StartSpec.estimated

    def spec(self) -> StartSpec:
        given = GivenConversion(self.factor, self.offset)
        return StartSpec(self.signal, given, self.derivative, self.half_width, self.degree, self.estimated)

    @model_validator(mode="after")
    def _wide(self) -> InitialBlock:
        if amount(self.half_width) <= 0:
            raise ValueError("`half_width` must be positive")
        return self

    @model_validator(mode="after")
    def _differentiable(self) -> InitialBlock:
        if self.derivative > self.degree:
            raise ValueError(f"a polynomial of degree {self.degree} has no derivative {self.derivative} but 0")
        return self


class WindowsBlock(Block):
    """Where free runs lie in a recording.

    Attributes:
        length: of each free run: [s], or `512 samples`; `auto` takes some periods of what recordings show, and windows
            in which that moves.
    """

    explained_by = (WindowSpec,)

    length: SpanEntry | Literal["auto"]
    every: SpanEntry | None = WindowSpec.every
    skip: SpanEntry = WindowSpec.skip
    most: int | None = Field(WindowSpec.most, ge=1)

    @model_validator(mode="after")
    def _positive(self) -> WindowsBlock:
        given = [span for span in (self.length, self.every) if span is not None and span != "auto"]
        if any(amount(span) <= 0 for span in given) or amount(self.skip) < 0:
            raise ValueError("`length` and `every` must be positive, `skip` not negative")
        return self

    def spec(self) -> WindowSpec | AutoWindows:
        if isinstance(self.length, str):
            return AutoWindows(self.every, self.skip, self.most)
        return WindowSpec(self.length, self.every, self.skip, self.most)


class ValidationBlock(WindowsBlock):
    """Windows of the traces kept out of the fit, and what they have to reach.

    Attributes:
        at_least: the median FIT.
        worst_at_least: FIT of every window and output that moves.
    """

    at_least: float | None = None
    worst_at_least: float | None = None


class ShootingBlock(Block):
    """Multiple shooting: windows begin the search in segments with start values of their own, which join as it goes on.

    Attributes:
        segments: of each window.
        length: of each segment at most [s], in the place of their number.
    """

    segments: int | None = Field(None, ge=2)
    length: Seconds | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> ShootingBlock:
        if (self.segments is None) == (self.length is None):
            raise ValueError("give `segments` or `length`")
        if self.length is not None and self.length <= 0:
            raise ValueError("`length` must be positive")
        return self


class PriorBlock(Block):
    """What is known of a parameter before the recordings: normal, log-normal or uniform, by the keys that are given.

    Attributes:
        mean, std: of a normal one, in the variable's unit, or with their own: `0.5 N.m`.
        median, factor: of a log-normal one: 68 % lie within that factor of the median either way.
        min, max: of a uniform one: anything between, nothing beyond.
        source: where it is from, for the report: a data sheet and its page.
    """

    mean: float | Quantity | None = None
    std: float | Quantity | None = None
    median: float | Quantity | None = None
    factor: float | None = None
    min: float | Quantity | None = None
    max: float | Quantity | None = None
    source: str = ""

    @model_validator(mode="after")
    def _one_kind(self) -> PriorBlock:
        given = {key for key in ("mean", "std", "median", "factor", "min", "max") if getattr(self, key) is not None}
        if given not in ({"mean", "std"}, {"median", "factor"}, {"min", "max"}):
            raise ValueError("give `mean` and `std`, `median` and `factor`, or `min` and `max`")
        return self

    def in_numbers(self, number: Callable[[float | str], float]) -> PriorBlock:
        """The same with what is written like `90 deg` as numbers."""
        given = {key: getattr(self, key) for key in ("mean", "median", "min", "max")}
        numbers: dict[str, float] = {key: number(value) for key, value in given.items() if value is not None}
        if self.std is not None:
            numbers["std"] = _difference(self.std, number)
        return self.model_copy(update=numbers)

    @property
    def written(self) -> list[str]:
        """What is given like `90 deg`."""
        given = [value for value in (self.mean, self.std, self.median, self.min, self.max) if isinstance(value, str)]
        return [*given, _nought(self.std)] if isinstance(self.std, str) else given

    def prior(self) -> Prior:
        """As a plain value, once all are numbers."""
        if self.mean is not None:
            return Normal(_number(self.mean), _number(self.std), self.source)
        if self.median is not None:
            return LogNormal(_number(self.median), _number(self.factor), self.source)
        return Uniform(_number(self.min), _number(self.max), self.source)


def _nought(text: str) -> str:
    """Nothing in the unit of a quantity, which a difference is counted from: 0 degC for 5 degC."""
    found = quantity(text)
    return text if found is None else f"0 {found[1]}"


def _difference(value: float | str, number: Callable[[float | str], float]) -> float:
    """A difference as a number."""
    return number(value) - (number(_nought(value)) if isinstance(value, str) else 0.0)


def _number(value: float | str | None) -> float:
    assert isinstance(value, (int, float))
    return float(value)


class AroundBlock(Block):
    """How far values of groups are expected from their common mean, which is estimated with them.

    Attributes:
        std: standard deviation, in the variable's unit or with its own.
    """

    std: float | Quantity


class ParameterBlock(Block):
    """A parameter to estimate (start, bounds, scale), or one tied to another by a factor.

    Attributes:
        start, min, max: in the variable's unit, or with their own: `90 deg`.
        tied: name of the parameter that this one is a multiple of.
        factor: how many times the parameter that it is tied to.
        prior: what is known of it before the recordings.
        by: `trace` for a value of its own in each recording, or name of a group -> recordings that have one.
        around: what is known of how these values are spread.
    """

    explained_by = (Parameter, Tie)

    start: float | Quantity | None = None
    min: float | Quantity | None = None
    max: float | Quantity | None = None
    scale: Scale = Parameter.scale
    fixed: bool = Parameter.fixed
    tied: str | None = None
    factor: float = Tie.factor
    prior: PriorBlock | None = None
    by: Literal["trace"] | Annotated[dict[GroupName, list[str]], Field(min_length=1)] | None = None
    around: AroundBlock | None = None

    @model_validator(mode="after")
    def _of_groups(self) -> ParameterBlock:
        if self.by is not None and (self.tied is not None or self.fixed):
            raise ValueError("`by` is of a free parameter; what is tied to one goes with it")
        if self.around is not None and self.by is None:
            raise ValueError("`around` is of values that `by` tells apart")
        return self

    @model_validator(mode="after")
    def _free_or_tied(self) -> ParameterBlock:
        if self.tied is not None and (self.start, self.min, self.max) != (None, None, None):
            raise ValueError("a tied parameter has no start and no bounds")
        if self.prior is not None and (self.tied is not None or self.fixed):
            raise ValueError("a prior is of a free parameter; remove it, or `fixed` and `tied`")
        return self

    def in_numbers(self, number: Callable[[float | str], float], start: Value | None) -> ParameterBlock:
        """The same that starts there, with what is written like `90 deg` as numbers."""
        ends = {"start": start, "min": self.min, "max": self.max}
        numbers: dict[str, Any] = {key: None if end is None else number(end) for key, end in ends.items()}
        around = self.around and self.around.model_copy(update={"std": _difference(self.around.std, number)})
        return self.model_copy(
            update=numbers | {"prior": self.prior and self.prior.in_numbers(number), "around": around}
        )

    @property
    def written(self) -> list[str]:
        """What is given like `90 deg` beside start and bounds."""
        spread = self.around.std if self.around else 0.0
        return [
            *(self.prior.written if self.prior else ()),
            *([spread, _nought(spread)] if isinstance(spread, str) else ()),
        ]

    def grouping(self) -> Grouping | None:
        """How it is told apart, once all are numbers; None where it has one value."""
        if self.by is None:
            return None
        around = _number(self.around.std) if self.around else None
        groups = None if self.by == "trace" else {name: tuple(traces) for name, traces in self.by.items()}
        return Grouping(groups, around)

    @property
    def spans(self) -> bool:
        """Whether it is told where it may lie."""
        known = self.start is not None and (self.fixed or (self.min is not None and self.max is not None))
        return known or self.tied is not None


class LossBlock(Block):
    """How much a sample counts that lies far off.

    Attributes:
        scale: from where on it lies far off, in standard deviations of the weighted output.
    """

    explained_by = (Loss,)

    kind: LossKind = Loss.kind
    scale: float = Field(Loss.scale, gt=0)


class OptionsBlock(Block):
    """How the estimation searches."""

    explained_by = (SearchOptions,)

    starts: int = Field(SearchOptions.starts, ge=1)
    seed: int = SearchOptions.seed
    max_evaluations: int = Field(SearchOptions.max_evaluations, ge=1)
    cost_tolerance: float = Field(SearchOptions.cost_tolerance, gt=0)
    step_tolerance: float = Field(SearchOptions.step_tolerance, gt=0)
    difference_step: float = Field(SearchOptions.difference_step, gt=0)


class UncertaintyBlock(Block):
    """How the 95 % intervals of the parameters come about; plainly `local` or `profile` where that is all.

    Attributes:
        seed: of the drawing of windows, which `by: bootstrap` needs.
    """

    explained_by = (IntervalOptions,)

    by: IntervalBy
    resamples: int = Field(IntervalOptions.resamples, ge=100)
    seed: int | None = Field(None, ge=0)
    kind: BootstrapKind = IntervalOptions.kind

    @model_validator(mode="after")
    def _of_one_way(self) -> UncertaintyBlock:
        given = sorted(self.model_fields_set - {"by"})
        if self.by == "bootstrap" and self.seed is None:
            raise ValueError("a bootstrap draws windows and needs a `seed`: {by: bootstrap, seed: 1}")
        if self.by != "bootstrap" and given:
            raise ValueError(f"`{given[0]}` is of `by: bootstrap`; remove it")
        return self

    def options(self) -> IntervalOptions:
        return IntervalOptions(self.by, self.resamples, self.seed or 0, self.kind)


class CandidateBlock(Block):
    """What a candidate changes of its study; an entry is taken whole, one that is null removed.

    Attributes:
        set: component.variable or delay -> value that is not estimated, over those of `components` and `parameters`.
        free: which parameters are estimated; all others stay where they start.
        components: name -> another model, or one more.
        connections: all of them, where they differ.
        inputs, outputs, initial: others, or with a delay; the recordings stay the same.
        parameters: others, or with other bounds or ties.
    """

    set: Values = {}
    free: list[str] | None = None
    components: dict[str, ComponentBlock | None] = {}
    connections: Connections | None = None
    inputs: dict[str, InputBlock | None] = {}
    outputs: dict[str, SignalBlock | None] = {}
    initial: dict[str, InitialBlock | None] = {}
    parameters: dict[str, ParameterBlock | None] = {}
