"""Time stamps that serial adapters put behind frames: milliseconds that begin again every minute, as times of day."""

from __future__ import annotations

import math

_MINUTE = 60_000  # [ms]
_LATE = 0.5  # by which most frames of a minute are read after their stamps, if these are no milliseconds [s]


class AdapterClock:
    """Lays an adapter's milliseconds to the time of day: as late as fits the frames of a minute, which are read later.

    Attributes:
        used: frames that got their stamp from it.
        odd: whether stamps have turned out to be something else, and are left out.
    """

    def __init__(self) -> None:
        self.used, self.odd = 0, False
        self._offset, self._turned = math.inf, math.inf
        self._delay = math.inf  # the least of this minute [s]
        self._late = self._count = 0  # frames of this minute

    def dated(self, milliseconds: int | None, now: float) -> float:
        """The time of a frame that was read `now`, which it is where the adapter says nothing better [s]."""
        if milliseconds is None or self.odd:
            return now
        self.odd = milliseconds >= _MINUTE
        if now - self._turned > 60:
            self._turn()
        offset = now - milliseconds / 1000
        if math.isinf(self._offset):
            self._offset = offset
        if math.isinf(self._turned):
            self._turned = now
        delay = math.remainder(offset - self._offset, 60)
        self._offset += min(delay, 0.0)
        self._delay = min(self._delay, max(delay, 0.0))
        self._late += delay > _LATE
        self._count += 1
        self.used += not self.odd
        return now if self.odd else now - max(delay, 0.0)

    def _turn(self) -> None:
        """Follow a clock that goes too slowly."""
        self.odd = self.odd or self._late > self._count / 2
        self._late = self._count = 0
        self._offset += 0.0 if math.isinf(self._delay) else self._delay
        self._turned = self._delay = math.inf
