"""Stretches of a recording that are not to be trusted, as plain values; and what its stamps alone tell of such."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fmus import words
from orchestrator.trace import BoolArray, FloatArray

Seen = Literal["gap", "late", "checksum", "counter", "range", "nan", "safe"]
Kind = Seen | Literal["excluded"]
"""What is seen in a recording, and what a study excludes of it."""

WORDS: dict[Kind, str] = {
    "gap": "gap",
    "late": "late stamps",
    "checksum": "wrong checksums",
    "counter": "a counter that stands still",
    "range": "values outside the range",
    "nan": "values that are not finite",
    "safe": "safe values",
    "excluded": "excluded",
}

LONG = 5.0  # cycles without a sample that make a gap
UNSURE = 20.0  # the same where nobody tells the cycle
LATE = 0.1  # [s] without a sample, though none is missing, that make stamps late ones
FEWEST = 20  # samples that tell a cycle
SHOWN = 3  # signals of a mark that its text names
EVEN = 2.0  # medians that 95 % of the steps of an even recording are below


@dataclass(frozen=True)
class Mark:
    """A stretch that is not to be trusted.

    Attributes:
        start, stop: in the time of the recording [s]; what is at either is sound.
        signals: those that it is about; all where there are none.
    """

    kind: Kind
    start: float
    stop: float
    signals: tuple[str, ...] = ()

    def concerns(self, names: Collection[str]) -> bool:
        """Whether it is about one of these signals."""
        return not self.signals or not set(self.signals).isdisjoint(names)

    def __str__(self) -> str:
        whose = f" of {words.listed(self.signals, SHOWN)}" if self.signals else ""
        return f"{WORDS[self.kind]}{whose} from {self.start:.6g} to {self.stop:.6g} s"


def listed(marks: Sequence[Mark], most: int = 3) -> str:
    """The longest marks, in words."""
    return words.listed([str(mark) for mark in sorted(marks, key=lambda mark: mark.start - mark.stop)], most)


def union(stretches: FloatArray) -> FloatArray:
    """(n, 2) begins and ends of the stretches (N, 2) together: ascending, apart from each other."""
    if not len(stretches):
        return np.empty((0, 2))
    ordered = stretches[np.argsort(stretches[:, 0], kind="stable")]
    stops = np.maximum.accumulate(ordered[:, 1])
    first = np.append(True, ordered[1:, 0] > stops[:-1])
    return np.column_stack([ordered[first, 0], stops[np.append(first[1:], True)]])


def runs(flags: BoolArray) -> Iterator[tuple[int, int]]:
    """First row of each run of flags, and the row after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    return ((int(first), int(after)) for first, after in edges.reshape(-1, 2))


def cycle_of(time: FloatArray) -> float | None:
    """The cycle of evenly recorded stamps (K,) [s]; None where they are too few, or come when they like."""
    steps = np.diff(time)
    if len(steps) < FEWEST:
        return None
    median, most = np.quantile(steps, [0.5, 0.95])
    return float(median) if 0 < most <= EVEN * median else None


def missing(steps: FloatArray, cycle: float) -> FloatArray:
    """(K,) samples that are missing in each step [s]; what those after it make up for was only late."""
    wide = steps > 1.5 * cycle
    if not wide.any():
        return np.zeros(len(steps))
    ahead = np.cumsum(steps / cycle - 1.0)  # of the stamps over even ones, in cycles
    soon = np.min(np.lib.stride_tricks.sliding_window_view(np.append(ahead, np.full(4, np.inf)), 5), axis=1)
    for row, after in _long(steps, cycle):
        soon[row] = ahead[row:after].min()
    absent = np.rint(soon - ahead + steps / cycle - 1.0)
    return np.where(wide, np.maximum(absent, 0.0), 0.0)


def caught_up(steps: FloatArray, cycle: float) -> Iterator[tuple[int, int]]:
    """Each step (K,) [s] longer than `LONG` cycles, and the one with which all that came late has come."""
    ahead = np.cumsum(steps / cycle - 1.0)
    for row, after in _long(steps, cycle):
        near = ahead[row:after]
        yield row, row + int(np.argmax(near <= near.min() + 0.5))


def _long(steps: FloatArray, cycle: float) -> Iterator[tuple[int, int]]:
    """Steps longer than `LONG` cycles, and up to where what they delayed may come."""
    rows = np.flatnonzero(steps > LONG * cycle)
    most = rows + np.minimum(np.rint(steps[rows] / cycle) + LONG, len(steps))
    for row, after in zip(rows, np.minimum(np.append(rows[1:], len(steps)), most), strict=True):
        yield int(row), max(int(after), int(row) + 1)


def expected(time: FloatArray, cycle: float | None) -> float | None:
    """What to expect between two stamps (K,) [s]: the cycle that is known, unless most come slower, or that of even
    stamps; None where they come when they like."""
    if cycle is None or len(time) < 2:
        return cycle or cycle_of(time)
    return max(cycle, float(np.median(np.diff(time))))


def gaps(time: FloatArray, cycle: float | None, longest: float = LONG) -> Iterator[tuple[Kind, int, int]]:
    """Where samples are missing for long, or were stamped late: the kind, the last row before and the first good after.

    Args:
        time: (K,) stamps, ascending [s].
        cycle: at which samples should come [s]; nothing is told without one.
        longest: cycles without a sample that are no gap, `LONG` or more.
    """
    if not cycle:
        return
    steps = np.diff(time)
    absent = missing(steps, cycle)
    for row, last in caught_up(steps, cycle):
        lost = absent[row] >= LONG - 1
        if steps[row] > longest * cycle and (lost or steps[row] > LATE):
            yield "gap" if lost else "late", row, last + 1


def of_stamps(time: FloatArray) -> Iterator[Mark]:
    """What the stamps (K,) [s] alone tell, of a recording whose cycle is not known but seen."""
    for kind, first, last in gaps(time, cycle_of(time), UNSURE):
        yield Mark(kind, float(time[first]), float(time[last]))
