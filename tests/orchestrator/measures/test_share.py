"""Shares: their intervals are those of SciPy's exact binomial test, and chances those of the distribution."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, binomtest

from orchestrator.measures import chance_of_fewer, share_interval


@pytest.mark.slow
@given(st.integers(1, 5000), st.data())
def test_an_interval_is_that_of_the_exact_binomial_test(count: int, data: st.DataObject) -> None:
    held = data.draw(st.integers(0, count))
    known = binomtest(held, count).proportion_ci(0.95, method="exact")
    assert share_interval(held, count) == pytest.approx((known.low, known.high), abs=1e-9)


@given(st.integers(1, 200), st.floats(0, 1), st.data())
def test_fewer_hold_as_often_as_the_binomial_distribution_says(count: int, share: float, data: st.DataObject) -> None:
    needed = data.draw(st.integers(1, count))
    assert chance_of_fewer(needed, count, share) == pytest.approx(binom.cdf(needed - 1, count, share), abs=1e-12)
