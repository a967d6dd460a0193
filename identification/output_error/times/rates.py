"""What becomes of recordings that are sampled otherwise than free runs step: told where it is more than a little."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from identification.output_error.times.delays import HeldCommand
from identification.signals.resolution import resolution
from orchestrator.trace import FloatArray, Trace

if TYPE_CHECKING:
    from identification.output_error.free_runs.window import FreeRunWindow
    from identification.output_error.study import FreeRunSpec
    from identification.output_error.times.lateness import OutputLateness
    from identification.recordings.campaign import StudyTrace

_MUCH = 0.05  # of an input's spread, rms over the steps
_CHANGES = 20  # from which on it is told whether each lasts
_COARSE = 1.5  # steps between samples, from which lines between them are compared


def rate_warnings(
    run: FreeRunSpec,
    recorded: Sequence[StudyTrace],
    windows: Sequence[FreeRunWindow],
    late: OutputLateness | None = None,
) -> Iterator[str]:
    """A sentence about each input and output whose samples and steps do not go together, by the worst trace.

    Of an input the value at the beginning of each step counts, along lines between samples; that is held against the
    exact means of samples that hold until the next. Outputs of frames are compared along lines, which cut their curves
    by about an eighth of the second difference. One that holds its values over several samples of its file is late.

    Args:
        late: how late outputs seem to be recorded, where residuals speak for it.
    """
    step = float(run.step)
    own = {one.trace.name: [w for w in windows if w.trace == one.trace.name] for one in recorded}
    traces = [one for one in recorded if own[one.trace.name]]
    for name, spec in run.inputs.items():
        off = {
            one.trace: _missed(one.trace, spec.signal, own[one.trace.name], step)
            for one in traces
            if spec.delay is None and not one.held
        }
        trace, much = _worst(off)
        if trace is not None and much > _MUCH:
            yield (
                f"inputs.{name}: {trace.name} has a sample every {trace.interval:.3g} s, and steps of {step:g} s take "
                f"the value at their beginning, along lines between samples: off by {100 * much:.0f} % of its spread "
                "where samples hold until the next; say `interpolation: hold` for a command, `linear` for what was "
                "measured"
            )
    for name, output in run.outputs.items():
        frames = [one.trace for one in traces if one.held and not output.stepwise]
        coarse = [trace for trace in frames if trace.interval >= _COARSE * step]
        trace, much = _worst({one: _cut(one, output.signal, own[one.name]) for one in coarse})
        if trace is not None:
            yield (
                f"outputs.{name}: {trace.name} has a sample every {trace.interval:.3g} s and is compared every "
                f"{step:g} s, along lines that cut its curves by about {100 * much:.2g} % of its spread, which shifts "
                f"estimates: let `step` be {trace.interval:.3g} s, with `interpolation` of the inputs"
            )
        fine = [one.trace for one in traces if not one.held and not output.stepwise]
        trace, samples = _worst({one: _held_for(one[output.signal]) for one in fine})
        if trace is not None and samples > 1:
            yield (
                f"outputs.{name}: {output.signal} of {trace.name} has a new value only every {samples:.0f} samples and "
                f"holds it between, late by {(samples - 1) / 2 * trace.interval:.2g} s on average, which shifts "
                f"estimates: record it at its own rate, or let `step` be {samples * trace.interval:.3g} s"
            )
    if late is not None:
        yield _delay_warning(late, step)


def _delay_warning(late: OutputLateness, step: float) -> str:
    """A sentence about a delay that nobody has told, with outputs compared every `step` [s]."""
    seconds, std = late.steps * step, late.std * step
    which = "earlier" if seconds < 0 else "later"
    moved = max(late.moved, key=lambda name: abs(late.moved[name]))
    mending = "say so by its `delay`, or that of the inputs, as a value or as a parameter"
    if seconds < 0:
        mending = (
            "its clock may be ahead (a negative `delay`), or inputs may be samples out of a faster loop, which are "
            f"held {step / 2:.2g} s too long on average (`interpolation: linear`)"
        )
    return (
        f"outputs.{' and '.join(late.outputs)}: residuals look as if recorded {abs(seconds):.2g} s {which} than free "
        f"runs have it (+- {std:.1g}), which explains {100 * late.explained:.0f} % of their power and moves {moved} by "
        f"{abs(late.moved[moved]):.2g} of its standard deviations: {mending}"
    )


def _worst(off: Mapping[Trace, float]) -> tuple[Trace | None, float]:
    return max(off.items(), key=lambda one: one[1], default=(None, 0.0))


def _missed(trace: Trace, signal: str, windows: Sequence[FreeRunWindow], step: float) -> float:
    """rms of what steps take over the means of held samples, in the signal's spread; 0 for one that rests."""
    taken, means = list[FloatArray](), list[FloatArray]()
    for window in windows:
        edges = np.append(window.run_time, window.run_time[-1] + step)
        held = HeldCommand(trace.time, trace[signal]).between(edges[0], edges[-1])
        means.append(held.means(edges))
        taken.append(np.interp(edges[:-1], trace.time, trace[signal]))
    had, due = np.concatenate(taken), np.concatenate(means)
    spread = float(max(had.std(), due.std()))
    return float(np.sqrt(np.mean((had - due) ** 2))) / spread if spread else 0.0


def _held_for(values: FloatArray) -> float:
    """For how many samples each new value stays, at least; 1 where values come from an encoder that counts slowly."""
    changes = np.flatnonzero(np.diff(values))
    moved = np.abs(np.diff(values)[changes])
    if len(changes) < _CHANGES or np.median(moved) < 1.5 * resolution(values):
        return 1.0
    return float(np.diff(changes).min())


def _cut(trace: Trace, signal: str, windows: Sequence[FreeRunWindow]) -> float:
    """rms of how far lines are from a curve in the middle between samples, in the signal's spread."""
    parts = [trace.between(window.run_time[0], window.run_time[-1])[signal] for window in windows]
    bends = np.concatenate([np.diff(part, 2) / 8 for part in parts])
    spread = float(np.concatenate(parts).std())
    return float(np.sqrt(np.mean(bends**2))) / spread if spread and len(bends) else 0.0
