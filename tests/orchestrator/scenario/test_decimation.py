"""A decimated trace is near all of the trace that it is of, and small."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.scenario.decimation import decimated, rounded
from orchestrator.trace import Trace

VALUES = st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=60)


def trace(**signals: list[float]) -> Trace:
    count = len(next(iter(signals.values())))
    return Trace(np.cumsum(1.0 + np.arange(count) % 3), {name: np.array(values) for name, values in signals.items()})


@given(
    VALUES,
    st.randoms(use_true_random=False),
    st.floats(0, 1e5),
    st.floats(0, 1e5),
    st.sets(st.sampled_from(["a", "b"])),
)
def test_lines_or_steps_between_what_is_kept_are_within_the_tolerance_of_every_sample_of_every_signal(
    values: list[float], random: object, one: float, other: float, hold: set[str]
) -> None:
    shuffled = values.copy()
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    full, tolerances = trace(a=values, b=shuffled), {"a": one, "b": other}
    few = decimated(full, tolerances, hold)
    assert set(few.time) <= set(full.time) and few.time[[0, -1]].tolist() == full.time[[0, -1]].tolist()
    for name, tolerance in tolerances.items():
        assert np.max(np.abs(few.resampled(full.time, hold)[name] - full[name])) <= tolerance * (1 + 1e-12) + 1e-9


def test_a_line_keeps_its_ends_and_a_corner_its_corner() -> None:
    corner = [*np.arange(50.0), *np.arange(50.0, 0.0, -1.0)]
    time = np.arange(100.0)
    assert decimated(Trace(time, {"a": 2 * time}), {"a": 1e-9}).time.tolist() == [0.0, 99.0]
    assert decimated(Trace(time, {"a": np.array(corner)}), {"a": 1e-9}).time.tolist() == [0.0, 50.0, 99.0]


def test_a_signal_that_is_held_keeps_its_steps_and_nothing_between() -> None:
    time = np.arange(100.0)
    steps = Trace(time, {"a": np.floor(time / 25)})
    assert decimated(steps, {"a": 0.5}, ["a"]).time.tolist() == [0.0, 25.0, 50.0, 75.0, 99.0]


def test_a_sine_takes_about_the_samples_that_its_curvature_asks_for() -> None:
    time = np.linspace(0, 1, 100_001)
    few = decimated(Trace(time, {"a": np.sin(2 * np.pi * time)}), {"a": 1e-4})
    best = np.sqrt(2 * np.pi**2 / 8 / 1e-4) * 2 / np.pi * 1.2  # integral of sqrt(|y''| / (8 * tolerance)), about
    assert best / 2 < len(few) < 4 * best


@given(st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=20), st.floats(1e-9, 1e3))
def test_rounding_changes_no_value_by_more_than_the_tolerance(values: list[float], tolerance: float) -> None:
    full = trace(a=values)
    near = rounded(full, {"a": tolerance})
    assert np.max(np.abs(near["a"] - full["a"])) <= tolerance
    assert rounded(full, {"a": 0.0})["a"].tolist() == values


@pytest.mark.parametrize("count", [1, 2])
def test_there_is_nothing_to_leave_out_of_one_or_two_samples(count: int) -> None:
    assert len(decimated(trace(a=[1.0] * count), {"a": 9.0})) == count
