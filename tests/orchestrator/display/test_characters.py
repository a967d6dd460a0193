"""Curves drawn in characters show both, no peak is lost, and what is no number leaves a gap."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.display.characters import BOTH, HEIGHT, NEW, OLD, WIDTH, plot

TIME = np.linspace(0.0, 1.0, 100_001)


def rows(*curves: np.ndarray) -> list[str]:
    """The rows of the drawing, without labels."""
    text = plot("y", (TIME, curves[0]), (TIME, curves[1]))
    return [line.split("|", 1)[1].ljust(WIDTH) for line in text.splitlines() if "|" in line]


def test_curves_that_are_one_are_drawn_as_both_and_others_each_with_its_mark() -> None:
    same = rows(TIME, TIME)
    assert len(same) == HEIGHT and set("".join(same)) == {" ", BOTH}
    apart = rows(np.zeros_like(TIME), np.ones_like(TIME))
    assert set(apart[0]) == {NEW} and set(apart[-1]) == {OLD}


@pytest.mark.parametrize("row", [0, 1, 31_337, 99_999, 100_000])
def test_a_peak_of_one_sample_is_seen_where_it_is(row: int) -> None:
    values = np.zeros_like(TIME)
    values[row] = 1.0
    top = rows(np.zeros_like(TIME), values)[0]
    assert top.strip() == NEW and abs(top.index(NEW) - row / 100_000 * WIDTH) <= 1


def test_what_is_no_number_is_left_out_and_a_constant_is_drawn() -> None:
    values = np.full_like(TIME, np.nan)
    assert set("".join(rows(values, values))) == {" "}
    values[500] = 3.0
    assert "".join(rows(values, values)).strip() == BOTH
    assert set("".join(rows(np.full_like(TIME, 2.0), np.full_like(TIME, 2.0)))) == {" ", BOTH}
