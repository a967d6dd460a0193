"""Frames that came while nobody could look are of any age."""

from __future__ import annotations

import math
from typing import cast

import can
import pytest

from orchestrator.can.live import receiver
from orchestrator.can.live.receiver import Receiver
from tests.support.can.wiring import frame, number, wait_for

ERROR = can.Message(arbitration_id=0x04, is_error_frame=True, is_extended_id=False, dlc=8, data=bytes(8))


class _Paused:
    """A bus on which frames 1 and 2 come, and, in a pause, 3, an error frame and 4; then 5."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, pause: float) -> None:
        self.now = 0.0
        self._coming = [(0.0, frame(1)), (0.0, frame(2)), (pause, frame(3)), (0.0, ERROR), (0.0, frame(4))]
        self._coming += [(0.0, None), (0.01, frame(5))]
        monkeypatch.setattr(receiver, "_now", lambda: self.now)

    def recv(self, timeout: float) -> can.Message | None:
        seconds, message = self._coming.pop(0) if self._coming else (0.0, None)
        self.now += seconds
        return message


@pytest.mark.parametrize(
    ("pause", "most_late", "kept"),
    [(1.0, math.inf, [1, 2, 3, 4, 5]), (1.0, 0.5, [1, 2, 5]), (0.065, 0.05, [1, 2, 5]), (0.05, 0.05, [1, 2, 3, 4, 5])],
)
def test_frames_that_came_in_a_pause_are_dropped_where_only_fresh_ones_count(
    monkeypatch: pytest.MonkeyPatch, pause: float, most_late: float, kept: list[int]
) -> None:
    bus = _Paused(monkeypatch, pause)
    with Receiver(cast(can.BusABC, bus), 100, most_late=most_late) as received:
        wait_for(lambda: received.received == 6)
    taken = received.take()
    assert [number(message) for message in taken if not message.is_error_frame] == kept
    assert sum(message.is_error_frame for message in taken) == 1
    assert (received.late, received.dropped, received.pause_count) == (5 - len(kept), 0, pause > 0.5)
