"""The study file of an output-error calibration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationError, model_validator
from pydantic_core import InitErrorDetails

from fmus.errors import IdentificationError, ScenarioError
from fmus.files import RawMap
from identification.estimation.arrow_least_squares import Loss
from identification.estimation.groups import MARK
from identification.estimation.listed import ESTIMATE, complete, listed
from identification.estimation.parameters import Parameter, ParameterSet, Tie
from identification.output_error.blocks import (
    CandidateBlock,
    DelayEntry,
    InitialBlock,
    InputBlock,
    LossBlock,
    OptionsBlock,
    ParameterBlock,
    ShootingBlock,
    SignalBlock,
    UncertaintyBlock,
    ValidationBlock,
    WindowsBlock,
)
from identification.output_error.choice.change import CANDIDATES, of_candidate
from identification.output_error.search.options import IntervalBy, SearchOptions
from identification.output_error.study import FreeRunSpec, OutputErrorStudy, OutputWeight, Shooting, TraceSignal
from identification.output_error.times.delays import Delay, Estimated, KnownDelay
from identification.quantities import SECONDS, numbers
from identification.recordings.campaign import TraceSource
from identification.recordings.schema import RecordedStudyBlock, UsedSignals
from orchestrator.assembly.assembly import SystemSpec
from orchestrator.assembly.schema import SystemBlock
from orchestrator.crossing import GivenConversion
from orchestrator.fmi.interface import Value
from orchestrator.yaml_file import Quantity, Seconds


def _long(value: Any) -> Any:
    """`auto` as the keys that it is short for."""
    return {"length": value} if isinstance(value, str) else value


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
        shooting: multiple shooting, for windows over which free runs leave the recordings.
        uncertainty: how the 95 % intervals come about: `local`, `profile`, or `{by: bootstrap, seed: 1}`.
        compare: name -> parameters that are judged beside the estimate on the same windows.
        truth: values behind synthetic traces, shown beside the estimates.
        estimate: lists of parameters (CSV with columns name, value, unit, min, max), below those of `parameters`.
        parameter_sets: files (SSV, as a calibration writes them, and lists) whose values are over those of components.
        candidates: name -> what a variant of the system changes; all are fitted, and the one that recordings speak for
            is written.
    """

    method: Literal["output-error"]
    step: Seconds
    nonfinite: Literal["refuse", "allow"] = "refuse"
    tolerance: float | None = Field(None, gt=0, lt=1)
    tell_stop: bool = False
    inputs: dict[str, InputBlock] = {}
    outputs: dict[str, SignalBlock] = Field(min_length=1)
    initial: dict[str, InitialBlock] = {}
    windows: Annotated[WindowsBlock, BeforeValidator(_long, json_schema_input_type=Literal["auto"] | WindowsBlock)]
    validation: ValidationBlock | None = None
    parameters: dict[str, ParameterBlock] = Field({}, min_length=1)
    estimate: Path | list[Path] = []
    parameter_sets: Path | list[Path] = []
    weight: OutputWeight = OutputErrorStudy.weight
    loss: LossBlock = LossBlock()
    options: OptionsBlock = OptionsBlock()
    shooting: ShootingBlock | None = None
    uncertainty: Annotated[
        UncertaintyBlock, BeforeValidator(_by, json_schema_input_type=IntervalBy | UncertaintyBlock)
    ] = UncertaintyBlock(by="local")
    compare: dict[str, dict[str, float | Quantity]] = {}
    truth: dict[str, float | Quantity] = {}
    candidates: dict[str, CandidateBlock] = {}

    @model_validator(mode="after")
    def _consistent(self) -> OutputErrorBlock:
        if self.step <= 0:
            raise ValueError("`step` must be positive")
        for name in self.traces.values:
            if name in self.parameters or name in self.initial:
                raise ValueError(f"{name} is given by `traces.values` and by another key; remove one")
        return self

    @model_validator(mode="after")
    def _one_start_of_segments(self) -> OutputErrorBlock:
        if self.shooting is not None and self.options.starts > 1:
            raise ValueError("`shooting` goes from the declared start alone; remove `options.starts`, or `shooting`")
        return self

    @model_validator(mode="after")
    def _something_to_find(self) -> OutputErrorBlock:
        if not self.parameters and not self.estimate:
            raise ValueError("nothing is estimated; give `parameters`, or a list of them under `estimate`")
        return self

    @model_validator(mode="after")
    def _known_delays(self) -> OutputErrorBlock:
        for name, signal in {**self.inputs, **self.outputs}.items():
            if isinstance(signal.delay, str) and signal.delay not in self.delays and not self.estimate:
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

    @model_validator(mode="after")
    def _a_choice(self) -> OutputErrorBlock:
        """Each candidate is a study, and no two are the same one; with a list that is seen once that is read."""
        made: dict[str, OutputErrorBlock] = {}
        for name in () if self.estimate else self.candidates:
            made[name] = self.candidate(name)
            for other in list(made)[:-1]:
                if made[other].model_dump() == made[name].model_dump():
                    raise self._refused(name, f"is the same as {other}; remove one, or say where they differ")
        if len(made) == 1:
            raise self._refused(
                next(iter(made)), "is no choice alone; give another candidate (`{}` is the study as it is)"
            )
        measured = {name: {block.signal for block in one.outputs.values()} for name, one in made.items()}
        if made and not set.intersection(*measured.values()):
            told = "; ".join(f"{name}: {', '.join(sorted(signals))}" for name, signals in measured.items())
            raise self._refused(
                next(iter(made)), f"shares no output with all others ({told}); compare one signal in all"
            )
        return self

    @property
    def document(self) -> RawMap:
        """What the file says."""
        return self.model_dump(by_alias=True, exclude_unset=True)

    def complete(self, base: Path) -> OutputErrorBlock:
        """The study with what is in its lists and parameter sets, which are relative to `base`.

        Raises:
            ScenarioError: a list is none, or it is no study with that.
            FmuFileError: a parameter set is none.
        """
        if not (self.estimate or self.parameter_sets):
            return self
        try:
            made = type(self).model_validate(complete(self.document, base))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place, said = ".".join(map(str, first["loc"])), first["msg"].removeprefix("Value error, ")
            name, _, problem = said.partition(": ") if not place and ": " in said else (place or ESTIMATE, "", said)
            raise ScenarioError(name, problem, "correct the list or the study") from None
        for row in listed(self.document, base).values():
            if "." not in row.name and row.name not in made.delays:
                fix = "write component.variable, or name it as the `delay` of a signal"
                raise ScenarioError(f"{row.place}: {row.name}", "does not name a variable", fix)
        return made

    def candidate(self, name: str) -> OutputErrorBlock:
        """The study that a candidate is.

        Raises:
            ValidationError: what it changes is not there, or it is no study then.
        """
        try:
            return type(self).model_validate(of_candidate(self.document, name))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = "".join(f"{key}: " for key in [".".join(map(str, first["loc"]))] if key)
            raise self._refused(name, f"{place}{first['msg'].removeprefix('Value error, ')}") from None
        except ValueError as error:
            raise self._refused(name, str(error)) from None

    def _refused(self, name: str, problem: str) -> ValidationError:
        """The complaint about a candidate, at its place in the file."""
        details = InitErrorDetails(
            type="value_error", loc=(CANDIDATES, name), input=name, ctx={"error": ValueError(problem)}
        )
        return ValidationError.from_exception_data(type(self).__name__, [details])

    @property
    def signals(self) -> UsedSignals:
        """What it uses of the traces."""
        lines = {block.signal for block in self.inputs.values() if block.interpolation == "linear"}
        held = {block.signal for block in self.inputs.values() if block.interpolation != "linear"}
        measured = {block.signal for blocks in (self.outputs, self.initial) for block in blocks.values()}
        return UsedSignals(frozenset(held), frozenset(measured | lines))

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
            return known[self._variable(name), value] if isinstance(value, str) else value

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
            given += [(name, value) for value in block.written]
        return [(self._variable(name), value) for name, value in given if isinstance(value, str)]

    def _variable(self, name: str) -> str:
        """What the name of a group's value is of, or the name itself."""
        variable = name.partition(MARK)[0]
        known = self.parameters.get(variable)
        return variable if known is not None and known.by is not None else name

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
                {name: self._input_spec(name, block) for name, block in self.inputs.items()},
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
            options=SearchOptions(**dict(self.options), intervals=self.uncertainty.options()),
            shooting=Shooting(**dict(self.shooting)) if self.shooting else None,
            by={name: how for name, block in self.parameters.items() if (how := block.grouping()) is not None},
        )

    def _signal_specs(self, blocks: Mapping[str, SignalBlock]) -> dict[str, TraceSignal]:
        return {
            name: TraceSignal(block.signal, GivenConversion(block.factor, block.offset), self._delay(block.delay))
            for name, block in blocks.items()
        }

    def _input_spec(self, name: str, block: InputBlock) -> TraceSignal:
        spec = self._signal_specs({name: block})[name]
        if block.interpolation is None:
            return spec
        return replace(spec, delay=spec.delay or KnownDelay(0.0), linear=block.interpolation == "linear")

    def _delay(self, entry: DelayEntry | None) -> Delay | None:
        """A delay with its parameter's bounds; its start where a bound is missing."""
        if not isinstance(entry, str):
            return None if entry is None else KnownDelay(entry)
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
