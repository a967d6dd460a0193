"""What was sent waits for as long as others leave the bus no time."""

from __future__ import annotations

from orchestrator.can.live.backlog import Backlog
from orchestrator.can.live.bus import BusSettings
from tests.support.coupling_samples import frame

OURS, THEIRS = frame(0x100, bytes(8)), frame(0x001, bytes(8))


def busy(backlog: Backlog, begin: int, end: int, others: int, ours: int = 1) -> None:
    """So many frames in every millisecond."""
    for tick in range(begin, end):
        for _ in range(others):
            backlog.heard(THEIRS)
        for _ in range(ours):
            backlog.sent(OURS)
        backlog.look(tick * 1e-3)


def test_frames_get_out_where_others_leave_time_and_wait_where_they_do_not() -> None:
    backlog = Backlog(BusSettings("slcan", "port", 500_000))
    busy(backlog, 0, 1000, others=2)
    assert backlog.age(1.0) == 0
    busy(backlog, 1000, 2000, others=5)
    assert backlog.age(2.0) > 0.9 and not backlog.empty()
    busy(backlog, 2000, 2400, others=0, ours=0)
    assert backlog.empty() and backlog.age(2.4) == 0


def test_nothing_is_estimated_without_a_bit_rate() -> None:
    backlog = Backlog(BusSettings("slcan", "port"))
    busy(backlog, 0, 1000, others=9)
    assert backlog.empty() and backlog.age(1.0) == 0
