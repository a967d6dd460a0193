"""What was sent waits for as long as others leave the bus no time."""

from __future__ import annotations

import math

from hypothesis import example, given, settings
from hypothesis import strategies as st

from orchestrator.can.live.backlog import Backlog
from orchestrator.can.live.bus import BusSettings, occupied
from tests.support.can.coupling_samples import frame

OURS, THEIRS = frame(0x100, bytes(8)), frame(0x001, bytes(8))


def busy(backlog: Backlog, begin: int, end: int, others: int, ours: int = 1) -> None:
    """So many frames in every millisecond."""
    for tick in range(begin, end):
        for _ in range(others):
            backlog.heard(THEIRS)
        for _ in range(ours):
            backlog.sent(OURS, tick * 1e-3)
        backlog.look(tick * 1e-3)


def test_frames_get_out_where_others_leave_time_and_wait_where_they_do_not() -> None:
    backlog = Backlog(BusSettings("slcan", "port", 500_000))
    busy(backlog, 0, 1000, others=2)
    assert backlog.age() <= 0.008  # its own time, the longest frame's and a look's, in what four fifths of load leave
    busy(backlog, 1000, 2000, others=5)
    assert backlog.age() > 0.9 and not backlog.empty()
    busy(backlog, 2000, 2400, others=0, ours=0)
    assert backlog.empty() and backlog.age() == 0


@settings(max_examples=60, deadline=None)
@example(load=1.0, late=0.03, look=0.002, pause=0.5)
@given(
    load=st.floats(0, 1),
    late=st.sampled_from([0.001, 0.01, 0.03, 0.06]),
    look=st.sampled_from([0.002, 0.02]),
    pause=st.floats(0, 0.5),
)
def test_no_frame_is_out_before_it_is_and_none_waits_where_there_is_room(
    load: float, late: float, look: float, pause: float
) -> None:
    """Others are heard in bunches, `late` apart; ours, of the lowest priority, are given every 10 ms; nobody looks for
    a while."""
    setting = BusSettings("slcan", "port", 500_000)
    backlog, each, end = Backlog(setting), occupied(OURS, setting), 1.5
    events: list[tuple[float, str]] = [(number * 0.01, "given") for number in range(150)]
    theirs, ours, free, out = 0.0, 0.0, 0.0, list[float]()
    while free < end:
        if load and theirs <= free:
            theirs, free = theirs + each / load, free + each
            events.append((math.ceil(free / late) * late, "heard"))
        elif ours <= free:
            ours, free = ours + 0.01, free + each
            out.append(free)
        else:
            free = min(theirs, ours) if load else ours
    events.sort()
    now, worst, taken = 0.0, 0.0, 0
    while now < end:
        now = now + look if not 0.5 <= now < 0.5 + pause else 0.5 + pause
        while events and events[0][0] <= now:
            if events.pop(0)[1] == "heard":
                backlog.heard(THEIRS)
            else:
                backlog.sent(OURS, now)
                taken += 1
        backlog.look(now)
        worst = max(worst, backlog.age())
        assert taken - backlog.waiting().total() <= sum(end <= now for end in out)
    if load <= 0.7:
        bunch = pause / 0.01 + 2  # given at once after the pause, and what may just pass
        apart = max(look, min(pause, 0.03))  # a short pause passes for a look like others
        assert worst <= (bunch * each + apart) / (1 - load) + late + 2 * apart
    if load == 1:
        assert worst > 1.3


def test_what_the_adapter_has_forgotten_does_not_wait() -> None:
    backlog = Backlog(BusSettings("slcan", "port", 500_000))
    busy(backlog, 0, 300, others=4)
    assert backlog.waiting()[(0x100, False)] > 100
    backlog.clear()
    assert backlog.empty()
    busy(backlog, 300, 301, others=4)
    busy(backlog, 301, 600, others=4, ours=0)
    assert backlog.waiting().total() == 1 and backlog.age() > 0.15


def test_nothing_is_estimated_without_a_bit_rate() -> None:
    backlog = Backlog(BusSettings("slcan", "port"))
    busy(backlog, 0, 1000, others=9)
    assert backlog.empty() and backlog.age() == 0
