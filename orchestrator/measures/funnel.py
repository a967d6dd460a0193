"""A tube about a reference, open in value and in time: a rectangle about each point of it, all of them together.

A sample lies within when the reference comes as near as the tolerance somewhere between `lagging` earlier and `leading`
later. The tube is exact for the line (or with `hold` the steps) through the reference's samples, not only at these.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fmus.errors import TraceError
from orchestrator.measures.samples import checked
from orchestrator.trace import FloatArray

_ROUNDING = 1e-9  # of the duration: stamps that near are one


@dataclass(frozen=True)
class Tolerance:
    """How far a signal may be from its reference; what is given adds up.

    Attributes:
        value: absolute [unit].
        relative: share of the reference's amount there [1].
        of_range: share of the reference's range [1].
        leading, lagging: by how much it may come earlier, or later [s].

    Raises:
        TraceError: one of them is negative or not finite.
    """

    value: float = 0.0
    relative: float = 0.0
    of_range: float = 0.0
    leading: float = 0.0
    lagging: float = 0.0

    def __post_init__(self) -> None:
        for name, share in vars(self).items():
            if not 0 <= share < np.inf:
                raise TraceError("tolerance", f"{name} is {share:g}", "give 0 or more")

    def widths(self, reference: FloatArray, span: float) -> FloatArray:
        """(K,) half heights about values (K,) of a reference with that range [unit]."""
        return self.value + self.of_range * span + self.relative * np.abs(reference)


def funnel(
    time: ArrayLike, reference_time: ArrayLike, reference: ArrayLike, tolerance: Tolerance, hold: bool = False
) -> tuple[FloatArray, FloatArray]:
    """(K,) lower and upper bounds at stamps (K,) about a reference (N,) at stamps (N,) of its own.

    Raises:
        TraceError: the reference is no signal, has a NaN, or does not last as long as the stamps.
    """
    s, r = checked(reference_time, reference)
    t = np.asarray(time, dtype=float)
    slack = _ROUNDING * max(1.0, float(s[-1] - s[0]))
    if len(t) and not (s[0] - slack <= t[0] and t[-1] <= s[-1] + slack):
        raise TraceError("reference", f"covers {s[0]:g} to {s[-1]:g} s, not {t[0]:g} to {t[-1]:g} s")
    earlier, later = t - tolerance.lagging, t + tolerance.leading
    span = float(np.ptp(r))
    if hold:
        begin, end = _places(earlier + slack, s), _places(later + slack, s)
        return _extremes(r, tolerance.widths(r, span), np.floor(begin), np.floor(end))
    begin = _places(earlier, s)
    lower, upper = _about(begin, r, tolerance, span)
    if tolerance.leading or tolerance.lagging:
        end = _places(later, s)
        inside = _extremes(r, tolerance.widths(r, span), np.ceil(begin), np.floor(end))
        for low, high in (_about(end, r, tolerance, span), inside):
            np.minimum(lower, low, out=lower)
            np.maximum(upper, high, out=upper)
    return lower, upper


def _places(instants: FloatArray, s: FloatArray) -> FloatArray:
    """(K,) where instants lie between stamps (N,), which count from 0; beyond the ends, at them."""
    return np.asarray(np.interp(instants, s, np.arange(float(len(s)))))


def _about(places: FloatArray, r: FloatArray, tolerance: Tolerance, span: float) -> tuple[FloatArray, FloatArray]:
    """(K,) lower and upper bounds about the line through samples (N,) at these places."""
    value = _between(places, r)
    width = tolerance.widths(value, span)
    return value - width, value + width


def _extremes(r: FloatArray, width: FloatArray, first: FloatArray, last: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(K,) lowest and highest bounds about the samples (N,) from `first` to `last`, where there are any."""
    rows = first.astype(np.intp), last.astype(np.intp) + 1
    return -_largest(width - r, *rows), _largest(r + width, *rows)


def _between(places: FloatArray, r: FloatArray) -> FloatArray:
    """(K,) values on the line through samples (N,), at places that count these samples from 0."""
    row = places.astype(np.intp)
    return np.asarray(r[row] + (places - row) * (r[np.minimum(row + 1, len(r) - 1)] - r[row]))


def _largest(values: FloatArray, first: np.ndarray, after: np.ndarray) -> FloatArray:
    """(K,) the largest of values (N,) in each range of rows `first` to before `after`; -inf of an empty one.

    By tables of the largest of 1, 2, 4, ... values in a row: a range is two of those that overlap (Bender and
    Farach-Colton 2000). Only tables that a range needs are made.
    """
    count = after - first
    level = np.where(count > 0, np.frexp(count)[1] - 1, -1)
    largest = np.full(len(first), -np.inf)
    table = values
    for power in range(int(level.max(initial=-1)) + 1):
        if power:
            half = 1 << (power - 1)
            table = np.maximum(table[:-half], table[half:])
        rows = np.flatnonzero(level == power)
        if len(rows):
            largest[rows] = np.maximum(table[first[rows]], table[after[rows] - (1 << power)])
    return largest
