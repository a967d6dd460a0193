"""What a stream of frames had wrong with it: its stamps are made usable, every row is held, and all of it is told."""

from __future__ import annotations

import json
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orchestrator.can.codec.merging import Merger, Series
from orchestrator.can.codec.time_stamps import CONTINUED, StampRepair
from orchestrator.can.frames import Frames
from orchestrator.can.statistics import MOST, FrameStatistics
from orchestrator.trace import FloatArray, Trace


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


def test_a_gap_forward_is_no_fault() -> None:
    time = np.concatenate((REGULAR[:50], REGULAR[50:] + 3600.0))
    assert straightened(time, 7)[0].tolist() == time.tolist()
    assert straightened(time, 7)[1].clean


def test_slight_disorder_is_counted_across_batches() -> None:
    time = REGULAR.copy()
    time[[9, 10, 70, 71]] = time[[10, 9, 71, 70]]
    fixed, statistics = straightened(time, 10)
    assert fixed.tolist() == time.tolist()
    assert statistics.disordered == 2


streams = st.lists(st.tuples(st.integers(0, 30), st.sampled_from("AB"), st.sampled_from([1.0, 2.0, -3.5, math.nan])))


def by_hand(stream: list[tuple[int, str, float]]) -> list[tuple[float, float, float]]:
    """Rows of the two signals at all stamps, walking through the stream in time."""
    held = {"A": math.nan, "B": math.nan}
    rows: dict[int, tuple[float, float, float]] = {}
    for stamp, name, value in sorted(stream, key=lambda sample: sample[0]):
        held[name] = held[name] if math.isnan(value) else value
        rows[stamp] = (float(stamp), held["A"], held["B"])
    return [row for row in rows.values() if not math.isnan(row[1] + row[2])]


def series(stream: list[tuple[int, str, float]]) -> dict[str, Series]:
    found = {}
    for name in "AB":
        own = [sample for sample in stream if sample[1] == name]
        values = {name: np.array([sample[2] for sample in own])}
        found[name] = Series(np.array([float(sample[0]) for sample in own]), values, {name: "V"})
    return found


def rows_of(traces: list[Trace]) -> list[tuple[float, float, float]]:
    return [row for trace in traces for row in zip(trace.time, trace["A"], trace["B"], strict=True)]


@settings(max_examples=150, deadline=None)
@given(streams)
def test_rows_are_those_of_a_walk_through_the_whole_stream(stream: list[tuple[int, str, float]]) -> None:
    merger = Merger(["A", "B"])
    assert rows_of([merger.feed(series(stream)), merger.finish()]) == by_hand(stream)
    assert merger.statistics.late == 0


@settings(max_examples=150, deadline=None)
@given(streams, st.integers(1, 10))
def test_rows_of_batches_are_those_of_the_whole_where_disorder_is_within_patience(
    stream: list[tuple[int, str, float]], batch: int
) -> None:
    merger = Merger(["A", "B"], patience=30.5)
    traces = [merger.feed(series(stream[begin : begin + batch])) for begin in range(0, len(stream), batch)]
    assert rows_of([*traces, merger.finish()]) == by_hand(stream)


@settings(max_examples=100, deadline=None)
@given(streams, st.integers(1, 10))
def test_rows_of_batches_always_ascend_and_what_came_too_late_is_counted(
    stream: list[tuple[int, str, float]], batch: int
) -> None:
    merger = Merger(["A", "B"], patience=1.0)
    traces = [merger.feed(series(stream[begin : begin + batch])) for begin in range(0, len(stream), batch)]
    rows = rows_of([*traces, merger.finish()])
    assert all(one[0] < other[0] for one, other in pairwise(rows))
    ordered = all(one[0] <= other[0] for one, other in pairwise(stream))
    assert merger.statistics.late <= len(stream) and not (ordered and merger.statistics.late)
    assert not ordered or rows == by_hand(stream)


def test_rows_that_are_kept_back_do_not_pile_up() -> None:
    merger, most = Merger(["A"]), 0
    for begin in range(200):
        time = np.arange(begin, begin + 1, 0.01)
        merger.feed({"A": Series(time, {"A": time}, {})})
        most = max(most, sum(len(series) for series in merger._kept.values()))
    assert most <= 12


def test_a_flood_of_unknown_identifiers_is_counted_in_bounded_memory() -> None:
    statistics = FrameStatistics()
    for identifier in range(3 * MOST):
        statistics.add_unknown(identifier, True)
    assert len(statistics.unknown) == MOST + 1
    assert statistics.unknown.total() == 3 * MOST
    assert statistics.unknown["others"] == 2 * MOST


def test_the_census_is_a_line_for_each_kind_of_trouble_and_a_document_of_it_all() -> None:
    statistics = FrameStatistics(frames=10, errors=2)
    assert statistics.lines() == ["error frames: 2"]
    statistics.messages["State"] += 8
    statistics.missing.update(State=3, Command=1)
    statistics.add_setback(7, 5.0, 1.0)
    assert statistics.lines()[0] == "frames missing (estimated): 4 (State 3, Command 1)"
    assert not statistics.clean
    assert json.loads(json.dumps(statistics.document())) == {
        "frames": 10,
        "messages": {"State": 8},
        "errors": 2,
        "missing": {"State": 3, "Command": 1},
        "setback_count": 1,
        "setbacks": [{"frame": 7, "before": 5.0, "after": 1.0}],
    }
