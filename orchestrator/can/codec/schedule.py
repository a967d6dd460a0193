"""The even schedule that a message's sender keeps, recovered from stamps that came late by varying times.

A sender with a timer of its own sends at even times; buses, adapters and computers delay each frame a little, now and
then a lot. The message's counter tells which frame is which, so that a straight line below the stamps is left.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmus.errors import TraceError
from orchestrator.can.codec.merging import Series
from orchestrator.can.database.bus import LogDatabase
from orchestrator.trace import FloatArray

FEWEST = 20  # frames of a stretch that a line is put through
BLOCKS = 2000  # parts of a stretch of which the earliest frame counts


@dataclass(frozen=True)
class MessageSchedule:
    """What was found of one message.

    Attributes:
        period: median over the stretches [s].
        late: median and largest distance of the stamps from the schedule [s].
        left: frames that keep their stamps, as they are too few together.
    """

    message: str
    period: float
    late: tuple[float, float]
    left: int

    def __str__(self) -> str:
        text = (
            f"{self.message}: stamps put on a schedule of {1e3 * self.period:.6g} ms; they were off by "
            f"{1e3 * self.late[0]:.3g} ms in the median, {1e3 * self.late[1]:.3g} ms at most"
        )
        return f"{text}; {self.left} frames too far from others keep theirs" if self.left else text


@dataclass(frozen=True)
class CounterSignal:
    """The counter of a message: its public name, and how many values it has."""

    name: str
    modulus: int


def counter_of(log: LogDatabase, message: str) -> CounterSignal:
    """The counter of a message.

    Raises:
        TraceError: it has none, so that its frames cannot be told from each other.
        DatabaseError: there is no such message.
    """
    database, spec = log.message(message)
    if spec.protection is None or not spec.protection.counter:
        raise TraceError(
            database.path, f"{message} has no counter, so its schedule cannot be recovered", "leave it out of `steady`"
        )
    name = database.public_name(spec, spec.signal(spec.protection.counter))
    return CounterSignal(name, spec.protection.modulus)


def on_schedule(series: Series, message: str, counter: FloatArray, modulus: int) -> tuple[Series, MessageSchedule]:
    """The series with the stamps of its sender's schedule, each stretch without long gaps by itself.

    Args:
        series: stamps (K,) ascending [s].
        counter: (K,) the message's counter.
        modulus: its number of values.
    """
    time, residuals, periods, left = series.time.copy(), [np.zeros(0)], [], 0
    for stretch in _stretches(series.time, modulus):
        stamps = series.time[stretch]
        if len(stamps) < FEWEST:
            left += len(stamps)
            continue
        count = np.concatenate(([0.0], np.cumsum(np.mod(np.diff(counter[stretch]), modulus))))
        period, line = _line(count, stamps)
        time[stretch] = line
        periods.append(period)
        residuals.append(np.abs(stamps - line))
    late = np.concatenate(residuals)
    found = MessageSchedule(
        message,
        float(np.median(periods)) if periods else 0.0,
        (float(np.median(late)), float(late.max())) if len(late) else (0.0, 0.0),
        left,
    )
    return Series(time, series.values, series.units), found


def _stretches(time: FloatArray, modulus: int) -> Iterator[slice]:
    """Runs of frames without a gap in which the counter could have gone round."""
    if len(time) < 2:
        yield slice(0, len(time))
        return
    longest = 0.5 * modulus * float(np.median(np.diff(time)))
    breaks = np.flatnonzero(np.diff(time) > longest) + 1
    for first, last in zip([0, *breaks.tolist()], [*breaks.tolist(), len(time)], strict=True):
        yield slice(first, last)


def _line(count: FloatArray, stamps: FloatArray) -> tuple[float, FloatArray]:
    """Slope and values of the highest line that no stamp lies below: a frame may be late, but not early.

    Of all lines below, the one with the least sum of distances, the edge of the lower hull above the mean count (Moon,
    Skelly and Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM 1999).
    """
    rows = _earliest(count, stamps)
    hull: list[int] = []
    for row in rows.tolist():
        while len(hull) > 1 and _turns_down(count, stamps, hull[-2], hull[-1], row):
            hull.pop()
        hull.append(row)
    right = min(max(1, int(np.searchsorted(count[hull], count.mean()))), len(hull) - 1)
    a, b = hull[right - 1], hull[right]
    slope = float((stamps[b] - stamps[a]) / (count[b] - count[a]))
    return slope, stamps[a] + slope * (count - count[a])


def _earliest(count: FloatArray, stamps: FloatArray) -> NDArray[np.intp]:
    """Rows of the earliest frame of each of `BLOCKS` parts, and the first and last row: all that the hull can touch,
    but for curvature within a part."""
    ahead = stamps - count * float(stamps[-1] - stamps[0]) / float(count[-1] - count[0])
    begins = np.unique(np.linspace(0, len(count), BLOCKS + 1).astype(np.intp)[:-1])
    minima = np.minimum.reduceat(ahead, begins)
    part = np.repeat(np.arange(len(begins)), np.diff(np.append(begins, len(count))))
    earliest = np.flatnonzero(ahead == minima[part])
    return np.unique(np.concatenate(([0], earliest, [len(count) - 1])))


def _turns_down(x: FloatArray, y: FloatArray, a: int, b: int, c: int) -> bool:
    """Whether b lies on or above the straight line from a to c."""
    return bool((y[b] - y[a]) * (x[c] - x[a]) >= (y[c] - y[a]) * (x[b] - x[a]))
