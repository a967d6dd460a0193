"""Stamps of a log are made usable, and what was done to them is told."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.can.codec.time_stamps import CONTINUED, StampRepair, smallest_step, spread
from orchestrator.can.frames import Frames
from orchestrator.can.statistics import FrameStatistics
from orchestrator.trace import FloatArray


def stamped(time: FloatArray) -> Frames:
    count = len(time)
    flags = np.zeros(count, np.uint8)
    return Frames(time, np.zeros(count, np.uint32), flags, flags, flags, np.zeros((count, 8), np.uint8))


def straightened(time: FloatArray, batch: int) -> tuple[FloatArray, FrameStatistics]:
    clock = StampRepair(FrameStatistics())
    parts = [clock.straightened(stamped(time[begin : begin + batch])).time for begin in range(0, len(time), batch)]
    return np.concatenate(parts), clock.statistics


REGULAR = 1.7e9 + 0.01 * np.arange(100)


@pytest.mark.parametrize("batch", [100, 7, 1])
def test_stamps_in_order_stay_as_they_are(batch: int) -> None:
    time, statistics = straightened(REGULAR, batch)
    assert time.tolist() == REGULAR.tolist()
    assert statistics.clean


@pytest.mark.parametrize("batch", [100, 7, 1])
def test_after_a_clock_is_set_back_the_stamps_follow_on_and_its_place_is_told(batch: int) -> None:
    time = np.concatenate((REGULAR[:50], REGULAR[50:] - 3600.0))
    fixed, statistics = straightened(time, batch)
    assert fixed[50] == pytest.approx(REGULAR[49] + CONTINUED, abs=1e-6)
    np.testing.assert_allclose(np.diff(fixed[50:]), 0.01, atol=1e-6)
    assert statistics.setback_count == 1
    assert (statistics.setbacks[0].frame, statistics.setbacks[0].before, statistics.setbacks[0].after) == (
        50,
        time[49],
        time[50],
    )
    assert "clock jumped backwards at frame 50 from 1700000000.490000 s" in statistics.lines()[0]


@pytest.mark.parametrize("wrong", [0.0, -5.0, 9e9, 1e300, math.nan, -math.inf])
def test_a_single_stray_stamp_takes_the_one_before_and_moves_no_other(wrong: float) -> None:
    time = REGULAR.copy()
    time[30] = wrong
    fixed, statistics = straightened(time, 100)
    assert fixed[30] == time[29]
    assert np.delete(fixed, 30).tolist() == np.delete(REGULAR, 30).tolist()
    assert statistics.lines() == ["frames with a stray stamp, given the one before: 1"]


def test_stamps_that_are_never_times_begin_at_zero() -> None:
    fixed, statistics = straightened(np.full(5, math.nan), 2)
    assert fixed.tolist() == [0.0] * 5
    assert statistics.strays == 5


@pytest.mark.parametrize("batch", [100, 7, 1])
def test_a_gap_forward_is_left_as_it_is_and_told_where_it_is_long(batch: int) -> None:
    time = np.concatenate((REGULAR[:50], REGULAR[50:] + 30.0))
    assert straightened(time, batch)[0].tolist() == time.tolist()
    assert straightened(time, batch)[1].clean
    time[70:] += 3600.0
    fixed, statistics = straightened(time, batch)
    assert fixed.tolist() == time.tolist()
    told = "no frame came, or the clock was put forward, at frame 70 from 1700000030.690000 s to 1700003630.700000 s"
    assert statistics.lines() == [told]
    assert statistics.document()["silences"] == [{"frame": 70, "before": time[69], "after": time[70]}]


def test_slight_disorder_is_counted_across_batches() -> None:
    time = REGULAR.copy()
    time[[9, 10, 70, 71]] = time[[10, 9, 71, 70]]
    fixed, statistics = straightened(time, 10)
    assert fixed.tolist() == time.tolist()
    assert statistics.disordered == 2


@pytest.mark.parametrize("wrong", [0.0, 9e9])
def test_a_good_stamp_between_two_strays_that_are_alike_is_not_taken_for_one(wrong: float) -> None:
    time = REGULAR.copy()
    time[[30, 32]] = wrong, wrong + 1e-3
    fixed, statistics = straightened(time, 100)
    assert (fixed[30], fixed[31], fixed[32]) == (time[29], time[31], time[31])
    assert (statistics.strays, statistics.setback_count) == (2, 0)


def test_frames_of_one_tick_are_spread_over_it_and_none_is_lost() -> None:
    ticks = 1.7e9 + np.array([0.0, 0.015, 0.015, 0.015, 0.031, 0.031, 0.031])
    time, count = spread(ticks, None, None, smallest_step(ticks))
    assert count == 4
    np.testing.assert_allclose(time - 1.7e9, [0, 0.005, 0.01, 0.015, 0.021, 0.026, 0.031], atol=1e-6)


def test_two_frames_after_a_long_rest_stay_within_the_tick_before_their_stamp() -> None:
    time, _ = spread(np.array([0.0, 10.0, 10.0]), None, None, 1e-3)
    assert time.tolist() == [0.0, 10.0 - 0.5e-3, 10.0]


runs = st.lists(st.tuples(st.integers(0, 20), st.integers(1, 6)), min_size=1, max_size=12)


@given(runs, st.integers(1, 9))
def test_spread_stamps_increase_strictly_across_batches_within_a_tick(runs: list[tuple[int, int]], size: int) -> None:
    steps = np.cumsum([step + 1 for step, _ in runs])
    given_ = 1.7e9 + 0.01 * np.repeat(steps, [count for _, count in runs]).astype(float)
    found: list[float] = []
    for begin in range(0, len(given_), size):
        part = given_[begin : begin + size]
        last = given_[begin - 1] if begin else None
        found += spread(part, last, found[-1] if found else None, 0.01)[0].tolist()
    assert np.all(np.diff(found) > 0)
    assert np.abs(np.array(found) - given_).max() < 0.0101
