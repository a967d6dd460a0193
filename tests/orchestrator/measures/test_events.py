"""Events come when they do, once each, however noisy the signal."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import TraceError
from orchestrator.measures import changes, crossings, saturated_share, saturations


def test_a_sine_crosses_every_half_period() -> None:
    t = np.linspace(0.0, 10.0, 10_001)
    y = np.cos(2 * math.pi * t)
    assert crossings(t, y, 0.0) == pytest.approx(np.arange(0.25, 10.0, 0.5), abs=1e-6)
    assert crossings(t, y, 0.0, "up") == pytest.approx(np.arange(0.75, 10.0, 1.0), abs=1e-6)
    assert crossings(t, y, 0.5, "down") == pytest.approx(np.arange(10) + 1 / 6, abs=1e-6)
    assert len(crossings(t, y, 2.0)) == 0


def test_noise_within_the_hysteresis_makes_no_crossings() -> None:
    t = np.linspace(0.0, 10.0, 10_001)
    noise = np.random.default_rng(1).uniform(-0.2, 0.2, len(t))
    y = np.cos(2 * math.pi * t) + noise
    assert len(crossings(t, y, 0.0)) > 40
    found = crossings(t, y, 0.0, hysteresis=0.25)
    assert found == pytest.approx(np.arange(0.25, 10.0, 0.5), abs=0.05)


def test_a_level_that_is_touched_or_begun_on_is_not_crossed() -> None:
    t = np.arange(6.0)
    assert len(crossings(t, np.array([1.0, 0.0, 1.0, 2.0, 0.0, 3.0]), 0.0)) == 0
    assert len(crossings(t, np.array([0.0, 0.0, 1.0, 2.0, 1.0, 3.0]), 0.0)) == 0
    assert list(crossings(t, np.array([-1.0, 0.0, 0.0, 1.0, 1.0, 1.0]), 0.0)) == [2.0]
    assert list(crossings(t, np.array([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]), 0.0)) == [0.5]
    assert list(crossings(t, np.array([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]), 0.0, hold=True)) == [1.0]


@given(st.lists(st.integers(-3, 3), min_size=1, max_size=30), st.integers(-2, 2))
def test_crossings_up_and_down_alternate_and_are_as_many_as_the_sides_that_change(
    values: list[int], level: int
) -> None:
    t, y = np.arange(float(len(values))), np.array(values, dtype=float)
    sides = [value > level for value in values if value != level]
    turns = [after for before, after in itertools.pairwise(sides) if before != after]
    assert len(crossings(t, y, level, "up")) == sum(turns)
    both = crossings(t, y, level)
    assert len(both) == len(turns) and np.all(np.diff(both) > 0)


def test_saturations_begin_and_end_with_the_samples_at_a_limit() -> None:
    t = np.arange(8.0) / 2
    u = np.array([0.0, 5.0, 5.0, 1.0, -5.0, -6.0, 0.0, 5.0])
    assert saturations(t, u, -5.0, 5.0).tolist() == [[0.5, 1.0], [2.0, 2.5], [3.5, 3.5]]
    assert saturated_share(t, u, -5.0, 5.0) == pytest.approx(4 / 7)
    assert saturations(t, 0.99 * u, -5.0, 5.0, within=0.1).shape == (3, 2)
    assert saturations(t, u, -9.0, 9.0).shape == (0, 2)
    with pytest.raises(TraceError, match="5 is not below -5"):
        saturations(t, u, 5.0, -5.0)


def test_a_mode_changes_at_the_first_sample_of_the_new_one() -> None:
    stamps, modes = changes([0.0, 0.1, 0.2, 0.3, 0.4], [1, 1, 2, 2, 0])
    assert (stamps.tolist(), modes.tolist()) == ([0.2, 0.4], [2.0, 0.0])
    assert len(changes([0.0, 1.0], [3, 3])[0]) == 0


def test_nan_is_refused() -> None:
    bad = ([0.0, 1.0], [0.0, math.nan])
    for refused in (
        lambda: crossings(*bad, 0.0),
        lambda: saturations(*bad, -1.0, 1.0),
        lambda: saturated_share(*bad, -1.0, 1.0),
        lambda: changes(*bad),
    ):
        with pytest.raises(TraceError, match="the value at 1 s is nan"):
            refused()
