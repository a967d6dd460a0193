"""A tube about a reference, open in value and in time: a rectangle about each point of it, all of them together.

A sample lies within when the reference comes as near as the tolerance somewhere between `lagging` earlier and `leading`
later. The tube is exact for the line (or with `hold` the steps) through the reference's samples, not only at these.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmus.errors import TraceError
from orchestrator.measures.samples import checked
from orchestrator.trace import FloatArray

Rows = NDArray[np.intp]
_ROUNDING = 1e-9  # of the duration: stamps that near are one
_PIECE = 1 << 14  # samples at a time, which stay in the processor's cache
_ON = 1e-6  # of a step: stamps that near to an even grid are on it


@dataclass(frozen=True)
class FunnelTolerance:
    """How far a signal may be from its reference; what is given adds up.

    Attributes:
        value: absolute [unit of the signal].
        relative: share of the reference's amount there.
        of_range: share of the reference's range.
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

    def bounds(self, reference: FloatArray, span: float) -> tuple[FloatArray, FloatArray]:
        """(K,) lower and upper bounds about values (K,) of a reference with that range [unit]."""
        width = self.width(span)
        if not self.relative:
            return reference - width, reference + width
        widths = width + self.relative * np.abs(reference)
        return reference - widths, reference + widths

    def width(self, span: float) -> float:
        """Half the height of the tube where a reference with that range is 0 [unit]."""
        return self.value + self.of_range * span


def funnel(
    time: ArrayLike, reference_time: ArrayLike, reference: ArrayLike, tolerance: FunnelTolerance, hold: bool = False
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
    span = float(np.ptp(r))
    if not (hold or tolerance.leading or tolerance.lagging):
        return tolerance.bounds(r if np.array_equal(t, s) else np.interp(t, s, r), span)
    lower, upper = np.empty_like(t), np.empty_like(t)
    seen = len(s) * (tolerance.leading + tolerance.lagging) / max(float(s[-1] - s[0]), _ROUNDING)
    size = int(max(_PIECE, min(seen, len(t))))
    for first in range(0, len(t), size):
        piece = slice(first, first + size)
        earlier, later = t[piece] - tolerance.lagging, t[piece] + tolerance.leading
        rows = slice(
            max(int(np.searchsorted(s, earlier[0] + slack, side="right")) - 1, 0),
            int(np.searchsorted(s, later[-1] + slack)) + 1,
        )
        about = _held if hold else _drawn
        margin = slack if hold else 0.0
        lower[piece], upper[piece] = about(earlier + margin, later + margin, s[rows], r[rows], tolerance, span)
    return lower, upper


def _held(
    earlier: FloatArray, later: FloatArray, s: FloatArray, r: FloatArray, tolerance: FunnelTolerance, span: float
) -> tuple[FloatArray, FloatArray]:
    """(K,) bounds about all steps between these instants (K,) [s]."""
    first, last = np.floor(_places(earlier, s)), np.floor(_places(later, s))
    return _extremes(*tolerance.bounds(r, span), first.astype(np.intp), last.astype(np.intp))


def _drawn(
    earlier: FloatArray, later: FloatArray, s: FloatArray, r: FloatArray, tolerance: FunnelTolerance, span: float
) -> tuple[FloatArray, FloatArray]:
    """(K,) bounds about the line between these instants (K,) [s]: at its ends, and at the samples between."""
    begin, end = _places(earlier, s), _places(later, s)
    rows = np.ceil(begin - _ON).astype(np.intp), (end + _ON).astype(np.intp)
    lower, upper = _extremes(*tolerance.bounds(r, span), *rows)
    slope = np.append(np.diff(r), 0.0)
    for place in (begin, end):
        row = place.astype(np.intp)
        low, high = tolerance.bounds(r[row] + (place - row) * slope[row], span)
        np.minimum(lower, low, out=lower)
        np.maximum(upper, high, out=upper)
    return lower, upper


def _places(instants: FloatArray, s: FloatArray) -> FloatArray:
    """(K,) where instants lie between stamps (N,), which count from 0; beyond the ends, at them."""
    last = len(s) - 1
    grid = np.arange(last + 1.0)
    step = (s[-1] - s[0]) / max(last, 1)
    if last and np.max(np.abs(s - (s[0] + step * grid))) < _ON * step:  # even: no search is needed
        places: FloatArray = (instants - s[0]) / step
        return np.clip(places, 0, last, out=places)
    return np.asarray(np.interp(instants, s, grid))


def _extremes(low: FloatArray, high: FloatArray, first: Rows, last: Rows) -> tuple[FloatArray, FloatArray]:
    """(K,) the lowest of `low` and the highest of `high` (N,) from each row `first` to `last`; infinite where none is.

    By tables of the extremes of 1, 2, 4, ... values in a row: a range is two of those that overlap (Bender and
    Farach-Colton 2000). Only tables that a range needs are made.
    """
    level = np.frexp(np.maximum(last + 1 - first, 0))[1] - 1
    lower, upper = np.full(len(first), np.inf), np.full(len(first), -np.inf)
    for power in range(int(level.max(initial=-1)) + 1):
        if power:
            half = 1 << (power - 1)
            low, high = np.minimum(low[:-half], low[half:]), np.maximum(high[:-half], high[half:])
        rows = np.flatnonzero(level == power)
        if len(rows):
            one, other = first[rows], last[rows] + (1 - (1 << power))
            lower[rows] = np.minimum(low[one], low[other])
            upper[rows] = np.maximum(high[one], high[other])
    return lower, upper
