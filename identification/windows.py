"""Windows cut out of traces: what drives each free run, where it starts, and what it is compared with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from fmus.errors import TraceError
from identification.campaign import Recorded
from identification.study import InitialBlock, OutputErrorBlock, WindowsBlock, trace_values
from orchestrator.rational import multiples
from orchestrator.slave import Value
from orchestrator.trace import FloatArray, Trace, usable

ROUNDING = 1e-9  # [s]; a window that reaches so little beyond the first or last stamp still fits


@dataclass(frozen=True, eq=False)
class Cut:
    """One window of one trace, on the communication instants of the free run.

    Attributes:
        name: trace and start, for messages and reports.
        start: where in the trace it begins [s].
        step: between two instants [s].
        stimuli: component.input -> (K,) values.
        measured: (K, m) outputs, one column an output of the study.
        initial: component.variable -> measured start value.
        constants: component.variable -> value that holds for this trace.
    """

    name: str
    trace: str
    start: float
    step: Fraction
    stimuli: Mapping[str, FloatArray]
    measured: FloatArray
    initial: Mapping[str, float]
    constants: Mapping[str, Value]

    @property
    def time(self) -> FloatArray:
        """(K,) instants in the trace's time [s]."""
        return np.asarray(self.start + np.arange(len(self.measured)) * float(self.step))


def cut_windows(study: OutputErrorBlock, recorded: Sequence[Recorded], windows: WindowsBlock) -> list[Cut]:
    """The windows of these traces.

    Raises:
        TraceError: a signal is missing, constant or not finite, or a trace is too short for one window.
    """
    needed = sorted({block.signal for blocks in (study.inputs, study.outputs, study.initial)
                     for block in blocks.values()})  # fmt: skip
    cuts = []
    for each in recorded:
        named = replace(each.trace, name=str(each.source)) if study.traces.files else each.trace
        trace = replace(usable(named.select(needed), needed), name=each.trace.name)
        constants = trace_values(study.traces, trace.name, each.fields)
        cuts += [_cut(study, trace, start, windows.length, constants) for start in _starts(study, trace, windows)]
    return cuts


def _starts(study: OutputErrorBlock, trace: Trace, windows: WindowsBlock) -> list[Fraction]:
    """Starts of the windows, on the raster of the communication step, counted from the trace's first stamp."""
    first = Fraction(np.ceil((trace.time[0] - ROUNDING) / float(study.step))) * study.step + windows.skip
    every, last = windows.every or windows.length, trace.time[-1] - float(windows.length) + ROUNDING
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
    instants = np.clip(float(start) + np.arange(count) * float(study.step), trace.time[0], trace.time[-1])
    sampled = trace.resampled(instants)
    return Cut(
        name=f"{trace.name} at {float(start):.2f} s",
        trace=trace.name,
        start=float(start),
        step=study.step,
        stimuli={name: sampled[block.signal] for name, block in study.inputs.items()},
        measured=np.column_stack([sampled[block.signal] for block in study.outputs.values()]),
        initial={name: start_value(trace, float(start), block) for name, block in study.initial.items()},
        constants=constants,
    )


def start_value(trace: Trace, start: float, block: InitialBlock) -> float:
    """Value or derivative of a signal at `start` [s], scaled: a polynomial fitted to the samples around it.

    Raises:
        TraceError: fewer samples lie there than the polynomial has coefficients.
    """
    near = trace.select([block.signal]).between(start - block.half_width, start + block.half_width)
    if len(near) <= block.degree:
        raise TraceError(f"{trace.name}.{block.signal}", f"has {len(near)} samples within {block.half_width:g} s of "
                         f"t = {start:g} s", "widen `half_width`")  # fmt: skip
    polynomial = np.polynomial.Polynomial.fit(near.time, near[block.signal], block.degree)
    return block.factor * float(polynomial.deriv(block.derivative)(start))
