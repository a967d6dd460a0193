"""Samples that a figure can be made of, and the instants at which the line between them crosses a level."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fmus.errors import TraceError
from orchestrator.trace import FloatArray


def checked(time: ArrayLike, values: ArrayLike, fewest: int = 1) -> tuple[FloatArray, FloatArray]:
    """Stamps (K,) [s] and values (K,) as arrays.

    Raises:
        TraceError: they differ in length, are fewer than `fewest`, one is NaN or infinite, or stamps do not increase.
    """
    t, y = np.asarray(time, dtype=float), np.asarray(values, dtype=float)
    if t.ndim != 1 or t.shape != y.shape:
        raise TraceError("samples", f"stamps have shape {t.shape}, values {y.shape}", "give one stamp a value")
    if len(t) < fewest:
        raise TraceError("samples", f"are {len(t)}, not {fewest} or more", "widen the window")
    if np.any(t[1:] <= t[:-1]) or not np.all(np.isfinite(t)):
        raise TraceError("samples", "stamps do not increase strictly", "order the recording")
    bad = np.flatnonzero(~np.isfinite(y))
    if len(bad):
        raise TraceError("samples", f"the value at {t[bad[0]]:g} s is {y[bad[0]]:g} ({len(bad)} like it)")
    return t, y


def meets(t: FloatArray, y: FloatArray, row: int, level: float) -> float:
    """When the line from sample `row` to the next one has this level, which lies between them [s]."""
    rise = y[row + 1] - y[row]
    share = 0.0 if rise == 0 else min(max((level - y[row]) / rise, 0.0), 1.0)
    return float(t[row] + share * (t[row + 1] - t[row]))
