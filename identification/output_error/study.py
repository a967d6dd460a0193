"""What an output-error calibration is asked, as plain values: what drives and is compared, and where windows lie."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Literal

from identification.estimation.arrow_least_squares import LEAST_SQUARES, Loss
from identification.estimation.parameters import ParameterSet
from identification.output_error.delays import Delay, Estimated, Known
from identification.output_error.estimator import Options
from identification.recordings.campaign import TraceSource
from orchestrator.assembly.assembly import SystemSpec

OutputWeight = Literal["window", "output", "none"]


@dataclass(frozen=True)
class TraceSignal:
    """A signal of the traces, and how much later than the system it is (an output) or reaches it (an input).

    Attributes:
        factor: from the signal's unit to the variable's.
        delay: None takes the value at the beginning of each communication step; a command with a delay, 0 too, counts
            by its mean over each step.
    """

    signal: str
    factor: float = 1.0
    delay: Delay | None = None


@dataclass(frozen=True)
class StartSpec:
    """A start value read off a signal around the beginning of each window.

    A polynomial of `degree` is fitted to the samples within `half_width` [s]; its value or derivative there counts,
    times `factor`, which makes a start value of a reading in a converter's units.
    """

    signal: str
    factor: float = 1.0
    derivative: int = 0
    half_width: float = 0.018
    degree: int = 2
    estimated: bool = False


@dataclass(frozen=True)
class FreeRunSpec:
    """What a free run takes of a trace.

    Attributes:
        step: communication step [s].
        outputs: component.variable -> what it is compared with.
        inputs: component.variable -> what drives it.
        initial: component.variable -> what it starts from.
    """

    step: Fraction
    outputs: Mapping[str, TraceSignal]
    inputs: Mapping[str, TraceSignal] = field(default_factory=dict)
    initial: Mapping[str, StartSpec] = field(default_factory=dict)

    @property
    def signals(self) -> list[str]:
        """The signals that it takes, sorted."""
        specs = (*self.outputs.values(), *self.inputs.values())
        return sorted({spec.signal for spec in specs} | {spec.signal for spec in self.initial.values()})

    @property
    def estimated_delays(self) -> tuple[Estimated, ...]:
        """The delays that are parameters."""
        delays = (spec.delay for spec in (*self.inputs.values(), *self.outputs.values()))
        return tuple(delay for delay in delays if isinstance(delay, Estimated))

    def by_means(self) -> FreeRunSpec:
        """The same with all commands by their means over each step: frames never come at its beginning."""
        inputs = {name: replace(spec, delay=spec.delay or Known(0.0)) for name, spec in self.inputs.items()}
        return replace(self, inputs=inputs)


@dataclass(frozen=True)
class WindowSpec:
    """Free runs of `length` [s], `every` so often [s] (back to back by default), after `skip` [s], at most `most`."""

    length: Fraction
    every: Fraction | None = None
    skip: Fraction = Fraction(0)
    most: int | None = None


@dataclass(frozen=True)
class OutputErrorStudy:
    """Parameters of a system to be fitted to traces by the error of free runs.

    Attributes:
        validation: windows of the traces kept out of the fit.
        at_least: median FIT that these have to reach, where the study asks for one.
        parameters: what is estimated, component.variable or a delay; their units are the FMUs'.
        weight: whether outputs are scaled by their spread in each window, over all windows, or not at all.
        compare: name -> parameters that are judged beside the estimate on the same windows.
        truth: values behind synthetic traces, shown beside the estimates.
    """

    title: str
    system: SystemSpec
    traces: TraceSource
    run: FreeRunSpec
    windows: WindowSpec
    validation: WindowSpec
    parameters: ParameterSet
    at_least: float | None = None
    description: str = ""
    weight: OutputWeight = "output"
    loss: Loss = LEAST_SQUARES
    options: Options = field(default_factory=Options)
    compare: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    truth: Mapping[str, float] = field(default_factory=dict)

    @property
    def outputs(self) -> tuple[str, ...]:
        """component.variable of the outputs that are compared."""
        return tuple(self.run.outputs)

    @property
    def delays(self) -> frozenset[str]:
        """The parameters that are delays and not of a component: named by a signal, or what such a one is tied to."""
        named = {delay.parameter for delay in self.run.estimated_delays}
        return frozenset(named | {tie.other for tie in self.parameters.ties if tie.name in named})
