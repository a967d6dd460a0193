"""When the frames of a log are due, and what becomes of that where their sender is held up.

A machine is to see what was recorded: whole distances, values without jumps, counters without gaps. What was due while
the sender stood still, or its adapter had no room, is therefore neither made up for (a burst of old commands) nor left
out, but moved.
"""

from __future__ import annotations

MADE_UP = 0.05  # by which a frame may be late for later ones to keep their times, as steps of a coupling may be [s]


class Timetable:
    """Due times on the clock of `time.monotonic()`.

    Args:
        first: the first stamp; begin: when its frame is due; speed: how many times faster than recorded.

    Attributes:
        setbacks: stamps before the one of the frame before; such a frame is due at once.
        pauses: how often the sender was held up; paused: by how much that has moved what is due [s].
    """

    def __init__(self, first: float, begin: float, speed: float) -> None:
        self.begin, self._speed = begin, speed
        self._first, self._latest = first, first
        self.setbacks = self.pauses = 0
        self.paused = 0.0

    def due(self, stamp: float) -> float:
        """When the frame of a stamp is due [s]."""
        if stamp < self._latest:
            self.setbacks += 1
            self._first -= self._latest - stamp
        self._latest = stamp
        return self.begin + self.paused + (stamp - self._first) / self._speed

    def held_up(self, late: float) -> float:
        """By how much a frame that comes so late moves, and all after it; 0 where they keep their times [s]."""
        if late <= MADE_UP:
            return 0.0
        self.pauses += 1
        self.paused += late
        return late
