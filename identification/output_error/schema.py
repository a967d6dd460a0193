"""The study file of an output-error calibration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from fmus.errors import IdentificationError
from identification.estimation.arrow_least_squares import Loss, LossKind
from identification.estimation.parameters import Parameter, ParameterSet, Scale, Tie
from identification.estimation.prior import LogNormal, Normal, Prior, Uniform
from identification.output_error.delays import Delay, Estimated, Known
from identification.output_error.search.options import BootstrapKind, IntervalBy, IntervalOptions, Options
from identification.output_error.study import (
    FreeRunSpec,
    OutputErrorStudy,
    OutputWeight,
    StartSpec,
    TraceSignal,
    WindowSpec,
)
from identification.quantities import SECONDS, numbers
from identification.recordings.campaign import TraceSource
from identification.recordings.schema import RecordedStudyBlock, UsedSignals
from orchestrator.assembly.assembly import SystemSpec
from orchestrator.assembly.schema import SystemBlock
from orchestrator.crossing import Given, quantity
from orchestrator.fmi.interface import Value
from orchestrator.yaml_file import Block, Quantity, Seconds, exact


def _number_or_name(value: Any) -> Any:
    number = isinstance(value, str) and value[:1] in "+-.0123456789"
    return float(exact(value)) if number else value


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
    half_width: float = Field(StartSpec.half_width, gt=0)
    degree: int = Field(StartSpec.degree, ge=0, le=6)
    estimated: bool = StartSpec.estimated

    def spec(self) -> StartSpec:
        given = Given(self.factor, self.offset)
        return StartSpec(self.signal, given, self.derivative, self.half_width, self.degree, self.estimated)

    @model_validator(mode="after")
    def _differentiable(self) -> InitialBlock:
        if self.derivative > self.degree:
            raise ValueError(f"a polynomial of degree {self.degree} has no derivative {self.derivative} but 0")
        return self


class WindowsBlock(Block):
    """Where free runs lie in a recording."""

    explained_by = (WindowSpec,)

    length: Seconds
    every: Seconds | None = WindowSpec.every
    skip: Seconds = WindowSpec.skip
    most: int | None = Field(WindowSpec.most, ge=1)

    @model_validator(mode="after")
    def _positive(self) -> WindowsBlock:
        if self.length <= 0 or (self.every is not None and self.every <= 0) or self.skip < 0:
            raise ValueError("`length` and `every` must be positive, `skip` not negative")
        return self

    def spec(self) -> WindowSpec:
        return WindowSpec(self.length, self.every, self.skip, self.most)


class ValidationBlock(WindowsBlock):
    """Windows of the traces kept out of the fit, and what they have to reach.

    Attributes:
        at_least: the median FIT.
        worst_at_least: FIT of every window and output that moves.
    """

    at_least: float | None = None
    worst_at_least: float | None = None


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
            numbers["std"] = number(self.std) - (number(_nought(self.std)) if isinstance(self.std, str) else 0.0)
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


def _number(value: float | str | None) -> float:
    assert isinstance(value, (int, float))
    return float(value)


class ParameterBlock(Block):
    """A parameter to estimate (start, bounds, scale), or one tied to another by a factor.

    Attributes:
        start, min, max: in the variable's unit, or with their own: `90 deg`.
        tied: name of the parameter that this one is a multiple of.
        factor: how many times the parameter that it is tied to.
        prior: what is known of it before the recordings.
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
        return self.model_copy(update=numbers | {"prior": self.prior and self.prior.in_numbers(number)})

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

    explained_by = (Options,)

    starts: int = Field(Options.starts, ge=1)
    seed: int = Options.seed
    max_evaluations: int = Field(Options.max_evaluations, ge=1)
    cost_tolerance: float = Field(Options.cost_tolerance, gt=0)
    step_tolerance: float = Field(Options.step_tolerance, gt=0)
    difference_step: float = Field(Options.difference_step, gt=0)


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


