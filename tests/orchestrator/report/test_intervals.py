"""Intervals are drawn where they are, in percent of their estimates, and say whether the truth is inside."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.report.columns import Columns
from orchestrator.report.intervals import IntervalChart, IntervalRow
from tests.support.tools.reports import EVIL


def places(html: str) -> list[tuple[float, float]]:
    """Ends of the bars [% of the scale's width]."""
    found = re.findall(r'<i class="k0[^"]*" style="left:([\d.]+)%;width:([\d.]+)%">', html)
    return [(float(left), float(left) + float(width)) for left, width in found]


def test_an_interval_lies_about_the_middle_on_a_scale_that_holds_the_widest() -> None:
    html = IntervalChart([IntervalRow("p1", 2.0, (1.9, 2.1), "kg"), IntervalRow("p2", -4.0, (-4.04, -3.96))]).markup(
        "1", Columns()
    )
    assert "−5 % … +5 %" in html and "p1 [kg]" in html
    assert places(html) == [(0, 100), pytest.approx((40, 60))]


@pytest.mark.parametrize(("truth", "said"), [(2.05, "inside"), (2.2, "outside")])
def test_the_truth_is_marked_and_said_to_be_inside_or_not(truth: float, said: str) -> None:
    html = IntervalChart([IntervalRow("p1", 2.0, (1.9, 2.1), "kg", truth)]).markup("1", Columns())
    assert f"{said}: {truth}" in html
    [mark] = map(float, re.findall(r'<b style="left:([\d.]+)%">', html))
    assert mark == pytest.approx(50 + 50 * (truth - 2.0) / 2.0 / (0.05 if said == "inside" else 0.1))


def test_an_interval_wider_than_the_estimate_is_cut_and_shows_it() -> None:
    html = IntervalChart([IntervalRow("p1", 1.0, (-4.0, 6.0))]).markup("1", Columns())
    assert places(html) == [(0, 100)]
    assert 'class="k0 beyond"' in html


@given(
    st.lists(
        st.tuples(
            st.floats(-1e6, 1e6),
            st.floats(0, 1e6),
            st.floats(0, 1e6),
            st.none() | st.floats(-1e6, 1e6),
        ),
        min_size=1,
        max_size=5,
    )
)
def test_whatever_is_estimated_is_drawn_on_the_scale(rows: list[tuple[float, float, float, float | None]]) -> None:
    shown = [
        IntervalRow(EVIL, value, (value - below, value + above), EVIL, truth) for value, below, above, truth in rows
    ]
    html = IntervalChart(shown).markup("1", Columns())
    assert all(0 <= low <= high <= 100.001 for low, high in places(html)) and len(places(html)) == len(rows)
    assert "<script" not in html and "<img" not in html
