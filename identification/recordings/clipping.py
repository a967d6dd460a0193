"""Recordings of outputs that stop at an end of a range while free runs go on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from identification.recordings.campaign import StudyTrace
from identification.signals.clipping import Clipped, clipped
from orchestrator.trace import FloatArray, Trace

_GOES_ON = 0.02  # of the simulated output's spread, that it moves by while the recording rests
FreeRunOver = tuple[str, FloatArray, FloatArray]  # name of the trace, time (K,) [s] and outputs (K, m)


def clipping_warnings(
    signals: Mapping[str, str], recorded: Sequence[StudyTrace], simulated: Sequence[FreeRunOver]
) -> Iterator[str]:
    """A sentence about each end of a range that recordings stop at, by the one that is longest there.

    Args:
        signals: output -> what it is compared with, in the order of the simulated columns.
    """
    for column, (name, signal) in enumerate(signals.items()):
        runs = [(trace, time, outputs[:, column]) for trace, time, outputs in simulated]
        ends = [
            (one.highest, (one.share, one.value, trace.name))
            for trace in (one.trace for one in recorded)
            for one in clipped(trace[signal])
            if _goes_on(one, trace, [(time, y) for own, time, y in runs if own == trace.name])
        ]
        for highest in (True, False):
            if found := [end for is_highest, end in ends if is_highest is highest]:
                share, value, trace_name = max(found)
                side, limit = ("highest", "above") if highest else ("lowest", "below")
                yield (
                    f"outputs.{name}: {signal} of {trace_name} stops at its {side} value, {value:.6g}, for "
                    f"{100 * share:.2g} % of its samples, while free runs go on: if a range ends there, leave these "
                    f"out (`traces.exclude: [{{signal: {signal}, {limit}: LIMIT}}]`, LIMIT just inside)"
                )


def _goes_on(found: Clipped, trace: Trace, runs: Sequence[tuple[FloatArray, FloatArray]]) -> bool:
    """Whether free runs move over most of the stretches at which a recording stops."""
    stretches = [(trace.time[first], trace.time[after - 1]) for first, after in found.stretches]
    moved = [
        float(np.ptp(y[inside]))
        for time, y in runs
        for begin, end in stretches
        if np.count_nonzero(inside := (time >= begin) & (time <= end)) > 1
    ]
    spread = float(np.concatenate([y for _, y in runs]).std()) if runs else 0.0
    return bool(moved) and float(np.median(moved)) > _GOES_ON * spread
