"""Windows cut out of traces: what drives each free run, where it starts, and what it is compared with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.polynomial import Polynomial

from fmus.errors import ScenarioError, TraceError
from identification.output_error.delays import Command, Held, Reading, compared_rows, known, late_outputs, seconds, span
from identification.output_error.schema import Delay, InitialBlock, OutputErrorBlock, SignalBlock, WindowsBlock
from identification.recordings.campaign import Recorded, trace_values
from orchestrator.fmi.interface import Value
from orchestrator.rational import multiples
from orchestrator.trace import FloatArray, Trace, usable

ROUNDING = 1e-9  # [s]; a window that reaches so little beyond the first or last stamp still fits


@dataclass(frozen=True, eq=False)
class Cut:
    """One window of one trace, on the communication instants of the free run.

    Attributes:
        name: trace and start, for messages and reports.
        start: where in the trace it begins [s].
        step: between two instants [s].
        count: instants of the free run, K.
        rows: those that are compared, K'; all where no output has a delay.
        stimuli: component.input -> (K,) values; of delayed ones, with the delay that the study starts from.
        commands: the delayed inputs.
        measured: (K', m) outputs, one column an output of the study.
        delays: of these outputs the parameters that move them, None for those of which all is known.
        initial: component.variable -> measured start value, with the delay that the study starts from.
        readings: those that are read off a delayed output.
        constants: component.variable -> value that holds for this trace.
    """

    name: str
    trace: str
    start: float
    step: Fraction
    count: int
    rows: slice
    stimuli: Mapping[str, FloatArray]
    commands: Mapping[str, Command]
    measured: FloatArray
    delays: tuple[str | None, ...]
    initial: Mapping[str, float]
    readings: Mapping[str, Reading]
    constants: Mapping[str, Value]

    @property
    def run_time(self) -> FloatArray:
        """(K,) instants of the free run in the trace's time [s]."""
        return np.asarray(self.start + np.arange(self.count) * float(self.step))

    @property
    def time(self) -> FloatArray:
        """(K',) instants that are compared in the trace's time [s]."""
        return np.asarray(self.run_time[self.rows])

    @property
    def stop(self) -> Fraction:
        """How long the free run is [s]."""
        return (self.count - 1) * self.step

    def driven(self, values: Mapping[str, float]) -> dict[str, FloatArray]:
        """component.input -> (K,) values, with delays of these values."""
        return {
            **self.stimuli,
            **{name: each.values(self.run_time, seconds(each.delay, values)) for name, each in self.commands.items()},
        }

    def start_values(self, values: Mapping[str, float]) -> dict[str, float]:
        """component.variable -> start value read off a delayed output, with delays of these values."""
        return {name: each.value(seconds(each.delay, values)) for name, each in self.readings.items()}

    def recorded(self, simulated: FloatArray, values: Mapping[str, float]) -> FloatArray:
        """(K', m) what would have been recorded of a free run's outputs (K, m), with delays of these values."""
        delays = [None if delay is None else seconds(delay, values) for delay in self.delays]
        return late_outputs(simulated, float(self.step), delays, self.rows)


def cut_windows(study: OutputErrorBlock, recorded: Sequence[Recorded], windows: WindowsBlock) -> list[Cut]:
    """The windows of these traces.

    Raises:
        TraceError: a signal is missing, constant or not finite, or a trace is too short for one window.
        ScenarioError: delays leave nothing of a window to compare.
    """
    _check_rows(study, windows)
    needed = sorted(study.signals.commands | study.signals.measured)
    cuts = []
    for each in recorded:
        named = replace(each.trace, name=str(each.source)) if study.traces.files else each.trace
        trace = replace(usable(named.select(needed), needed), name=each.trace.name)
        constants = trace_values(study.traces, trace.name, each.fields)
        own = _by_means(study) if each.held else study
        cuts += [_cut(own, trace, start, windows.length, constants) for start in _starts(study, trace, windows)]
    return cuts


def _by_means(study: OutputErrorBlock) -> OutputErrorBlock:
    """The study with commands that count by their mean over each step: frames never come at its beginning."""
    inputs = {
        name: block if block.delay is not None else block.model_copy(update={"delay": 0.0})
        for name, block in study.inputs.items()
    }
    return study.model_copy(update={"inputs": inputs})


def _check_rows(study: OutputErrorBlock, windows: WindowsBlock) -> None:
    count = multiples(windows.length, study.step, "windows.length") + 1
    if len(range(count)[compared_rows(study, count)]) < 2:
        raise ScenarioError(
            "windows.length",
            "leaves nothing to compare once the outputs' delays are taken off",
            "lengthen the windows, or narrow `min` and `max` of the delays",
        )


def _starts(study: OutputErrorBlock, trace: Trace, windows: WindowsBlock) -> list[Fraction]:
    """Starts of the windows, on the raster of the communication step, counted from the trace's first stamp."""
    delays = [known(block.delay) for block in study.outputs.values()]
    begin, end = trace.time[0] - min(delays) - ROUNDING, trace.time[-1] - max(delays) + ROUNDING
    first = Fraction(np.ceil(begin / float(study.step))) * study.step + windows.skip
    every, last = windows.every or windows.length, end - float(windows.length)
    starts: list[Fraction] = []
    while float(first) <= last and (windows.most is None or len(starts) < windows.most):
        starts.append(first)
        first += every
    if not starts:
        raise TraceError(
            trace.name,
            f"lasts {trace.duration:g} s, too short for {float(windows.length):g} s after {float(windows.skip):g} s",
            "shorten the windows",
        )
    return starts


def _cut(
    study: OutputErrorBlock, trace: Trace, start: Fraction, length: Fraction, constants: Mapping[str, Value]
) -> Cut:
    count = multiples(length, study.step, "windows.length") + 1
    raster = np.asarray(float(start) + np.arange(count) * float(study.step), dtype=float)
    rows = compared_rows(study, count)
    read = {name: _reading(study, trace, float(start), block) for name, block in study.initial.items()}
    commands = {
        name: _command(study, trace, raster, block, block.delay)
        for name, block in study.inputs.items()
        if block.delay is not None
    }
    late = {name: each.values(raster, span(study, each.delay).start) for name, each in commands.items()}
    prompt = {name: _sampled(trace, block, raster, 0.0) for name, block in study.inputs.items() if block.delay is None}
    measured = [_sampled(trace, block, raster[rows], known(block.delay)) for block in study.outputs.values()]
    return Cut(
        name=f"{trace.name} at {float(start):.2f} s",
        trace=trace.name,
        start=float(start),
        step=study.step,
        count=count,
        rows=rows,
        stimuli=prompt | late,
        commands=commands,
        measured=np.column_stack(measured),
        delays=tuple(block.delay if isinstance(block.delay, str) else None for block in study.outputs.values()),
        initial={name: each.value(span(study, each.delay).start) for name, each in read.items()},
        readings={
            name: each
            for name, each in read.items()
            if isinstance(each.delay, str) and not study.initial[name].estimated
        },
        constants=constants,
    )


def _sampled(trace: Trace, block: SignalBlock, instants: FloatArray, delay: float) -> FloatArray:
    """(K,) what the trace shows of a variable at these instants [s], that much later; its ends last."""
    return np.asarray(block.factor * np.interp(instants + delay, trace.time, trace[block.signal]))


def _command(study: OutputErrorBlock, trace: Trace, raster: FloatArray, block: SignalBlock, delay: Delay) -> Command:
    """A delayed command, as far as it matters from the first instant to a step after the last."""
    reach = span(study, delay)
    held = Held(trace.time, block.factor * trace[block.signal])
    return Command(delay, held.between(raster[0] - reach.highest, raster[-1] + float(study.step) - reach.lowest))


def _reading(study: OutputErrorBlock, trace: Trace, start: float, block: InitialBlock) -> Reading:
    """A start value, by the delay of the output that is read off the same signal."""
    delays = [output.delay for output in study.outputs.values() if output.signal == block.signal]
    delay = (delays[0] if delays else None) or 0.0
    return Reading(delay, start_curve(trace, start + span(study, delay).start, block), start)


def start_value(trace: Trace, start: float, block: InitialBlock) -> float:
    """Value or derivative of a signal at `start` [s], scaled: of a polynomial fitted to the samples around it.

    Raises:
        TraceError: fewer samples lie there than the polynomial has coefficients.
    """
    return float(start_curve(trace, start, block)(start))


def start_curve(trace: Trace, start: float, block: InitialBlock) -> Polynomial:
    """The polynomial behind a start value, over the time of the signal.

    Raises:
        TraceError: fewer samples lie around `start` than it has coefficients.
    """
    near = trace.select([block.signal]).between(start - block.half_width, start + block.half_width)
    if len(near) <= block.degree:
        raise TraceError(
            f"{trace.name}.{block.signal}",
            f"has {len(near)} samples within {block.half_width:g} s of t = {start:g} s",
            "widen `half_width`",
        )
    polynomial = Polynomial.fit(near.time, near[block.signal], block.degree)
    return block.factor * polynomial.deriv(block.derivative)
