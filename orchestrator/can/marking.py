"""Where in the frames of one message what came is not to be trusted: gaps, late stamps, and what a receiver rejects."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from orchestrator.marks import LONG, Kind, Mark, cycle_of, expected, gaps, missing, runs, union
from orchestrator.trace import BoolArray, FloatArray

Rows = NDArray[np.intp]


@dataclass
class Absences:
    """Counts the frames that are missing, batch after batch.

    Attributes:
        cycle: of the message [s], None where it is not known.
        modulus: values of its counter before it goes round, 0 without one; only beyond half of them stamps have a say.
    """

    cycle: float | None
    modulus: int = 0
    _latest: float | None = None
    _last: _LastGap | None = None

    def feed(self, time: FloatArray, by_counter: FloatArray) -> int:
        """How many are missing before these frames (K,); below 0 where earlier ones turn out to have been late.

        Args:
            by_counter: how many the counter tells of, -1 where it stands still, as it does when it has gone round.
        """
        steps = np.diff(time, prepend=time[0] if self._latest is None else self._latest)
        self._latest = float(time[-1])
        if not self.cycle:
            return int(np.maximum(by_counter, 0.0).sum())
        wide = steps > max(0.5 * self.modulus, 1.5) * self.cycle
        by_counter = np.where(wide, by_counter, np.maximum(by_counter, 0.0))
        told = steps - by_counter * self.cycle  # once those that the counter tells of are taken off
        absent = missing(told, self.cycle)
        if self._last is None and not absent.any():
            return int(np.maximum(by_counter, 0.0).sum())
        ahead = np.cumsum(told / self.cycle - 1.0)
        unsure = wide & (absent > 0)
        beyond = np.where(unsure, self._rounds(absent), 0.0)
        found = np.flatnonzero(unsure)
        late = self._turned_out_late(ahead[: found[0]] if len(found) else ahead)
        if len(found):
            row = found[-1]
            most = told[row] / self.cycle + LONG - (len(steps) - row)
            lowest = ahead[row] - told[row] / self.cycle + 1.0 + absent[row] - ahead[-1]
            self._last = _LastGap(float(absent[row]), float(lowest), int(most))
        return int(np.where(beyond > 0, by_counter, np.maximum(by_counter, 0.0)).sum() + beyond.sum() - late)

    def _turned_out_late(self, ahead: FloatArray) -> float:
        """How many of those counted for the last gap were late, by how far ahead of even ones these stamps are."""
        gap = self._last
        if gap is None or not len(ahead):
            return 0.0
        reached = min(gap.lowest, float(np.min(ahead[: max(gap.most, 0)], initial=np.inf)))
        left, most = gap.absent + reached - gap.lowest, gap.most - len(ahead)
        self._last = _LastGap(left, reached - float(ahead[-1]), most) if most > 0 else None
        return float(self._rounds(gap.absent) - self._rounds(left))

    def _rounds(self, absent: FloatArray | float) -> FloatArray:
        """So many as whole rounds of the counter."""
        unit = max(self.modulus, 1)
        return np.asarray(unit * np.rint(np.maximum(absent, 0.0) / unit))


@dataclass(frozen=True)
class _LastGap:
    """What was found of the last gap, in whose wake frames may come late.

    Attributes:
        absent: frames that are missing by the cycle time, beyond what the counter tells.
        lowest: cycles by which the stamps since were least ahead, from where they are now.
        most: frames that may still come late.
    """

    absent: float
    lowest: float
    most: int


@dataclass
class Rejections:
    """Frames that a receiver rejects, by how many accepted ones came before them.

    Attributes:
        checksums: dropped for a wrong checksum.
        stale: whose counter stands still; these are among the accepted.
    """

    checksums: list[Rows] = field(default_factory=list)
    stale: list[Rows] = field(default_factory=list)

    def note(self, before: int, right: BoolArray, moved: BoolArray) -> None:
        """Note these frames (K,), of which those with a right checksum are accepted, after so many `before`."""
        if right.all() and moved.all():
            return
        places = before + np.cumsum(right) - right
        self.checksums.append(np.unique(places[~right]))
        self.stale.append(places[right & ~moved])

    def why(self, first: int, last: int) -> Kind | None:
        """For what frames between two accepted ones were rejected; None where none was."""
        if _any(self.checksums, first + 1, last + 1):
            return "checksum"
        return "counter" if _any(self.stale, first + 1, last) else None


def _any(places: Sequence[Rows], first: int, after: int) -> bool:
    """Whether one of ascending places lies there."""
    return any(np.searchsorted(rows, first) < np.searchsorted(rows, after) for rows in places)


@dataclass(frozen=True)
class FrameColumn:
    """A signal of the frames.

    Attributes:
        values: (K,) NaN where the frame does not hold it.
        outside: (K,) whether the value is beyond its range.
        multiplexed: whether frames without it are as they should be.
    """

    name: str
    values: FloatArray
    outside: BoolArray
    multiplexed: bool


def marks(
    time: FloatArray, columns: Sequence[FrameColumn], cycle: float | None, rejections: Rejections, end: float
) -> Iterator[Mark]:
    """What is not to be trusted of frames with these stamps (K,), ascending, in a recording until `end` [s]."""
    fresh = np.ones(len(time), np.bool_)
    for rows in rejections.stale:
        fresh[rows[rows < len(time)]] = False  # two databases may have called their messages alike
    known = expected(time, cycle)
    names = tuple(column.name for column in columns)
    told = set()
    for kind, first, last, stretch in _gaps(time, fresh, known, end):
        told.add(stretch)
        yield Mark(rejections.why(first, last) or kind, *stretch, names)
    for column in columns:
        finite = np.isfinite(column.values)
        if not finite.all():
            own = cycle_of(time[finite]) if column.multiplexed else known
            for kind, _, _, stretch in _gaps(time, finite, own, end):
                if stretch not in told:
                    yield Mark(kind if column.multiplexed else "nan", *stretch, (column.name,))
        for start, stop in union(_around(column.outside, np.append(time, end))).tolist():
            yield Mark("range", start, stop, (column.name,))


def _around(flags: BoolArray, stamps: FloatArray) -> FloatArray:
    """(n, 2) stretches from the sample before each run of flags (K,) to the one after it; (K + 1,) stamps [s]."""
    rows = np.array(list(runs(flags)), np.intp).reshape(-1, 2)
    return np.column_stack([stamps[np.maximum(rows[:, 0] - 1, 0)], stamps[rows[:, 1]]])


def _gaps(
    time: FloatArray, good: BoolArray, cycle: float | None, end: float
) -> Iterator[tuple[Kind, int, int, tuple[float, float]]]:
    """Gaps between good frames and up to the end: the frames on either side, and the stretch [s]."""
    rows = np.append(np.flatnonzero(good), len(time))
    stamps = np.append(time, end)[rows]
    for kind, first, last in gaps(stamps, cycle):
        yield kind, int(rows[first]), int(rows[last]), (float(stamps[first]), float(stamps[last]))
