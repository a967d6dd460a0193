"""Figures against a reference are those of their definitions, and a tube holds exactly what it should."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import TraceError
from orchestrator.measures import FunnelTolerance, correlation_lag, fit, funnel, largest_deviation, nrmse

sets = st.lists(st.tuples(st.floats(0.05, 2.0), st.floats(-10, 10)), min_size=2, max_size=12)
times = st.floats(0.0, 3.0)


def signal(pairs: list[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    return np.cumsum([step for step, _ in pairs]), np.array([value for _, value in pairs])


def test_figures_of_closeness_are_their_definitions() -> None:
    t = np.linspace(0.0, 2 * math.pi, 20_001)
    r = 3.0 + 2.0 * np.sin(t)
    assert nrmse(t, r + 0.1, r) == pytest.approx(0.1 / 4.0)
    assert fit(t, r + 0.1, r) == pytest.approx(1 - 0.1 / math.sqrt(2), rel=1e-6)
    assert fit(t, np.full_like(t, 3.0), r) == pytest.approx(0.0, abs=1e-9)
    assert largest_deviation(t, r - 0.1 * (t == t[700]), r) == (pytest.approx(0.1), t[700])


@pytest.mark.parametrize("figure", [nrmse, fit])
def test_a_constant_reference_has_no_relative_figure(figure: object) -> None:
    with pytest.raises(TraceError, match="there is none: a signal is constant"):
        figure([0.0, 1.0], [0.0, 1.0], [2.0, 2.0])  # type: ignore[operator]


@given(st.floats(-2.0, 2.0), st.floats(0.1, 10), st.floats(-5, 5))
def test_the_lag_of_a_pulse_is_found_between_samples(lag: float, gain: float, offset: float) -> None:
    t = np.linspace(0.0, 10.0, 501)
    pulse = lambda x: np.exp(-((x - 5.0) ** 2))  # noqa: E731
    found, correlation = correlation_lag(t, offset + gain * pulse(t - lag), pulse(t))
    assert found == pytest.approx(lag, abs=2e-3)
    assert correlation > 0.999


def test_the_lag_of_a_step_is_found_at_uneven_stamps() -> None:
    t = np.sort(np.random.default_rng(1).uniform(0.0, 10.0, 2000))
    step = lambda x: 1 / (1 + np.exp(-8 * (x - 3)))  # noqa: E731
    assert correlation_lag(t, step(t - 0.4), step(t))[0] == pytest.approx(0.4, abs=0.01)
    assert correlation_lag(t, step(t + 0.4), step(t))[0] == pytest.approx(-0.4, abs=0.01)


@given(sets, st.floats(0, 2), st.floats(0, 0.5), st.floats(0, 0.5), times, times, st.booleans(), st.integers(0, 99))
def test_a_tube_is_all_rectangles_about_the_reference(
    pairs: list[tuple[float, float]],
    value: float,
    relative: float,
    of_range: float,
    leading: float,
    lagging: float,
    hold: bool,
    seed: int,
) -> None:
    s, r = signal(pairs)
    t = np.sort(np.random.default_rng(seed).uniform(s[0], s[-1], 9))
    lower, upper = funnel(t, s, r, FunnelTolerance(value, relative, of_range, leading, lagging), hold)
    span = r.max() - r.min()
    for k, instant in enumerate(t):
        begin, end = max(instant - lagging, s[0]), min(instant + leading, s[-1])
        inside = [i for i in range(len(s)) if begin < s[i] <= end]
        if hold:
            seen = [r[max(i for i in range(len(s)) if s[i] <= begin)], *r[inside]]
        else:
            seen = [np.interp(begin, s, r), *r[inside], np.interp(end, s, r)]
        widths = [value + of_range * span + relative * abs(y) for y in seen]
        assert upper[k] == pytest.approx(max(y + w for y, w in zip(seen, widths, strict=True)), abs=1e-7)
        assert lower[k] == pytest.approx(min(y - w for y, w in zip(seen, widths, strict=True)), abs=1e-7)


@given(sets, st.floats(-0.5, 0.5))
def test_a_signal_that_comes_later_lies_within_its_lag_and_no_less(
    pairs: list[tuple[float, float]], lag: float
) -> None:
    s, r = signal(pairs)
    t = np.linspace(s[0], s[-1], 101)
    y = np.interp(t - lag, s, r)
    allowed = FunnelTolerance(1e-7, leading=max(-lag, 0.0), lagging=max(lag, 0.0))
    lower, upper = funnel(t, s, r, allowed)
    assert np.all((lower <= y) & (y <= upper))


def test_a_lag_beyond_what_is_allowed_leaves_the_tube() -> None:
    t = np.linspace(0.0, 10.0, 1001)
    lower, upper = funnel(t, t, np.sin(t), FunnelTolerance(0.01, lagging=0.1))
    allowed = np.sin(np.maximum(t - 0.1, 0.0))
    assert np.all((lower <= allowed) & (allowed <= upper))
    late = np.sin(np.maximum(t - 0.12, 0.0))
    assert np.any((late < lower) | (late > upper))
    early = np.sin(t + 0.05)
    assert np.any((early < lower) | (early > upper))


@pytest.mark.parametrize(
    "tolerance", [FunnelTolerance(), FunnelTolerance(leading=0.05), FunnelTolerance(0.0, 0.0, 0.0, 0.2, 0.3)]
)
@pytest.mark.parametrize("hold", [False, True])
def test_a_signal_lies_within_any_tube_about_itself(tolerance: FunnelTolerance, hold: bool) -> None:
    t = np.arange(10_000) * 1e-3
    y = np.random.default_rng(0).standard_normal(len(t))
    lower, upper = funnel(t, t, y, tolerance, hold)
    assert np.all((lower <= y) & (y <= upper))


def test_a_bad_reference_or_tolerance_is_refused() -> None:
    with pytest.raises(TraceError, match="covers 0 to 1 s, not 0 to 2 s"):
        funnel([0.0, 2.0], [0.0, 1.0], [0.0, 0.0], FunnelTolerance(1.0))
    with pytest.raises(TraceError, match="the value at 1 s is nan"):
        funnel([0.0, 1.0], [0.0, 1.0], [0.0, math.nan], FunnelTolerance(1.0))
    for bad in (-1.0, math.nan, math.inf):
        with pytest.raises(TraceError, match="tolerance: lagging is"):
            FunnelTolerance(1.0, lagging=bad)


@pytest.mark.parametrize("hold", [False, True])
@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("lag", [0.0, 0.004, 3.0])
def test_a_long_signal_has_the_tube_that_each_of_its_instants_has(hold: bool, uneven: bool, lag: float) -> None:
    rng = np.random.default_rng(4)
    t = np.arange(40_000) * 1e-3
    s = np.sort(np.append(rng.uniform(0.0, t[-1], 30_000), [0.0, t[-1]])) if uneven else t
    r = np.cumsum(rng.standard_normal(len(s)))
    tolerance = FunnelTolerance(0.1, 0.01, 0.0, lag, 2 * lag)
    lower, upper = funnel(t, s, r, tolerance, hold)
    for row in range(0, len(t), 997):
        alone = funnel(t[row : row + 1], s, r, tolerance, hold)
        assert (lower[row], upper[row]) == pytest.approx((alone[0][0], alone[1][0]), rel=1e-6, abs=1e-6)
