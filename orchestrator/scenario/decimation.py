"""Fewer samples of a trace, and fewer digits of these, such that lines between them stay close to all of it."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from orchestrator.trace import BoolArray, FloatArray, Trace

Rows = NDArray[np.int64]
LONG = 64  # samples of a segment


def decimated(trace: Trace, tolerances: Mapping[str, float], hold: Collection[str] = ()) -> Trace:
    """Samples of the trace that lines join within the tolerances at every other one.

    Where a line between two kept samples is off, the sample where it is off most is kept, too, until none is (Douglas,
    Peucker, The Canadian Cartographer 10(2), 1973), all segments at once; where that is near one end of a long segment
    its middle, too.

    Args:
        tolerances: signal -> largest distance [unit of the signal], for every signal.
        hold: signals that keep each value until their next sample, also where samples are left out.
    """
    if len(trace) <= 2:
        return trace
    kept = np.zeros(len(trace), dtype=bool)
    kept[[0, -1]] = True
    for name in hold:
        kept[_steps(trace[name], tolerances[name])] = True
    lines = trace.select(name for name in trace.names if name not in hold)
    return trace.rows(_joined(lines, kept, tolerances) if lines.names else kept)


def _joined(trace: Trace, kept: BoolArray, tolerances: Mapping[str, float]) -> BoolArray:
    """(K,) which samples are kept: those of `kept`, and as many more as lines need."""
    kept = kept.copy()
    left = np.flatnonzero(~kept)  # samples whose segment was off
    while len(left):
        rows = np.flatnonzero(kept)
        excess = np.max([_excess(trace, name, rows, left, tolerances[name]) for name in trace.names], axis=0)
        begins = np.flatnonzero(np.diff(np.searchsorted(rows, left), prepend=-1))  # of segments among those left
        worst = np.maximum.reduceat(excess, begins)
        widths = np.diff(begins, append=len(left))
        place = np.repeat(np.arange(len(begins)), widths)
        _, first = np.unique(place[hits := np.flatnonzero(excess == worst[place])], return_index=True)
        found = left[hits[first[worst > 0]]]
        kept[found] = True
        kept[_middles(rows, found)] = True
        left = left[(worst > 0)[place]]
        left = left[~kept[left]]
    return kept


def _steps(values: FloatArray, tolerance: float) -> list[int]:
    """Where a value is farther from the one that was kept last than the tolerance."""
    steps, last = [0], float(values[0])
    for row, value in enumerate(values.tolist()):
        if abs(value - last) > tolerance:
            steps.append(row)
            last = value
    return steps


def _middles(rows: Rows, found: Rows) -> Rows:
    """The middles of long segments between `rows` whose sample in `found` is near an end: else a curve that dies away
    would be divided sample by sample."""
    end = np.searchsorted(rows, found)
    start, stop = rows[end - 1], rows[end]
    near = np.minimum(found - start, stop - found) < (stop - start) / 4
    lopsided = near & (stop - start > LONG)
    middles: Rows = (start[lopsided] + stop[lopsided]) // 2
    return middles


def rounded(trace: Trace, tolerances: Mapping[str, float]) -> Trace:
    """The trace with values rounded by no more than the tolerances, to binary fractions: they compress well.

    Args:
        tolerances: signal -> largest change [unit of the signal], for every signal; 0 changes nothing.
    """
    signals = {name: _rounded(trace[name], tolerances[name]) for name in trace.names}
    return Trace(trace.time, signals, trace.units, trace.name)


def _rounded(values: FloatArray, tolerance: float) -> FloatArray:
    if tolerance <= np.finfo(float).eps * np.max(np.abs(values), initial=0.0):
        return values
    step = 2.0 ** np.floor(np.log2(2 * tolerance))
    found: FloatArray = np.rint(values / step) * step
    return found


def _excess(trace: Trace, name: str, rows: Rows, some: Rows, tolerance: float) -> FloatArray:
    """By how much lines between the samples in `rows` are farther from `some` than the tolerance, relative to it."""
    values = trace[name]
    distance = np.abs(values[some] - np.interp(trace.time[some], trace.time[rows], values[rows]))
    with np.errstate(over="ignore"):
        excess: FloatArray = (distance - tolerance) / (tolerance or 1.0)
    return excess
