"""Makes the time stamps of a stream of frames usable: one stray stamp, or a clock that is set back, must not spoil all.

What a logger writes may jump: by a restart, a synchronisation, a flipped bit. Everything done here is counted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orchestrator.can.frames import Frames
from orchestrator.can.statistics import FrameStatistics
from orchestrator.stamps import LATEST
from orchestrator.trace import BoolArray, FloatArray

SILENT = 60.0  # [s] without any frame that are told
JUMP = 1.0  # [s]: what frames may be out of order by, and more is a jump
CONTINUED = 1e-6  # [s] from the last stamp before a setback to the first after it


@dataclass
class StampRepair:
    """Stamps of a stream as a clock that does not jump backwards has them.

    A single frame whose stamp is more than `JUMP` away from both its neighbours' in one batch, or is no time, takes
    the stamp of the frame before. Where all that follows lies more than `JUMP` back, the clock was set back: those
    stamps are moved to follow on. Smaller disorder is left to sorting; forward jumps are gaps, and long ones are told.
    """

    statistics: FrameStatistics
    seen: int = 0
    first: float | None = None
    last: float | None = None
    moved: float = 0.0
    latest: float = -np.inf

    def straightened(self, frames: Frames) -> Frames:
        """The frames with such stamps, in the same order."""
        if len(frames) == 0:
            return frames
        time = self._without_strays(frames.time)
        self.first = float(time[0]) if self.first is None else self.first
        before = np.concatenate(([time[0] if self.last is None else self.last], time[:-1]))
        steps = time - before
        back = np.flatnonzero(steps < -JUMP)
        for row in np.flatnonzero(steps > SILENT).tolist():
            self.statistics.add_silence(self.seen + row, float(before[row]), float(time[row]))
        self.last = float(time[-1])
        if len(back) or self.moved:
            time = self._follow_on(time, before, back)
        self.seen += len(frames)
        self._count_disorder(time)
        return replace(frames, time=time)

    def _without_strays(self, time: FloatArray) -> FloatArray:
        wrong = ~(np.abs(time) < LATEST)
        if wrong.any():
            self.statistics.strays += int(np.count_nonzero(wrong))
            time = _filled(time, wrong, self.last)
        steps = np.diff(time, prepend=time[0] if self.last is None else self.last)
        far = np.abs(steps) > JUMP
        if not far.any():
            return time
        returns = np.abs(steps[:-1] + steps[1:]) <= JUMP
        stray = _every_other(np.append(far[:-1] & returns & far[1:], False))
        self.statistics.strays += int(np.count_nonzero(stray))
        return _filled(time, stray, self.last)

    def _follow_on(self, time: FloatArray, before: FloatArray, back: NDArray[np.intp]) -> FloatArray:
        moves = np.zeros(len(time))
        moves[back] = before[back] - time[back] + CONTINUED
        for row in back.tolist():
            self.statistics.add_setback(self.seen + row, float(before[row]), float(time[row]))
        moved = self.moved + np.cumsum(moves)
        self.moved = float(moved[-1])
        return time + moved

    def _count_disorder(self, time: FloatArray) -> None:
        highest = np.maximum.accumulate(np.concatenate(([self.latest], time)))
        self.statistics.disordered += int(np.count_nonzero(time < highest[:-1]))
        self.latest = float(highest[-1])


def smallest_step(time: FloatArray) -> float:
    """How far apart two different stamps (K,) in a row are at least; 0 where there is one only [s]."""
    steps = np.diff(time)
    return float(np.min(steps, initial=np.inf, where=steps > 0)) if (steps > 0).any() else 0.0


def spread(time: FloatArray, last: float | None, latest: float | None, tick: float) -> tuple[FloatArray, int]:
    """(K,) stamps of one message's frames, equal ones taken apart in the order of the frames; and how many were equal.

    A clock that ticks coarsely gives all frames since its last tick the same stamp: they are spread evenly over that
    tick, as far as the frame before leaves room; where it leaves none they follow each other by a microsecond.

    Args:
        last: stamp of the frame before them as the log has it, and `latest` where it was put; None where there is none.
        tick: of the clock [s].
    """
    equal = np.diff(time, prepend=np.nan if last is None else last) == 0
    if not equal.any():
        return time, 0
    first = np.flatnonzero(~np.concatenate(([False], equal[1:])))
    count = np.diff(np.append(first, len(time)))
    before = np.concatenate(([time[0] if latest is None else latest], time[first[1:] - 1]))
    room = time[first] - before
    step = np.where(room > 0, np.minimum(room / count, np.maximum(tick / count, CONTINUED)), CONTINUED)
    begin = np.where(room > 0, time[first] - (count - 1) * step, time[first])
    if equal[0] and latest is not None:
        begin[0], step[0] = latest + CONTINUED, CONTINUED
    place = np.arange(len(time)) - np.repeat(first, count)
    moved = np.repeat(begin, count) + place * np.repeat(step, count)
    return np.where(np.repeat(count > 1, count) | equal, moved, time), int(np.count_nonzero(equal))


def _every_other(flags: BoolArray) -> BoolArray:
    """The first, third, ... of each run of flags: a stamp between two strays that are alike looks like one itself."""
    rows = np.arange(len(flags))
    begun = np.maximum.accumulate(np.where(flags & ~np.concatenate(([False], flags[:-1])), rows, 0))
    return np.asarray(flags & ((rows - begun) % 2 == 0), np.bool_)


def _filled(time: FloatArray, wrong: BoolArray, last: float | None) -> FloatArray:
    """Stamps where the wrong ones take the last right one before; at the very beginning the first right one, or 0."""
    rows = np.where(wrong, -1, np.arange(len(time)))
    rows = np.maximum.accumulate(rows)
    right = time[~wrong]
    first = last if last is not None else float(right[0]) if len(right) else 0.0
    return np.where(rows < 0, first, time[rows])
