"""When something happens to a signal: it crosses a level, meets its limits, or changes from one mode to another."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from fmus.errors import TraceError
from orchestrator.marks import runs
from orchestrator.measures.samples import checked, meets
from orchestrator.trace import BoolArray, FloatArray

Direction = Literal["up", "down", "both"]


def crossings(
    time: ArrayLike,
    values: ArrayLike,
    level: float,
    direction: Direction = "both",
    hysteresis: float = 0.0,
    hold: bool = False,
) -> FloatArray:
    """(n,) stamps at which the signal goes through a level [s].

    It has gone through when it is beyond the level by `hysteresis` on the other side than it last was; the stamp is
    that of the last passage of the level before. One that begins on the level, or only touches it, does not cross.

    Args:
        hysteresis: how far beyond the level a crossing counts [unit], more than the noise.

    Raises:
        TraceError: the samples are no signal, so with the others.
    """
    t, y = checked(time, values)
    far = np.flatnonzero((y > level + hysteresis) | (y < level - hysteresis))
    above = y[far] > level
    turns = np.flatnonzero(above[1:] != above[:-1])
    wanted = {"up": (True,), "down": (False,), "both": (True, False)}[direction]
    found = []
    for turn in turns[np.isin(above[turns + 1], wanted)]:
        before, after, side = far[turn], far[turn + 1], above[turn + 1]
        stretch = y[before:after] > level if not side else y[before:after] < level
        last = int(before + np.flatnonzero(stretch)[-1])
        found.append(_passage(t, y, last, int(after), level, hold))
    return np.array(found)


def saturations(time: ArrayLike, values: ArrayLike, low: float, high: float, within: float = 0.0) -> FloatArray:
    """(n, 2) first and last stamps of each stretch of samples at a limit or beyond [s].

    Args:
        within: how near a limit a sample counts as at it [unit].

    Raises:
        TraceError: `low` is not below `high`, too.
    """
    t, y = checked(time, values)
    pairs = [(t[first], t[after - 1]) for first, after in runs(_at_limit(y, low, high, within))]
    return np.array(pairs).reshape(-1, 2)


def saturated_share(time: ArrayLike, values: ArrayLike, low: float, high: float, within: float = 0.0) -> float:
    """Share of the time that the signal is at a limit or beyond, each sample held to the next one [1].

    Raises:
        TraceError: `low` is not below `high`, too; or there are fewer than two samples.
    """
    t, y = checked(time, values, fewest=2)
    return float(np.sum(np.diff(t)[_at_limit(y, low, high, within)[:-1]]) / (t[-1] - t[0]))


def changes(time: ArrayLike, values: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """(n,) stamps of the first sample of each new value [s], and (n,) these values: of a signal that counts or names
    modes, and holds in between."""
    t, y = checked(time, values)
    rows = np.flatnonzero(y[1:] != y[:-1]) + 1
    return t[rows], y[rows]


def _passage(t: FloatArray, y: FloatArray, last: int, after: int, level: float, hold: bool) -> float:
    """When the signal leaves the level for good between sample `last` before it and `after` beyond it [s]."""
    beyond = last + 1
    while beyond < after and y[beyond] == level:
        beyond += 1
    return float(t[beyond]) if hold else meets(t, y, beyond - 1, level)


def _at_limit(y: FloatArray, low: float, high: float, within: float) -> BoolArray:
    if not low < high:
        raise TraceError("limits", f"{low:g} is not below {high:g}", "give the lower one first")
    return np.asarray((y <= low + within) | (y >= high - within))
