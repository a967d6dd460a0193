"""Signals that come less often than the rows of their recording, as tables of several rates have them."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from orchestrator.marks import LONG
from orchestrator.trace import FloatArray, Trace

Rows = NDArray[np.intp]

FEWEST = 8  # samples that tell a rate
EVEN = 0.95  # the share of distances that are the usual one


def filled(trace: Trace, used: Collection[str], linear: Collection[str]) -> tuple[Trace, tuple[str, ...]]:
    """The trace with values between the samples of slower signals, where all of these have come; and a line on each.

    Args:
        used: signals that are filled where only some rows have a value, as a cell of a table is empty: evenly.
        linear: those that run linearly between their samples; the others keep their last value.
    """
    signals, notes, begin, end = dict(trace.signals), [], 0, len(trace)
    for name in sorted(set(used) & set(trace.names)):
        rows = np.flatnonzero(~np.isnan(trace[name]))
        each = _usual_distance(rows)
        if each < 2:
            continue
        signals[name] = _between(trace.time, trace[name], rows, LONG * each, name in linear)
        begin = max(begin, int(rows[0]))
        end = min(end, int(rows[-1]) + (1 if name in linear else each))
        how = "runs linearly between its samples" if name in linear else "keeps its value until the next"
        period = each * float(np.median(np.diff(trace.time)))
        notes.append(f"signal '{name}' comes every {period:.3g} s, in one of {each} rows, and {how}")
    if not notes or end - begin < 2:
        return trace, ()
    return trace.sampled(trace.time, signals).rows(slice(begin, end)), tuple(notes)


def _usual_distance(rows: Rows) -> int:
    """From one of the rows (K,) to the next, in rows; 0 where they are too few or do not come evenly."""
    distances = np.diff(rows)
    if len(distances) < FEWEST:
        return 0
    usual = int(np.median(distances))
    return usual if np.mean(distances == usual) >= EVEN else 0


def _between(time: FloatArray, values: FloatArray, rows: Rows, longest: float, linear: bool) -> FloatArray:
    """Values (K,) at all rows, without one in gaps of more rows than `longest`."""
    after = np.searchsorted(rows, np.arange(len(time)), side="left")
    last = np.maximum(np.searchsorted(rows, np.arange(len(time)), side="right") - 1, 0)
    made = np.interp(time, time[rows], values[rows]) if linear else values[rows[last]]
    wide = rows[np.minimum(after, len(rows) - 1)] - rows[last] > longest
    return np.where(wide, values, made)
