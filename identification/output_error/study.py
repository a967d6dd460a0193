"""What an output-error calibration is asked, as plain values: what drives and is compared, and where windows lie."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Literal, TypeVar

from fmus.errors import IdentificationError, WiringError
from fmus.units import SAME, Conversion
from identification.estimation.arrow_least_squares import LEAST_SQUARES, Loss
from identification.estimation.groups import Grouped, Grouping, parted
from identification.estimation.parameters import ParameterSet
from identification.output_error.search.options import SearchOptions
from identification.output_error.times.delays import Delay, Estimated, KnownDelay
from identification.output_error.times.spans import Samples, Span, lasting, on_raster
from identification.recordings.campaign import TraceSource
from orchestrator.assembly.assembly import SystemSpec
from orchestrator.crossing import NOTHING_GIVEN, Crossing, GivenConversion, crossing
from orchestrator.engine import Timing
from orchestrator.fmi.interface import Port
from orchestrator.trace import Trace

OutputWeight = Literal["window", "output", "none"]


@dataclass(frozen=True)
class TraceSignal:
    """A signal of the traces, and how much later than the system it is (an output) or reaches it (an input).

    Attributes:
        signal: name of the signal in the recordings.
        given: what it is converted to the variable's unit by, over its own.
        delay: None takes the value at the beginning of each communication step; a command with a delay, 0 too, counts
            by its mean over each step.
        linear: whether a command goes in lines from sample to sample, and does not hold each until the next.
        conversion: what it is converted by, once the trace is known.
        stepwise: whether the variable changes in steps, so that each sample holds until the next.
    """

    signal: str
    given: GivenConversion = NOTHING_GIVEN
    delay: Delay | None = None
    linear: bool = False
    conversion: Conversion = SAME
    stepwise: bool = False


HALF_WIDTH = 0.018  # [s]


@dataclass(frozen=True)
class StartSpec:
    """A start value read off a signal around the beginning of each window.

    A polynomial of `degree` is fitted to the samples within `half_width`; its value or derivative there counts, in
    the variable's unit.

    Attributes:
        signal: name of the signal in the recordings.
        derivative: which derivative of the polynomial counts; 0 is its value.
        half_width: to either side of the window's beginning, how far samples count: [s], or `3 samples` of the
            recording.
        degree: of the polynomial.
        estimated: whether the reading is only where an estimation of the start value begins, one a window.
        given: what it is converted to the variable's unit by, over the signal's.
        conversion: what it is converted by, once the trace is known.
    """

    signal: str
    given: GivenConversion = NOTHING_GIVEN
    derivative: int = 0
    half_width: float | Samples = HALF_WIDTH
    degree: int = 2
    estimated: bool = False
    conversion: Conversion = SAME


NOWHERE = Port("", 0, "Real", "local")  # in no unit
Spec = TypeVar("Spec", TraceSignal, StartSpec)


@dataclass(frozen=True)
class FreeRunSpec:
    """What a free run takes of a trace.

    Attributes:
        step: communication step [s].
        outputs: component.variable -> what it is compared with.
        inputs: component.variable -> what drives it.
        initial: component.variable -> what it starts from.
        finite: whether an output that is not finite fails a run, also where it is not compared.
        tolerance: relative tolerance that co-simulation FMUs are told, None for none.
        tell_stop: whether FMUs are told when a window ends.
        beside: runs of the same recordings that it is compared with: windows and instants are those that suit all.
    """

    step: Fraction
    outputs: Mapping[str, TraceSignal]
    inputs: Mapping[str, TraceSignal] = field(default_factory=dict)
    initial: Mapping[str, StartSpec] = field(default_factory=dict)
    finite: bool = True
    tolerance: float | None = None
    tell_stop: bool = False
    beside: tuple[FreeRunSpec, ...] = ()

    def timing(self, stop: Fraction) -> Timing:
        """How free runs step until a time [s]."""
        return Timing(stop, self.step, tolerance=self.tolerance, tell_stop=self.tell_stop, finite=self.finite)

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

    def in_units_of(self, ports: Mapping[str, Port], trace: Trace) -> tuple[FreeRunSpec, tuple[Crossing, ...]]:
        """The same for one trace, its signals converted to the units of the variables; and how they get there.

        Raises:
            WiringError: units of different quantities, or lines to an input that changes in steps.
        """
        crossed: list[Crossing] = []

        def converted(key: str, specs: Mapping[str, Spec]) -> dict[str, Spec]:
            return {name: one(f"{key}.{name} from {spec.signal}", name, spec) for name, spec in specs.items()}

        def one(place: str, name: str, spec: Spec) -> Spec:
            port = ports.get(name, NOWHERE)
            unit = port.meaning(trace.unit(spec.signal)).rate(getattr(spec, "derivative", 0))
            crossed.append(crossing(place, unit, port.measure, spec.given))
            return replace(spec, conversion=crossed[-1].conversion)

        outputs, inputs = converted("outputs", self.outputs), converted("inputs", self.inputs)
        outputs = {name: replace(spec, stepwise=not ports.get(name, NOWHERE).real) for name, spec in outputs.items()}
        inputs = {name: replace(spec, stepwise=ports.get(name, NOWHERE).stepwise) for name, spec in inputs.items()}
        for name, driven in inputs.items():
            if driven.linear and driven.stepwise:
                problem = "changes in steps, and has no values along a line"
                raise WiringError(f"inputs.{name}.interpolation", problem, "write `interpolation: hold`")
        spec = replace(self, outputs=outputs, inputs=inputs, initial=converted("initial", self.initial))
        return spec, tuple(crossed)

    def sampled(self, between: float) -> FreeRunSpec:
        """The same for a trace whose samples are so far apart [s], its half widths in seconds."""
        initial = {
            name: replace(spec, half_width=lasting(spec.half_width, between)) for name, spec in self.initial.items()
        }
        return replace(self, initial=initial, beside=tuple(one.sampled(between) for one in self.beside))

    def by_means(self) -> FreeRunSpec:
        """The same with all commands by their means over each step: frames never come at its beginning."""
        inputs = {name: replace(spec, delay=spec.delay or KnownDelay(0.0)) for name, spec in self.inputs.items()}
        return replace(self, inputs=inputs)

    @property
    def concerned(self) -> list[str]:
        """The signals that it takes, and those beside it, sorted."""
        return sorted({signal for run in (self, *self.beside) for signal in run.signals})

    @property
    def compared(self) -> list[str]:
        """The signals that its outputs, and those beside it, are compared with, sorted."""
        return sorted({spec.signal for run in (self, *self.beside) for spec in run.outputs.values()})

    @property
    def late(self) -> list[Delay | None]:
        """The delays of its outputs and of those beside it."""
        return [spec.delay for run in (self, *self.beside) for spec in run.outputs.values()]


@dataclass(frozen=True)
class WindowSpec:
    """Where free runs lie in a trace; lengths in samples are those of the trace, rounded to steps.

    Attributes:
        length: of each free run: [s], or `512 samples`.
        every: from the beginning of one to that of the next, likewise; back to back without.
        skip: what is left out at the beginning of a trace, likewise.
        most: at most so many of a trace; all that fit without.
    """

    length: Span
    every: Span | None = None
    skip: Span = Fraction(0)
    most: int | None = None

    def sampled(self, between: float, step: Fraction) -> Placing:
        """The same for a trace whose samples are so far apart [s], on the raster of a communication step [s]."""
        length = on_raster(self.length, between, step)
        every = length if self.every is None else on_raster(self.every, between, step)
        return Placing(length, every, on_raster(self.skip, between, step), self.most)


@dataclass(frozen=True)
class Placing:
    """Where free runs lie in one trace; the attributes are those of `WindowSpec`, all in seconds."""

    length: Fraction
    every: Fraction
    skip: Fraction
    most: int | None


@dataclass(frozen=True)
class AutoWindows:
    """Windows that recordings choose: so long that something happens in them, and where it does.

    Attributes:
        every, skip: as of `WindowSpec`.
        most: those of a trace in which most happens.
    """

    every: Span | None = None
    skip: Span = Fraction(0)
    most: int | None = None

    def of(self, length: Fraction) -> WindowSpec:
        """All of this length [s]."""
        return WindowSpec(length, self.every, self.skip)


@dataclass(frozen=True)
class Shooting:
    """Into how many segments each window is cut: so many, or as many as are at most so long [s]."""

    segments: int | None = None
    length: Fraction | None = None

    @property
    def key(self) -> str:
        """The key that says so."""
        return "shooting.length" if self.segments is None else "shooting.segments"

    def count(self, window: Fraction) -> int:
        """Segments of a window of that length [s]."""
        if self.segments is not None:
            return self.segments
        assert self.length is not None
        return int(-(-window // self.length))


@dataclass(frozen=True)
class OutputErrorStudy:
    """Parameters of a system to be fitted to traces by the error of free runs.

    Attributes:
        validation: windows of the traces kept out of the fit.
        at_least: median FIT that these have to reach, where the study asks for one.
        worst_at_least: FIT that every window and output of these has to reach.
        parameters: what is estimated, component.variable or a delay; their units are the FMUs'.
        weight: whether outputs are scaled by their spread in each window, over all windows, or not at all.
        compare: name -> parameters that are judged beside the estimate on the same windows.
        truth: values behind synthetic traces, shown beside the estimates.
        given: component.variable or delay -> where a list or parameter set has it, and in which unit.
        by: parameter -> how it is told apart by recordings, where it has not one value for all.
        grouped: the same once the recordings are known; `parameters` has one for each group then.
        shooting: how the windows are cut where the search begins with segments of them.
    """

    title: str
    system: SystemSpec
    traces: TraceSource
    run: FreeRunSpec
    windows: WindowSpec | AutoWindows
    validation: WindowSpec | AutoWindows
    parameters: ParameterSet
    at_least: float | None = None
    worst_at_least: float | None = None
    description: str = ""
    weight: OutputWeight = "output"
    loss: Loss = LEAST_SQUARES
    options: SearchOptions = field(default_factory=SearchOptions)
    compare: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    truth: Mapping[str, float] = field(default_factory=dict)
    given: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    by: Mapping[str, Grouping] = field(default_factory=dict)
    grouped: tuple[Grouped, ...] = ()
    shooting: Shooting | None = None

    @property
    def said_windows(self) -> WindowSpec:
        """The windows, of a study that has to say how long they are.

        Raises:
            IdentificationError: recordings choose that.
        """
        if isinstance(self.windows, AutoWindows):
            raise IdentificationError("windows.length", "is chosen by recordings, and there are none", "give it [s]")
        return self.windows

    @property
    def outputs(self) -> tuple[str, ...]:
        """component.variable of the outputs that are compared."""
        return tuple(self.run.outputs)

    @property
    def delays(self) -> frozenset[str]:
        """The parameters that are delays and not of a component: named by a signal, or what such a one is tied to."""
        named = {delay.parameter for delay in self.run.estimated_delays}
        tied = {tie.other for tie in self.parameters.ties if self.variable(tie.name) in named}
        members = {name for name in self.parameters.names if self.variable(name) in named}
        return frozenset(named | tied | members)

    def variable(self, name: str) -> str:
        """What a parameter is of: itself, or the one that it is the value of in a group."""
        return next((one.variable for one in self.grouped if name in one.members.values()), name)

    def spread(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values with those of a parameter that is told apart given to each of its groups."""
        members = {one.variable: one.members.values() for one in self.grouped}
        return {own: value for name, value in values.items() for own in members.get(name, (name,))}

    def of_groups(self, fitted: Sequence[str], kept: Sequence[str]) -> OutputErrorStudy:
        """The study once the names of the recordings that are fitted, and of those that are not, are known.

        Raises:
            ScenarioError: groups are not those of the recordings.
        """
        if not self.by:
            return self
        wholes = {part.name: part.trace for part in self.traces.parts}
        parameters, grouped = parted(self.parameters, self.by, fitted, {name: wholes.get(name, name) for name in kept})
        return replace(self, parameters=parameters, grouped=grouped)
