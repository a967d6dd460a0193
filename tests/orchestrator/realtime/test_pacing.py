"""Deadlines: where they are, that waiting ends, what is counted as late, and that nothing grows."""

from __future__ import annotations

import ctypes
import gc
import os
import platform
import struct
import sys
import threading
import time
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.json_document import document_of
from orchestrator.realtime.background import Background
from orchestrator.realtime.deadlines import Deadlines
from orchestrator.realtime.pacing import Pace, quiet
from orchestrator.realtime.priority import short_time_slices
from orchestrator.realtime.stopping import Stop

DAY = 86_400_000  # steps of 1 ms


@given(number=st.integers(0, 40 * DAY), step=st.sampled_from([Fraction(1, 1000), Fraction(1, 300), Fraction(1, 7)]))
def test_a_deadline_is_exact_however_long_it_is_since_the_start(number: int, step: Fraction) -> None:
    exact = Fraction(1234567, 1000) + number * step
    assert abs(Fraction(Pace(1234.567, step).deadline(number)) - exact) < Fraction(1, 10**6)


def test_waiting_ends_at_the_deadline_and_not_before() -> None:
    pace, stop = Pace(time.monotonic(), Fraction(1, 200)), Stop()
    for number in range(1, 20):
        now = pace.wait(pace.deadline(number), stop)
        assert now >= pace.deadline(number)


def test_a_deadline_that_has_passed_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(seconds: float) -> None:
        pytest.fail(f"slept for {seconds} s")

    monkeypatch.setattr(time, "sleep", never)
    begun = time.monotonic()
    assert Pace(begun - 10, Fraction(1, 10)).wait(begun - 5, Stop()) >= begun


def test_the_wish_to_end_ends_waiting_before_the_deadline() -> None:
    stop, begun = Stop(), time.monotonic()
    timer = threading.Timer(0.05, lambda: setattr(stop, "requested", True))
    timer.start()
    deadline = begun + 300
    assert Pace(begun, Fraction(300)).wait(deadline, stop) < deadline
    timer.join()


def test_late_steps_are_those_that_begin_more_than_a_millisecond_after_their_deadline() -> None:
    deadlines = Deadlines(0.005)
    for lateness in (0.0, 0.0005, 0.001, 0.0011, 0.004, 0.0051):
        deadlines.begun(lateness)
    assert (deadlines.late, deadlines.overrun) == (3, 1)
    assert deadlines.on_time == 0.5
    document = document_of(deadlines)
    assert document["lateness"]["worst"] == 0.0051
    assert document["lateness"]["median"] == pytest.approx(0.001, rel=0.05)
    assert "50 % of them begun within 1 ms of their deadline (3 late, 1 by more than a step)" in deadlines.sentence()


def test_statistics_of_a_day_take_no_more_memory_than_those_of_a_second() -> None:
    deadlines = Deadlines(0.001)
    bins = len(deadlines.lateness._bins)
    for number in range(20_000):
        deadlines.begun(1e-5 * (number % 1000))
    assert len(deadlines.lateness._bins) == bins
    assert sum(count for _, _, count in deadlines.lateness.bins()) == 20_000


def test_no_steps_have_statistics_too() -> None:
    assert document_of(Deadlines(0.001))["on_time"] == 1.0
    assert "0 steps" in Deadlines(0.001).sentence()


def test_quiet_gives_everything_back() -> None:
    interval, frozen = sys.getswitchinterval(), gc.get_freeze_count()
    with pytest.raises(KeyError), quiet():
        assert sys.getswitchinterval() < interval and gc.get_freeze_count() > frozen
        raise KeyError
    assert (sys.getswitchinterval(), gc.get_freeze_count()) == (interval, 0)


@pytest.mark.skipif(sys.platform != "linux", reason="Linux has time slices of chosen length")
def test_short_time_slices_leave_priority_and_policy_as_they_are() -> None:
    def about() -> tuple[int, int]:
        return os.getpriority(os.PRIO_PROCESS, 0), os.sched_getscheduler(0)

    before, usual = about(), time_slice()
    with short_time_slices():
        inside: list[int] = []
        thread = threading.Thread(target=lambda: inside.append(time_slice()))
        thread.start()
        thread.join()
        assert about() == before
        assert time_slice() == inside[0] <= max(usual, 100_000)
    assert (about(), time_slice()) == (before, usual)


def time_slice() -> int:
    """Length of this thread's time slices [ns], 0 where Linux does not say."""
    attributes = ctypes.create_string_buffer(48)
    ctypes.CDLL(None).syscall({"x86_64": 315, "aarch64": 275}[platform.machine()], 0, attributes, 48, 0)
    return int(struct.unpack_from("=Q", attributes, 24)[0])


def test_work_in_the_background_is_done_in_order_and_to_the_end() -> None:
    done: list[int] = []
    with Background() as background:
        for number in range(500):
            background.do(lambda number=number: done.append(number))  # type: ignore[misc]
    assert done == list(range(500))


def test_a_failure_in_the_background_comes_to_who_brings_the_next_job_or_to_the_end() -> None:
    def fail() -> None:
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"), Background() as background:
        background.do(fail)
    with pytest.raises(OSError, match="disk full"), Background() as background:
        background.do(fail)
        for _ in range(1000):
            background.do(lambda: time.sleep(0.001))
