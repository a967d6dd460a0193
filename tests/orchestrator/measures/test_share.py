"""Intervals of shares: those of SciPy's exact binomial test."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from orchestrator.measures import share_interval


@pytest.mark.slow
@given(st.integers(1, 5000), st.data())
def test_an_interval_is_that_of_the_exact_binomial_test(count: int, data: st.DataObject) -> None:
    held = data.draw(st.integers(0, count))
    known = binomtest(held, count).proportion_ci(0.95, method="exact")
    assert share_interval(held, count) == pytest.approx((known.low, known.high), abs=1e-9)
