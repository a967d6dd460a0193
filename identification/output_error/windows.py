"""Windows cut out of traces: what drives each free run, where it starts, and what it is compared with."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np
from numpy.polynomial import Polynomial

from fmus.errors import ScenarioError, TraceError, WiringError
from fmus.words import listed
from identification.estimation.parameters import InitialState
from identification.output_error.free_runs.window import FreeRunWindow
from identification.output_error.search.problem import spread_weights
from identification.output_error.study import (
    FreeRunSpec,
    OutputErrorStudy,
    Placing,
    StartSpec,
    TraceSignal,
    WindowSpec,
)
from identification.output_error.times.delays import (
    Command,
    Delay,
    Estimated,
    HeldCommand,
    KnownDelay,
    LinearCommand,
    StartReading,
    known,
)
from identification.output_error.times.instants import at_own_samples, every_step, own_samples, read_at_steps, sampled
from identification.output_error.times.spans import Samples, lasting, on_raster, rounded, stated
from identification.recordings.campaign import StudyTrace
from identification.recordings.marks import nothing_left, require_known, sound
from identification.signals.resolution import resolution
from orchestrator.fmi.interface import Port, Value
from orchestrator.marks import Mark, union
from orchestrator.rational import multiples
from orchestrator.trace import FloatArray, Trace, usable

ROUNDING = 1e-9  # [s]; a window that reaches so little beyond the first or last stamp still fits


def cut_windows(
    run: FreeRunSpec, traces: Iterable[StudyTrace], windows: WindowSpec, ports: Mapping[str, Port] | None = None
) -> list[FreeRunWindow]:
    """The windows of these traces, all outputs of weight 1; none lies where a trace is marked.

    Args:
        ports: component.variable -> what a signal goes to or is compared with, in whose unit it is then.

    Raises:
        TraceError: a signal is missing, constant or not finite, a trace is too short for a window, or marks leave none.
        WiringError: the units of a signal and its variable are of different quantities.
        ScenarioError: delays leave nothing of a window to compare.
    """
    if not isinstance(windows.length, Samples):
        _check_rows(run, windows.length)
    cut, marked = list[FreeRunWindow](), list[StudyTrace]()
    for recorded in traces:
        named = replace(recorded.trace, name=recorded.place).select(run.signals)
        marks = [mark for mark in recorded.marks if mark.concerns(run.concerned)]
        left = named.rows(sound(named, marks)) if marks else named
        if marks and len(left) < 2:
            marked.append(recorded)
            continue
        require_known(recorded.excluded_as, [left], run.signals)
        _usable(run, left)
        trace = replace(named, name=recorded.trace.name)
        placing = windows.sampled(trace.interval, run.step)
        if isinstance(windows.length, Samples):
            _check_rows(run, placing.length)
        own = (run.by_means() if recorded.held else run).sampled(trace.interval)
        try:
            own, crossed = own.in_units_of(ports or {}, trace)
            constants = {name: _typed(name, value, (ports or {}).get(name)) for name, value in recorded.values.items()}
        except WiringError as error:
            raise WiringError(f"{error.place} of {recorded.place}", error.problem, error.fix) from error
        starts = _starts(own, trace, placing, _barred(own, marks, placing.length))
        marked += [] if starts else [recorded]
        own_stamps = at_own_samples(recorded, run.step)
        counts = np.array([resolution(trace[s.signal]) * abs(s.conversion.factor) for s in own.outputs.values()])
        cut += [
            replace(
                _window(own, trace, start, placing.length, constants, own_stamps), crossings=crossed, resolution=counts
            )
            for start in starts
        ]
    if marked and not cut:
        raise nothing_left(marked[0].place, f"no window of {stated(windows.length)} is", marked[0].marks)
    return cut


def read_starts(
    run: FreeRunSpec, recorded: StudyTrace, instants: Iterable[float], ports: Mapping[str, Port]
) -> Iterator[dict[str, float]]:
    """component.variable -> start value read off a recording at each of these instants [s]."""
    trace = recorded.trace
    own, _ = run.sampled(trace.interval).in_units_of(ports, trace)
    for instant in instants:
        read = {name: _reading(own, trace, instant, spec) for name, spec in own.initial.items()}
        yield {name: reading.value(reading.delay.start) for name, reading in read.items()}


def length_warnings(step: Fraction, windows: WindowSpec, traces: Sequence[Trace], place: str) -> list[str]:
    """A sentence about each length in samples that steps [s] do not make up.

    Args:
        place: the study's key of the windows.
    """
    said = []
    for key, span in {"length": windows.length, "every": windows.every, "skip": windows.skip}.items():
        odd = [trace for trace in traces if span is not None and rounded(span, trace.interval, step)]
        if span is not None and odd:
            between = odd[0].interval
            steps, names = float(on_raster(span, between, step)), listed([trace.name for trace in odd], 1)
            said.append(
                f"{place}.{key}: {stated(span)} of {names} last {lasting(span, between):.6g} s, "
                f"which whole steps make {steps:g} s"
            )
    return said


def _usable(run: FreeRunSpec, trace: Trace) -> None:
    """See that outputs move; inputs may rest where a run begins as it was recorded, as a body that is let go does."""
    driving = {spec.signal for spec in run.inputs.values()} - set(run.compared)
    moving = [name for name in run.signals if name not in driving]
    usable(trace, moving)
    let_go = ", or, where it is let go, say in `initial` what it begins with"
    usable(trace, sorted(driving), driving if run.initial else (), let_go)


def _typed(name: str, value: Value, port: Port | None) -> Value:
    """What is known of a trace, in the type and unit of the variable."""
    return value if port is None else port.typed(f"traces.values.{name}", value)


def _barred(run: FreeRunSpec, marks: Sequence[Mark], length: Fraction) -> FloatArray:
    """(n, 2) between which instants no window may begin, so that it meets no mark: ascending, apart [s]."""
    stretches = [
        (mark.start + first - float(length) + ROUNDING, mark.stop + last - ROUNDING)
        for mark in marks
        for one in (run, *run.beside)
        for signal, first, last in _reach(one)
        if mark.concerns([signal])
    ]
    return union(np.array(stretches, np.float64).reshape(-1, 2))


def _reach(run: FreeRunSpec) -> Iterator[tuple[str, float, float]]:
    """Each signal, and by how much a mark of it lies later in a free run, at its beginning and at its end [s]."""
    for spec in run.inputs.values():
        delay = spec.delay or KnownDelay(0.0)
        yield spec.signal, delay.lowest, delay.highest
    for spec in run.outputs.values():
        yield spec.signal, -known(spec.delay), -known(spec.delay)
    for start in run.initial.values():
        delay = _delay_of(run, start)
        yield start.signal, -delay.highest, lasting(start.half_width, 0.0) - delay.lowest


def _count(run: FreeRunSpec, length: Fraction) -> int:
    """How many instants a free run has."""
    return multiples(length, run.step, "windows.length") + 1


def _check_rows(run: FreeRunSpec, length: Fraction) -> None:
    if len(every_step(run.late, run.step, _count(run, length))) < 2:
        raise ScenarioError(
            "windows.length",
            "leaves nothing to compare once the outputs' delays are taken off",
            "lengthen the windows, or narrow `min` and `max` of the delays",
        )


def _starts(run: FreeRunSpec, trace: Trace, windows: Placing, barred: FloatArray) -> list[Fraction]:
    """Starts of the windows, on the raster of the communication step, counted from the trace's first stamp.

    After what is `barred` (n, 2) the next begins as soon as it can.

    Raises:
        TraceError: the trace is too short for one, whatever is barred.
    """
    delays = [known(delay) for delay in run.late]
    begin, end = trace.time[0] - min(delays) - ROUNDING, trace.time[-1] - max(delays) + ROUNDING
    first = _on_raster(begin, run.step) + windows.skip
    last = end - float(windows.length)
    if float(first) > last:
        raise TraceError(
            trace.name,
            f"lasts {trace.duration:g} s, too short for {float(windows.length):g} s after {float(windows.skip):g} s",
            "shorten the windows",
        )
    starts: list[Fraction] = []
    while float(first) <= last and (windows.most is None or len(starts) < windows.most):
        within = int(np.searchsorted(barred[:, 0], float(first))) - 1
        if within >= 0 and float(first) < barred[within, 1]:
            first = _on_raster(barred[within, 1], run.step)
        else:
            starts.append(first)
            first += windows.every
    return starts


def _on_raster(instant: float, step: Fraction) -> Fraction:
    """The next multiple of the communication step."""
    return Fraction(np.ceil(instant / float(step))) * step


def _window(
    run: FreeRunSpec,
    trace: Trace,
    start: Fraction,
    length: Fraction,
    constants: Mapping[str, Value],
    own_stamps: bool,
) -> FreeRunWindow:
    count = _count(run, length)
    raster = np.asarray(float(start) + np.arange(count) * float(run.step), dtype=float)
    read = {name: _reading(run, trace, float(start), spec) for name, spec in run.initial.items()}
    commands = {
        name: _command(spec, spec.delay, trace, raster, float(run.step))
        for name, spec in run.inputs.items()
        if spec.delay is not None
    }
    late = {name: command.values(raster, command.delay.start) for name, command in commands.items()}
    prompt = {name: sampled(trace, spec, raster, 0.0) for name, spec in run.inputs.items() if spec.delay is None}
    compared = (own_samples if own_stamps else read_at_steps)(run, trace, float(start), count)
    return FreeRunWindow(
        name=f"{trace.name} at {float(start):.2f} s",
        trace=trace.name,
        measured=compared.measured,
        weight=np.ones(len(run.outputs)),
        start=float(start),
        step=run.step,
        count=count,
        at=compared.at,
        stimuli=prompt | late,
        commands=commands,
        delays=compared.delays,
        stepwise=frozenset(i for i, spec in enumerate(run.outputs.values()) if spec.stepwise),
        initial={name: reading.value(reading.delay.start) for name, reading in read.items()},
        readings={
            name: reading
            for name, reading in read.items()
            if isinstance(reading.delay, Estimated) and not run.initial[name].estimated
        },
        constants=constants,
    )


def _command(spec: TraceSignal, delay: Delay, trace: Trace, raster: FloatArray, step: float) -> Command:
    """A command that counts by its means, as far as it matters from the first instant to a step after the last."""
    held = (LinearCommand if spec.linear else HeldCommand)(trace.time, spec.conversion(trace[spec.signal]))
    near = held.between(raster[0] - delay.highest, raster[-1] + step - delay.lowest)
    return Command(delay, near, spec.stepwise)


def _reading(run: FreeRunSpec, trace: Trace, start: float, spec: StartSpec) -> StartReading:
    """A start value, with its delay."""
    delay = _delay_of(run, spec)
    return StartReading(delay, start_curve(trace, start + delay.start, spec), start)


def _delay_of(run: FreeRunSpec, start: StartSpec) -> Delay:
    """The delay of the output that is read off the same signal."""
    delays = (output.delay for output in run.outputs.values() if output.signal == start.signal)
    return next(delays, None) or KnownDelay(0.0)


def start_curve(trace: Trace, start: float, spec: StartSpec) -> Polynomial:
    """A start value as a polynomial over the time of the signal: value or derivative, converted.

    Raises:
        TraceError: fewer samples lie around `start` than it has coefficients.
    """
    half_width = lasting(spec.half_width, trace.interval)
    near = trace.select([spec.signal]).between(start - half_width, start + half_width)
    if len(near) <= spec.degree:
        raise TraceError(
            f"{trace.name}.{spec.signal}",
            f"has {len(near)} samples within {half_width:g} s of t = {start:g} s",
            f"widen `half_width`, to `{spec.degree + 1} samples` or more",
        )
    polynomial = Polynomial.fit(near.time, near[spec.signal], spec.degree)
    return spec.conversion.factor * polynomial.deriv(spec.derivative) + spec.conversion.offset


def initial_states(run: FreeRunSpec, windows: Sequence[FreeRunWindow]) -> tuple[InitialState, ...]:
    """What the windows start from, as a fit has it."""
    return tuple(
        InitialState(name, tuple(window.initial[name] for window in windows), estimated=spec.estimated)
        for name, spec in run.initial.items()
    )


def counted(windows: Sequence[FreeRunWindow]) -> float:
    """How many of these windows an instant is in that is in any, on average; 1 where none overlap."""
    covered = 0.0
    for trace in {window.trace for window in windows}:
        own = [(window.start, window.start + float(window.stop)) for window in windows if window.trace == trace]
        covered += float(np.diff(union(np.array(own, np.float64))).sum())
    return max(round(float(sum(window.stop for window in windows)) / covered, 9), 1.0)


def evenly_weighed(windows: Sequence[FreeRunWindow]) -> list[FreeRunWindow]:
    """Windows to be judged: weights by the spread of each output, 1 for one that rests in all of them."""
    spread = np.concatenate([window.measured for window in windows]).std(axis=0)
    return [replace(window, weight=1 / np.where(spread > 0, spread, 1.0)) for window in windows]


def weighed(study: OutputErrorStudy, windows: Sequence[FreeRunWindow]) -> list[FreeRunWindow]:
    """Windows to be fitted, with the study's weights.

    Raises:
        TraceError: an output rests in a window that is to be scaled by its spread there.
        IdentificationError: an output rests in all windows.
    """
    if study.weight == "window":
        return [replace(window, weight=_window_weight(study, window)) for window in windows]
    if study.weight == "output":
        weight = spread_weights([window.measured for window in windows])
        return [replace(window, weight=weight) for window in windows]
    return list(windows)


def _window_weight(study: OutputErrorStudy, window: FreeRunWindow) -> FloatArray:
    """(m,) weights by the spread within a window; an output that rests there has none."""
    for name, measured in zip(study.outputs, window.measured.T, strict=True):
        if np.all(measured == measured[0]):
            raise TraceError(
                window.name,
                f"{name} does not move there, so `weight: window` means nothing",
                "skip the window, or weight: output",
            )
    return spread_weights([window.measured])
