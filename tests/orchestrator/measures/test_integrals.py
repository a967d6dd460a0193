"""Integrals are those of the line, or of the steps, through the samples, wherever these lie."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import fixed_quad

from fmus.errors import TraceError
from orchestrator.measures import effort, iae, ise, itae, mean, rms

CRITERIA = {
    iae: lambda t, e: abs(e),
    ise: lambda t, e: e**2,
    itae: lambda t, e: t * abs(e),
}
ALL = (mean, rms, iae, ise, itae)
steps = st.lists(st.tuples(st.floats(0.01, 10.0), st.floats(-1e3, 1e3)), min_size=2, max_size=12)


def signal(pairs: list[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    return np.cumsum([step for step, _ in pairs]), np.array([value for _, value in pairs])


@given(steps)
def test_criteria_are_the_integrals_of_the_line_through_the_samples(pairs: list[tuple[float, float]]) -> None:
    t, e = signal(pairs)
    for criterion, integrand in CRITERIA.items():
        at = lambda time: integrand(time - t[0], np.interp(time, t, e))  # noqa: B023, E731
        rows = np.flatnonzero(e[:-1] * e[1:] < 0)
        zeros = [np.interp(0.0, *zip(*sorted([(e[r], t[r]), (e[r + 1], t[r + 1])]), strict=True)) for r in rows]
        breaks = np.unique([*t, *zeros])
        expected = sum(fixed_quad(at, a, b, n=3)[0] for a, b in itertools.pairwise(breaks))
        assert criterion(t, e) == pytest.approx(expected, rel=1e-6, abs=1e-9)


@given(steps, st.integers(0, 10), st.floats(0.01, 0.99), st.booleans())
def test_a_sample_more_on_the_line_or_the_step_changes_nothing(
    pairs: list[tuple[float, float]], row: int, share: float, hold: bool
) -> None:
    t, y = signal(pairs)
    row %= len(t) - 1
    at = t[row] + share * (t[row + 1] - t[row])
    more_t = np.insert(t, row + 1, at)
    more_y = np.insert(y, row + 1, y[row] if hold else np.interp(at, t, y))
    for figure in ALL:
        assert figure(more_t, more_y, hold) == pytest.approx(figure(t, y, hold), rel=1e-7, abs=1e-7)


def test_held_samples_count_until_the_next_one() -> None:
    t, u = np.array([0.0, 1.0, 3.0, 3.5]), np.array([2.0, -1.0, 4.0, 100.0])
    assert effort(t, u) == 4 * 1 + 1 * 2 + 16 * 0.5
    assert iae(t, u, hold=True) == 2 * 1 + 1 * 2 + 4 * 0.5
    assert itae(t, u, hold=True) == pytest.approx(2 * 0.5 + 1 * (9 - 1) / 2 + 4 * (3.5**2 - 9) / 2)
    assert mean(t, u, hold=True) == pytest.approx((2 - 2 + 2) / 3.5)


def test_criteria_of_a_decay_are_the_closed_forms() -> None:
    t = np.linspace(0.0, 40.0, 400_001)
    e = np.exp(-t)
    assert (iae(t, e), ise(t, e), itae(t, e)) == pytest.approx((1.0, 0.5, 1.0), rel=1e-7)


def test_a_sine_has_its_rms_and_a_single_sample_its_own() -> None:
    t = np.linspace(0.0, 2 * np.pi, 100_001)
    assert rms(t, 3 * np.sin(t)) == pytest.approx(3 / np.sqrt(2), rel=1e-8)
    assert (rms([1.0], [-2.0]), mean([1.0], [-2.0])) == (2.0, -2.0)


@pytest.mark.parametrize("figure", [*ALL, effort])
@pytest.mark.parametrize(
    ("time", "values", "problem"),
    [
        ([0.0, 1.0, 2.0], [0.0, np.nan, 1.0], r"the value at 1 s is nan \(1 like it\)"),
        ([0.0, 1.0], [np.inf, 0.0], "the value at 0 s is inf"),
        ([0.0, 0.0], [1.0, 2.0], "stamps do not increase strictly"),
        ([0.0, np.nan], [1.0, 2.0], "stamps do not increase strictly"),
        ([0.0, 1.0], [1.0], r"stamps have shape \(2,\), values \(1,\)"),
        ([], [], "are 0, not"),
    ],
)
def test_what_is_no_signal_is_refused(figure: Callable[..., float], time: Any, values: Any, problem: str) -> None:
    with pytest.raises(TraceError, match=problem):
        figure(time, values)
