"""Two traces part where their difference is beyond what is tolerated, first there, and most elsewhere."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import TraceError
from orchestrator.measures import partings
from orchestrator.trace import Trace

TIME = np.linspace(0.0, 1.0, 101)


def trace(values: object, time: object = TIME) -> Trace:
    return Trace(np.asarray(time, dtype=float), {"y": np.asarray(values, dtype=float)}, {"y": "rad"}, "trace")


def test_the_first_and_the_largest_difference_are_told_with_their_times() -> None:
    (found,) = partings(trace(TIME), trace(TIME + 0.1 * np.maximum(TIME - 0.5, 0)), {"y": 0.0105})
    assert found.beyond and found.first == pytest.approx(0.61) and found.by == pytest.approx(0.011)
    assert (found.at, found.largest, found.times) == pytest.approx((1.0, 0.05, 0.05 / 0.0105))
    assert found.unit == "rad" and found.samples == (40, 101)


@pytest.mark.slow
@given(st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=30), st.floats(0, 10), st.floats(0, 10))
def test_they_part_exactly_where_one_difference_is_larger_than_the_tolerance(
    values: list[float], off: float, tolerance: float
) -> None:
    one = trace(values, np.arange(len(values)))
    other = trace(np.array(values) + off, np.arange(len(values)))
    (found,) = partings(one, other, {"y": tolerance})
    assert found.beyond == (found.largest > tolerance)
    assert found.largest == np.max(np.abs(np.array(values) - (np.array(values) + off)))


def test_a_finer_trace_is_compared_at_the_stamps_that_both_have() -> None:
    fine = np.linspace(0.0, 1.0, 201)
    held = np.floor(fine * 10 + 1e-9)  # steps, which lines between samples would not follow
    (found,) = partings(trace(held[::2]), trace(held, fine), {"y": 0.0})
    assert not found.beyond and found.largest == 0 and found.times == 0


def test_traces_without_a_common_stamp_are_compared_on_lines() -> None:
    (found,) = partings(trace(TIME), trace(TIME[:-1] + 0.005, TIME[:-1] + 0.005), {"y": 1e-9})
    assert not found.beyond


@pytest.mark.parametrize("odd", [math.nan, math.inf])
def test_what_is_no_number_in_one_alone_is_infinitely_off(odd: float) -> None:
    values = TIME.copy()
    values[40] = odd
    (found,) = partings(trace(TIME), trace(values), {"y": 1e9})
    assert found.first == pytest.approx(0.4) and found.largest == math.inf
    (same,) = partings(trace(values), trace(values), {"y": 0.0})
    assert not same.beyond


def test_traces_without_common_time_or_signal_are_refused() -> None:
    with pytest.raises(TraceError, match="no time in common"):
        partings(trace(TIME), trace(TIME, TIME + 2), {"y": 1.0})
    with pytest.raises(TraceError, match="no signal 'z'"):
        partings(trace(TIME), trace(TIME), {"z": 1.0})