def _by(value: Any) -> Any:
    """`profile` as the keys that it is short for."""
    return {"by": value} if isinstance(value, str) else value


class OutputErrorBlock(RecordedStudyBlock, SystemBlock):
    """A study that fits parameters of a system to traces by the error of free runs.

    Attributes:
        step: communication step of the free runs [s].
        nonfinite: whether an output that is NaN or infinite fails a free run also where it is not compared.
        tolerance: relative tolerance that co-simulation FMUs are told.
        tell_stop: whether FMUs are told when a window ends; some then refuse to go beyond by a rounding error.
        weight: whether outputs are scaled by their spread in each window, over all windows, or not at all.
        uncertainty: how the 95 % intervals come about: `local`, `profile`, or `{by: bootstrap, seed: 1}`.
        compare: name -> parameters that are judged beside the estimate on the same windows.
        truth: values behind synthetic traces, shown beside the estimates.
    """

    method: Literal["output-error"]
    step: Seconds
    nonfinite: Literal["refuse", "allow"] = "refuse"
    tolerance: float | None = Field(None, gt=0, lt=1)
    tell_stop: bool = False
    inputs: dict[str, SignalBlock] = {}
    outputs: dict[str, SignalBlock] = Field(min_length=1)
    initial: dict[str, InitialBlock] = {}
    windows: WindowsBlock
    validation: ValidationBlock | None = None
    parameters: dict[str, ParameterBlock] = Field(min_length=1)
    weight: OutputWeight = OutputErrorStudy.weight
    loss: LossBlock = LossBlock()
    options: OptionsBlock = OptionsBlock()
    uncertainty: Annotated[
        UncertaintyBlock, BeforeValidator(_by, json_schema_input_type=IntervalBy | UncertaintyBlock)
    ] = UncertaintyBlock(by="local")
    compare: dict[str, dict[str, float | Quantity]] = {}
    truth: dict[str, float | Quantity] = {}

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
        read: dict[str, DelayEntry | None] = {}
        for block in self.outputs.values():
            if read.setdefault(block.signal, block.delay) != block.delay:
                raise ValueError(f"signal {block.signal} has two delays")
        return self

    @model_validator(mode="after")
    def _compared_within_bounds(self) -> OutputErrorBlock:
        for name, values in self.compare.items():
            for delay in set(values) & set(self.delays):
                block = self.parameters[delay]
                value, low, high = (
                    SECONDS.quantity(f"{name}.{delay}", one) if isinstance(one, str) else one
                    for one in (values[delay], block.min, block.max)
                )
                assert value is not None
                if (low is not None and value < low) or (high is not None and value > high):
                    raise ValueError(f"compare.{name}: {delay} is not within its bounds")
        return self

    @property
    def signals(self) -> UsedSignals:
        """What it uses of the traces."""
        measured = {block.signal for blocks in (self.outputs, self.initial) for block in blocks.values()}
        return UsedSignals(frozenset(block.signal for block in self.inputs.values()), frozenset(measured))

    @property
    def delays(self) -> list[str]:
        """The parameters that are delays and not of a component: named by a signal, or what such a one is tied to."""
        named = {block.delay for block in (*self.inputs.values(), *self.outputs.values())}
        tied = {block.tied for name, block in self.parameters.items() if name in named}
        return [name for name in self.parameters if "." not in name and name in named | tied]

    def study(self, system: SystemSpec, traces: TraceSource) -> OutputErrorStudy:
        """The study as plain values.

        Args:
            system: its components, of the file's models or of calibrated FMUs.
            traces: where its traces come from.

        Raises:
            IdentificationError: a parameter has no start value, or one outside its bounds.
        """
        known = numbers(system, self.inputs, self._written())

        def number(name: str, value: float | str) -> float:
            return known[name, value] if isinstance(value, str) else value

        compare = {key: {name: number(name, value) for name, value in at.items()} for key, at in self.compare.items()}
        truth = {name: number(name, value) for name, value in self.truth.items()}
        blocks = {
            name: block.in_numbers(partial(number, name), self._start(name, block))
            for name, block in self.parameters.items()
        }
        return replace(
            self.model_copy(update={"parameters": blocks})._study(system, traces), compare=compare, truth=truth
        )

    def _written(self) -> list[tuple[str, str]]:
        """Names with what is given of them like `90 deg`."""
        given = [pair for values in (self.truth, *self.compare.values()) for pair in values.items()]
        for name, block in self.parameters.items():
            ends = (self._start(name, block), block.min, block.max)
            given += [(name, value) for value in ends if value is not None]
            given += [(name, value) for value in (block.prior.written if block.prior else ())]
        return [(name, value) for name, value in given if isinstance(value, str)]

    def _start(self, name: str, block: ParameterBlock) -> Value | None:
        """Where a parameter starts: its own start, or the value in its component."""
        return block.start if block.start is not None or block.tied is not None else self.values().get(name)

    def _study(self, system: SystemSpec, traces: TraceSource) -> OutputErrorStudy:
        initial = {name: block.spec() for name, block in self.initial.items()}
        return OutputErrorStudy(
            title=self.title,
            system=system,
            traces=traces,
            run=FreeRunSpec(
                self.step,
                self._signal_specs(self.outputs),
                self._signal_specs(self.inputs),
                initial,
                self.nonfinite == "refuse",
                self.tolerance,
                self.tell_stop,
            ),
            windows=self.windows.spec(),
            validation=(self.validation or self.windows).spec(),
            parameters=self._parameter_set(),
            at_least=self.validation.at_least if self.validation else None,
            worst_at_least=self.validation.worst_at_least if self.validation else None,
            description=self.description,
            weight=self.weight,
            loss=Loss(self.loss.kind, self.loss.scale),
            options=Options(**dict(self.options), intervals=self.uncertainty.options()),
        )

    def _signal_specs(self, blocks: Mapping[str, SignalBlock]) -> dict[str, TraceSignal]:
        return {
            name: TraceSignal(block.signal, Given(block.factor, block.offset), self._delay(block.delay))
            for name, block in blocks.items()
        }

    def _delay(self, entry: DelayEntry | None) -> Delay | None:
        """A delay with its parameter's bounds; its start where a bound is missing."""
        if not isinstance(entry, str):
            return None if entry is None else Known(entry)
        block = self.parameters[entry]
        if block.tied is not None:
            other = self._delay(block.tied)
            assert isinstance(other, Estimated)
            lowest, highest = sorted((block.factor * other.lowest, block.factor * other.highest))
            return Estimated(entry, block.factor * other.start, lowest, highest)
        assert block.start is not None
        start = float(block.start)
        lowest, highest = (start if bound is None else float(bound) for bound in (block.min, block.max))
        return Estimated(entry, start, lowest, highest)

    def _parameter_set(self) -> ParameterSet:
        free = [self._parameter(name, block) for name, block in self.parameters.items() if block.tied is None]
        ties = [
            Tie(name, block.tied, block.factor) for name, block in self.parameters.items() if block.tied is not None
        ]
        return ParameterSet(tuple(free), tuple(ties))

    def _parameter(self, name: str, block: ParameterBlock) -> Parameter:
        start = self._start(name, block)
        if not isinstance(start, (int, float)) or isinstance(start, bool):
            raise IdentificationError(
                f"parameters.{name}", "has no start value", "give `start`, or set it in its component"
            )
        if not (start or block.fixed) and (block.min is None or block.max is None):
            raise IdentificationError(
                f"parameters.{name}",
                "starts at 0 with an open bound, so its size is not known",
                "give `min` and `max`, or another start",
            )
        low = Parameter.lower if block.min is None else float(block.min)
        high = Parameter.upper if block.max is None else float(block.max)
        prior = block.prior.prior() if block.prior else None
        return Parameter(name, float(start), low, high, scale=block.scale, fixed=block.fixed, prior=prior)
