"""Series of several messages become rows in which every signal is held, and none of them is lost."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from orchestrator.can.codec.merging import LateBegins, Merger, Series
from orchestrator.trace import Trace

streams = st.lists(st.tuples(st.integers(0, 30), st.sampled_from("AB"), st.sampled_from([1.0, 2.0, -3.5, math.nan])))


def known(value: float) -> float | None:
    return None if math.isnan(value) else float(value)


def by_hand(stream: list[tuple[int, str, float]]) -> list[tuple[float | None, ...]]:
    """Rows of the two signals at all stamps, walking through the stream in time."""
    held = {"A": math.nan, "B": math.nan}
    rows: dict[int, tuple[float, float, float]] = {}
    for stamp, name, value in sorted(stream, key=lambda sample: sample[0]):
        held[name] = held[name] if math.isnan(value) else value
        rows[stamp] = (float(stamp), held["A"], held["B"])
    return [tuple(map(known, row)) for row in rows.values()]


def series(stream: list[tuple[int, str, float]]) -> dict[str, Series]:
    found = {}
    for name in "AB":
        own = [sample for sample in stream if sample[1] == name]
        values = {name: np.array([sample[2] for sample in own])}
        found[name] = Series(np.array([float(sample[0]) for sample in own]), values, {name: "V"})
    return found


def rows_of(traces: list[Trace]) -> list[tuple[float | None, ...]]:
    columns = ((trace.time, trace["A"], trace["B"]) for trace in traces)
    return [tuple(map(known, row)) for trace in columns for row in zip(*trace, strict=True)]


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
    assert all((one[0] or 0.0) < (other[0] or 0.0) for one, other in pairwise(rows))
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


def test_signals_that_come_late_are_told_with_the_rows_they_are_empty_in() -> None:
    begins = LateBegins()
    for begin in (0, 500):
        time = np.arange(begin, begin + 500.0)
        late = np.where(time < 700, np.nan, 1.0)
        begins.feed(Trace(time, {"early": np.where(time < 1, np.nan, 1.0), "late": late}))
    assert begins.lines() == ["late is first seen at 700 s: it is empty in the 700 of 1000 rows before"]
