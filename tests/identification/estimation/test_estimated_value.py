"""Intervals of values with an error that is noise, and one that is only bounded."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.special import ndtr, stdtrit

from identification.estimation.estimated_value import with_interval


@example(off=1.8623263147120563e-158, std=27.0, value=0.0)
@given(off=st.floats(0, 1e3), std=st.floats(1e-3, 1e3), value=st.floats(-10, 10))
def test_the_interval_holds_the_truth_in_95_percent_where_the_value_is_as_far_off_as_it_may(
    off: float, std: float, value: float
) -> None:
    half = with_interval(value, std, off=off).half
    assert half is not None
    assert ndtr((half - off) / std) - ndtr((-half - off) / std) == pytest.approx(0.95, abs=1e-6)


@given(share=st.floats(0, 1), off=st.floats(0, 20))
def test_it_holds_it_more_often_where_the_value_is_less_off(share: float, off: float) -> None:
    half = with_interval(0.0, 1.0, off=off).half
    assert half is not None
    assert ndtr(half - share * off) - ndtr(-half - share * off) >= 0.95 - 1e-6


def test_without_it_is_students() -> None:
    assert with_interval(2.0, 0.5, 4).ci95 == pytest.approx((2 - 0.5 * stdtrit(4, 0.975), 2 + 0.5 * stdtrit(4, 0.975)))
    assert with_interval(2.0, 0.5, 4).std == 0.5
    assert math.isinf(with_interval(2.0, math.inf, off=1.0).std)
    assert with_interval(2.0, 0.0, off=1.0).ci95 == (1.0, 3.0)
