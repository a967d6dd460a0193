"""Frames keep their recorded times where their sender is late, and their distances where it is held up."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.can.sending.timetable import MADE_UP, Timetable

GAP = 0.005  # [s]


def sent(delays: list[float], speed: float = 1.0) -> tuple[list[float], list[float], Timetable]:
    """When frames were due at last, and sent, by a sender that every frame keeps for so long."""
    table, now = Timetable(7.0, 100.0, speed), 0.0
    due, sent = list[float](), list[float]()
    for k, delay in enumerate(delays):
        deadline = table.due(7.0 + GAP * speed * k)
        now = max(now, deadline)
        due.append(deadline + table.held_up(now - deadline))
        sent.append(now)
        now += delay
    return due, sent, table


@given(st.floats(0.0, 0.999 * MADE_UP), st.integers(0, 25))
def test_a_late_frame_does_not_delay_those_after_it(stall: float, place: int) -> None:
    delays = [0.0] * 30
    delays[place] = stall
    due, _, table = sent(delays)
    assert due == pytest.approx([100.0 + GAP * k for k in range(30)])
    assert table.pauses == 0 and table.paused == 0.0


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=60), st.sampled_from([0.5, 1.0, 8.0]))
def test_no_frame_goes_later_than_is_made_up_for_and_distances_are_only_stretched(
    delays: list[float], speed: float
) -> None:
    due, at, table = sent(delays, speed)
    gaps = [after - before for before, after in pairwise([100.0 - GAP, *due])]
    assert all(-1e-9 <= now - deadline <= MADE_UP + 1e-9 for deadline, now in zip(due, at, strict=True))
    assert all(gap >= GAP - 1e-9 for gap in gaps)
    assert table.paused == pytest.approx(sum(gaps) - GAP * len(gaps), abs=1e-9)


def test_a_clock_that_was_set_back_moves_later_stamps() -> None:
    table = Timetable(50.0, 0.0, 1.0)
    assert [table.due(stamp) for stamp in (50.0, 50.1, 0.0, 0.1)] == pytest.approx([0.0, 0.1, 0.1, 0.2])
    assert table.setbacks == 1
