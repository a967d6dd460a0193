"""Marks: what stamps tell of samples that are missing or came late."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.marks import Mark, cycle_of, gaps, missing, runs, union


@given(st.lists(st.tuples(st.integers(0, 30), st.integers(0, 9)), max_size=12))
def test_a_union_covers_what_its_stretches_cover_and_its_parts_are_apart(given: list[tuple[int, int]]) -> None:
    stretches = np.array([(begin, begin + length) for begin, length in given], float).reshape(-1, 2)
    parts = union(stretches)
    instants = np.arange(-1.0, 41.0)
    found, expected = (
        ((some[:, :1] <= instants) & (instants <= some[:, 1:])).any(axis=0) for some in (parts, stretches)
    )
    assert (found == expected).all()
    assert (parts[1:, 0] > parts[:-1, 1]).all()


@given(st.lists(st.booleans(), max_size=20))
def test_runs_are_the_flags_and_nothing_else(flags: list[bool]) -> None:
    found = [row for first, after in runs(np.array(flags, bool)) for row in range(first, after)]
    assert found == [row for row, flag in enumerate(flags) if flag]


@given(lost=st.sets(st.integers(1, 298), max_size=60), seed=st.integers(0, 99))
def test_as_many_are_missing_as_were_lost_whatever_the_jitter(lost: set[int], seed: int) -> None:
    time = 0.01 * np.arange(300) + np.random.default_rng(seed).uniform(0, 0.002, 300)
    steps = np.diff(np.delete(time, sorted(lost)))
    assert missing(steps, 0.01).sum() == len(lost)


@pytest.mark.parametrize("paused", [0.0, 0.004])
def test_stamps_that_come_late_and_in_haste_are_late_and_none_is_missing(paused: float) -> None:
    """Nobody read for 1.5 s; then all that had waited came at once, or in two bursts."""
    time = 0.01 * np.arange(1000)
    late = np.where((time > 5) & (time < 6.5), 6.495 + 1e-6 * np.arange(1000), time)
    late[600:650] += paused
    assert missing(np.diff(late), 0.01).sum() == 0
    ((kind, first, last),) = gaps(late, cycle_of(late))
    assert kind == "late" and late[first] == pytest.approx(5.0) and 6.49 < late[last] < 6.52


def test_a_gap_reaches_from_the_last_sample_before_to_the_first_after() -> None:
    time = np.delete(0.01 * np.arange(1000), range(300, 320))
    ((kind, first, last),) = gaps(time, cycle_of(time))
    assert (kind, time[first], time[last]) == ("gap", pytest.approx(2.99), pytest.approx(3.2))


def test_samples_that_come_when_they_like_have_no_gaps() -> None:
    time = np.cumsum(np.random.default_rng(0).exponential(0.1, 500))
    assert cycle_of(time) is None and not list(gaps(time, None))


def test_a_few_lost_samples_in_a_row_are_no_gap() -> None:
    time = np.delete(0.01 * np.arange(1000), [100, 300, 301, 302])
    assert not list(gaps(time, 0.01))


def test_a_mark_says_what_where_and_of_which_signals() -> None:
    mark = Mark("gap", 5.0396, 7.0495, ("torque",))
    assert str(mark) == "gap of torque from 5.0396 to 7.0495 s"
    assert mark.concerns(["torque", "speed"]) and not mark.concerns(["speed"])
    assert Mark("excluded", 0, 1).concerns(["speed"])
