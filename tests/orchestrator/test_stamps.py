"""What becomes of recordings whose stamps are not in order."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import TraceError
from orchestrator.stamps import ordered, unwrapped

STAMPS = st.lists(st.sampled_from([k * 0.25 for k in range(12)]), min_size=2, max_size=30).filter(
    lambda stamps: len(set(stamps)) > 1
)
INCREASING = st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=30, unique=True).map(sorted)


@given(STAMPS)
def test_ordered_stamps_increase_strictly_and_none_is_invented_or_lost(stamps: list[float]) -> None:
    trace, _ = ordered(stamps, {})
    assert trace.time.tolist() == sorted(set(stamps))


@given(STAMPS)
def test_of_samples_with_one_stamp_the_last_recorded_is_kept(stamps: list[float]) -> None:
    trace, _ = ordered(stamps, {"row": np.arange(len(stamps))})
    last = {stamp: row for row, stamp in enumerate(stamps)}
    assert trace["row"].tolist() == [last[stamp] for stamp in sorted(last)]


@given(STAMPS)
def test_stamp_report_counts_what_was_done(stamps: list[float]) -> None:
    trace, report = ordered(stamps, {})
    assert report.samples == len(stamps)
    assert report.repeated == len(stamps) - len(trace)
    assert report.backward == sum(b < a for a, b in pairwise(stamps))
    assert report.mean_step == pytest.approx(trace.duration / (len(trace) - 1))
    assert report.clean == (stamps == sorted(set(stamps)))


@given(INCREASING)
def test_an_ordered_recording_is_left_as_it_is(stamps: list[float]) -> None:
    values = np.sin(stamps)
    trace, report = ordered(stamps, {"a": values}, {"a": "rad"}, "clean")
    assert report.clean
    assert np.array_equal(trace.time, stamps)
    assert np.array_equal(trace["a"], values)
    assert (trace.unit("a"), trace.name) == ("rad", "clean")


def test_stamp_report_says_in_words_what_was_done() -> None:
    _, report = ordered([0.0, 0.2, 0.1, 0.1], {})
    assert str(report) == (
        "4 samples, mean step 0.1 s, largest gap 0.1 s, "
        "1 repeated stamps (the last sample of each kept), 1 stamps out of order (sorted)"
    )


@pytest.mark.parametrize(
    ("time", "problem"),
    [
        ([], "holds no samples"),
        ([1.0, 1.0, 1.0], "fewer than two distinct"),
        ([0.0, np.nan, 1.0], "time stamp 2 is nan"),
        ([0.0, 1.0, -np.inf], "time stamp 3 is -inf"),
        ([0.0, 1e300], "time stamp 2 is 1e"),
        ([[0.0, 1.0]], "shape"),
    ],
)
def test_stamps_that_are_no_times_are_refused(time: list[float], problem: str) -> None:
    with pytest.raises(TraceError, match=problem):
        ordered(time, {})


@pytest.mark.parametrize("rows", [2, 4])
def test_a_column_of_another_length_is_refused_not_cut(rows: int) -> None:
    with pytest.raises(TraceError, match=r"log\.a: has shape"):
        ordered([0.0, 1.0, 2.0], {"a": np.zeros(rows)}, name="log")


@pytest.mark.parametrize("shift", [0.0, 0.004])
def test_runs_whose_time_starts_anew_in_one_file_are_not_mixed(shift: float) -> None:
    time = 0.01 * np.arange(100)
    with pytest.raises(TraceError, match=r"two: its time starts anew at sample 101, from 0\.99 s to 0"):
        ordered(np.concatenate([time, time + shift]), {}, name="two")


def test_blocks_of_samples_that_came_late_are_sorted() -> None:
    time = 0.01 * np.arange(300)
    late = np.concatenate([time[:100], time[200:], time[100:200]])
    trace, report = ordered(late, {"a": late})
    assert np.array_equal(trace.time, time) and np.array_equal(trace["a"], time)
    assert report.backward == 1


@pytest.mark.parametrize(
    ("period", "unit"),
    [(2**32, 1e-6), (2**32, 1e-3), (2**32, 1e-9), (2**16, 1e-3), (2**16, 1.0), (86_400, 1.0)],
)
@pytest.mark.parametrize("signed", [False, True])
def test_a_counter_that_begins_anew_is_counted_on(period: int, unit: float, signed: bool) -> None:
    if signed and period == 86_400:
        return
    step = max(period // 5000, 1)
    true = period - 50 * step + step * np.arange(12_000)
    counted = (true + signed * period // 2) % period - signed * period // 2
    time, told = unwrapped(counted * unit)
    assert np.diff(time) == pytest.approx(np.full(11_999, step * unit), rel=1e-6)
    assert "begin anew" in told
    assert told.endswith(f"{np.count_nonzero(np.diff(counted) < 0)} times")


@pytest.mark.parametrize(
    "stamps",
    [
        [0.0, 0.1, 0.2, 0.15, 0.3],  # one came late
        [5.0, 6.0, 7.0, 0.0, 1.0, 2.0, 3.0],  # a buffer that goes round
        [60.0, 61.0, 62.0, 0.0, 1.0, 2.0, 3.0],  # a clock that was put back by something else
        [0.0, 20_000.0, 40_000.0, 60_000.0, 10_000.0],  # steps too wide to tell
    ],
)
def test_other_stamps_that_go_back_are_no_counter(stamps: list[float]) -> None:
    time, told = unwrapped(np.array(stamps))
    assert (time.tolist(), told) == (stamps, "")


def test_a_clock_that_was_put_back_is_refused() -> None:
    for first, second in [(np.arange(100) + 3600.0, np.arange(100.0)), (np.arange(20.0), np.arange(20.0))]:
        with pytest.raises(TraceError, match=f"starts anew at sample {len(first) + 1}"):
            ordered(np.append(first, second), {})


def test_what_a_buffer_that_goes_round_holds_is_sorted() -> None:
    trace, report = ordered(np.roll(np.arange(100.0), 37), {})
    assert np.array_equal(trace.time, np.arange(100.0))
    assert report.backward == 1
