"""Columns in a page hold what they were given, and their levels every extreme."""

from __future__ import annotations

import json
import zlib
from base64 import b64decode
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from orchestrator.report import columns
from orchestrator.report.columns import PART, RAW, STRETCH, Columns, PageColumn, column
from orchestrator.trace import FloatArray

NUMBERS = st.floats(-1e6, 1e6) | st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1e300, 5e-324, 0.0])


def numbers(text: str) -> FloatArray:
    """What a browser makes of a part."""
    sorted_bytes = np.frombuffer(zlib.decompress(b64decode(text)), np.uint8)
    return sorted_bytes.reshape(4, -1).T.copy().view("<f4").ravel().astype(float)


def values(one: PageColumn) -> FloatArray:
    """All samples, as a browser reads them."""
    pieces = [numbers(part) * one.head["scale"] + base for part, base in zip(one.parts, one.head["bases"], strict=True)]
    return np.concatenate(pieces) if pieces else np.zeros(0)


def level(one: dict[str, Any]) -> FloatArray:
    """(n, 2) lowest and highest of its stretches."""
    return (numbers(one["text"]) * one["scale"] + one["base"]).reshape(-1, 2)


@given(arrays(float, st.integers(0, 300), elements=NUMBERS))
def test_samples_come_back_to_the_seventh_digit_of_their_span(given_: FloatArray) -> None:
    found = values(column(given_))
    finite = np.isfinite(given_)
    assert np.array_equal(np.isfinite(found), finite)
    if finite.any():
        span = np.max(given_[finite] / 2) - np.min(given_[finite] / 2)
        assert np.all(np.abs(found[finite] / 2 - given_[finite] / 2) <= 1e-7 * span + 1e-300)


@pytest.mark.parametrize("count", [RAW, RAW + 1, 3 * RAW + 17, RAW * STRETCH + 1])
def test_levels_hold_the_extremes_of_every_stretch_and_end_where_few_are_left(count: int) -> None:
    given_ = np.random.default_rng(2).normal(size=count)
    given_[count // 3] = 50.0
    given_[-1] = -50.0
    found = column(given_).head.get("levels", [])
    assert bool(found) == (count > RAW)
    width = 1
    for one in found:
        width *= STRETCH
        assert one["width"] == width
        padded = np.pad(given_, (0, -count % width), mode="edge").reshape(-1, width)
        expected = np.column_stack([padded.min(axis=1), padded.max(axis=1)])
        assert np.allclose(level(one), expected, atol=1e-5)
    assert not found or len(level(found[-1])) <= RAW


def test_a_stretch_without_values_has_no_extremes_and_others_leave_out_what_is_none() -> None:
    given_ = np.zeros(2 * RAW)
    given_[:STRETCH] = np.nan
    given_[STRETCH : 2 * STRETCH - 1] = np.inf
    first, second = level(column(given_).head["levels"][0])[:2]
    assert np.all(np.isnan(first)) and np.all(second == 0)


def test_a_large_offset_costs_no_precision() -> None:
    given_ = 1e6 + 1e-3 * np.sin(np.arange(1000.0))
    assert np.max(np.abs(values(column(given_)) - given_)) < 1e-9


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e3), st.integers(2, 5000))
def test_even_instants_need_no_numbers(start: float, step: float, count: int) -> None:
    time = start + step * np.arange(count)
    made = Columns()
    made.add(time, rising=True)
    [one] = made.columns
    if "step" in one.head:
        assert one.parts == ()
        drawn = one.head["start"] + one.head["step"] * np.arange(count)
        assert np.max(np.abs(drawn - time)) <= 1.01e-6 * one.head["step"]
    else:  # too far from 0 for steps so short
        assert np.max(np.abs(np.diff(time) / step - 1)) > 1e-8


def test_uneven_instants_increase_from_the_base_of_their_part() -> None:
    time = np.cumsum(np.random.default_rng(4).uniform(0.5e-3, 1.5e-3, 3 * PART))
    one = column(time, rising=True)
    assert one.head["bases"] == time[::PART].tolist()
    assert np.max(np.abs(values(one) - time)) < 0.01 * np.min(np.diff(time))


def test_an_array_that_several_charts_draw_is_in_the_page_once() -> None:
    made, given_ = Columns(), np.random.default_rng(1).normal(size=100)
    assert made.add(given_) == made.add(given_) == 0
    assert made.add(given_.copy()) == 1
    assert made.markup().count("<script") == 2
    assert len(json.loads(made.heads())) == 2


def test_what_is_too_much_for_a_page_is_there_by_its_extremes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(columns, "MOST", 3 * RAW)
    made = Columns()
    for number in range(3):
        made.add(np.random.default_rng(number).normal(size=2 * RAW))
    made.add(np.zeros(10))
    assert [one.thinned for one in made.columns] == [False, True, True, False]
    assert all(one.head["levels"] for one in made.columns[:3])


def test_the_script_and_the_writer_cut_columns_alike() -> None:
    from importlib import resources

    script = (resources.files("orchestrator.report") / "chart.js").read_text(encoding="utf-8")
    assert f"const [PART, RAW] = [{PART}, {RAW}];" in script
