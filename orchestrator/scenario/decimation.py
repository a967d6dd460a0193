"""Fewer samples of a trace, and fewer digits of these, such that lines between them stay close to all of it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from orchestrator.trace import FloatArray, Trace


def decimated(trace: Trace, tolerances: Mapping[str, float]) -> Trace:
    """Samples of the trace that lines join within the tolerances at every other one.

    Where a line between two kept samples is off, the sample where it is off most is kept, too, until none is (Douglas,
    Peucker, The Canadian Cartographer 10(2), 1973), all segments at once.

    Args:
        tolerances: signal -> largest distance [unit of the signal], for every signal.
    """
    if len(trace) <= 2:
        return trace
    kept = np.zeros(len(trace), dtype=bool)
    kept[[0, -1]] = True
    while True:
        rows = np.flatnonzero(kept)
        excess = np.max([_excess(trace, name, rows, tolerances[name]) for name in trace.names], axis=0)
        off = np.flatnonzero(excess > 0)
        if not len(off):
            return trace.rows(kept)
        segment = np.searchsorted(rows, off)
        order = np.lexsort((-excess[off], segment))
        _, first = np.unique(segment[order], return_index=True)
        kept[off[order[first]]] = True


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


def _excess(trace: Trace, name: str, rows: NDArray[np.int64], tolerance: float) -> FloatArray:
    """By how much lines between the samples in `rows` are farther from each (K,) than the tolerance, relative to it."""
    values = trace[name]
    distance = np.abs(values - np.interp(trace.time, trace.time[rows], values[rows]))
    with np.errstate(over="ignore"):
        excess: FloatArray = (distance - tolerance) / (tolerance or 1.0)
    return excess
