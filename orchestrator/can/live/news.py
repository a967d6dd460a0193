"""What is told of a bus while it goes on: how it is, and, seldom enough, what is not as it should be."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import can

from orchestrator.can.slcan.bus import ERROR_CONTROLLER
from orchestrator.can.statistics import FrameStatistics

_LOOK = 0.25  # between two looks at the counts [s]
_FIRST, _MOST = 1.0, 60.0  # from a line to the next; twice as long each time while there is something to say [s]
_STATES = {0x01: "overflows of the adapter", 0x0C: "changes to error warning", 0x30: "changes to error passive"}


class News:
    """Says by how much counts of what is not as it should be have grown: at once, then less and less often.

    Args:
        say: takes lines for people.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._told: Counter[str] = Counter()
        self._next, self._pause, self._since = 0.0, _FIRST, 0.0

    def look(self, now: float, counts: Callable[[], Mapping[str, int]]) -> None:
        """Say what there is, where it is time to; it is `now` on a clock of the caller [s]."""
        if now < self._next:
            return
        latest = counts()
        grown = {what: count - self._told[what] for what, count in latest.items() if count > self._told[what]}
        self._next = now + _LOOK
        if not grown:
            if now - self._since > 2 * self._pause:
                self._pause = _FIRST
            return
        self._say(", ".join(f"{count:,} {what}" for what, count in grown.items()))
        self._told.update(grown)
        self._next, self._since = now + self._pause, now
        self._pause = min(2 * self._pause, _MOST)


class ErrorStates:
    """Counts what adapters say of their own state.

    Attributes:
        counts: words for it -> how often it was said.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def add(self, messages: Sequence[can.Message]) -> None:
        """Look at received frames."""
        for message in messages:
            if message.is_error_frame and message.arbitration_id & ERROR_CONTROLLER and len(message.data) > 1:
                for bits, what in _STATES.items():
                    self.counts[what] += bool(message.data[1] & bits)


def troubles(statistics: FrameStatistics) -> dict[str, int]:
    """Words for what was found in frames -> how often."""
    return {
        "error frames": statistics.errors,
        "frames missing": statistics.missing.total(),
        "wrong steps of message counters": statistics.counters.total(),
        "wrong checksums": statistics.checksums.total(),
        "frames too short": statistics.short.total(),
        "values that are not finite": statistics.not_finite.total(),
        "values outside their range": statistics.out_of_range.total(),
    }
