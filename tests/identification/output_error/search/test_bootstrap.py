"""Intervals by windows drawn with replacement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from fmus.errors import FmuError, IdentificationError
from identification.estimation.parameters import Parameter, ParameterSet
from identification.output_error.search.bootstrap import _levels
from identification.output_error.search.estimate import Estimate
from identification.output_error.search.estimator import estimate
from identification.output_error.search.options import IntervalOptions, SearchOptions
from identification.output_error.search.problem import Problem, Window
from orchestrator.trace import FloatArray

TIME = np.linspace(0.0, 1.0, 20)
OPTIONS = SearchOptions(intervals=IntervalOptions("bootstrap", resamples=200, seed=4))


class Line:
    """y = slope t."""

    def simulate(self, window: int, values: Mapping[str, float]) -> FloatArray:
        return np.asarray(values["m.slope"] * TIME[:, None])

    def close(self) -> None:
        return None


def scattered(windows: int, rng: np.random.Generator) -> Problem:
    """Slopes that scatter from window to window, as model errors have it, and little noise within."""
    slopes = 1.0 + 0.1 * rng.normal(size=windows)
    cut = [
        Window(str(w), "t", (slope * TIME + 0.01 * rng.normal(size=20))[:, None], np.ones(1))
        for w, slope in enumerate(slopes)
    ]
    return Problem(ParameterSet((Parameter("m.slope", 0.9), Parameter("m.nothing", 1.0, 0.0, 2.0))), tuple(cut), ("y",))


def fitted(problem: Problem, options: SearchOptions = OPTIONS) -> Estimate:
    return estimate(problem, Line, options)


@pytest.mark.slow
def test_the_spread_is_that_of_the_windows_means() -> None:
    """Of a line, the estimate is a mean of the windows' own: resampling means has a closed form."""
    problem = scattered(30, np.random.default_rng(1))
    found = fitted(problem)
    own = [float(w.measured[:, 0] @ TIME / (TIME @ TIME)) for w in problem.windows]
    drawn = found.intervals.bootstrap
    assert drawn is not None and drawn.failed == 0
    slopes = drawn.replicates[:, drawn.names.index("m.slope")]
    assert slopes.mean() == pytest.approx(np.mean(own), abs=3 * np.std(own) / np.sqrt(30 * 200))
    assert slopes.std(ddof=1) == pytest.approx(np.std(own) / np.sqrt(30), rel=0.15)
    low, high = found.ci95["m.slope"]
    half = stats.t.ppf(0.975, 29) * np.std(own, ddof=1) / np.sqrt(30)
    assert high - low == pytest.approx(2 * half, rel=0.2)


@pytest.mark.slow
def test_a_parameter_that_does_nothing_gets_no_interval() -> None:
    found = fitted(scattered(12, np.random.default_rng(2)))
    assert found.ci95["m.nothing"] == (-np.inf, np.inf) and np.isfinite(found.ci95["m.slope"][0])


@pytest.mark.slow
def test_the_same_seed_gives_the_same_and_another_one_another() -> None:
    problem = scattered(12, np.random.default_rng(3))
    one, again = fitted(problem), fitted(problem)
    other = fitted(problem, replace(OPTIONS, intervals=replace(OPTIONS.intervals, seed=5)))
    assert one.ci95 == again.ci95 != other.ci95


class Limited(Line):
    """No run succeeds where the slope is steeper."""

    def __init__(self, steepest: float) -> None:
        self._steepest = steepest

    def simulate(self, window: int, values: Mapping[str, float]) -> FloatArray:
        if values["m.slope"] > self._steepest:
            raise FmuError("m", "too steep")
        return super().simulate(window, values)


@pytest.mark.parametrize(("steepest", "failed"), [(9.0, "none"), (1.05, "few"), (1.01, "many")])
def test_fits_that_fail_are_told_and_of_too_many_nothing_is_concluded(steepest: float, failed: str) -> None:
    problem = replace(scattered(12, np.random.default_rng(2)), parameters=ParameterSet((Parameter("m.slope", 0.9),)))
    options = replace(OPTIONS, intervals=replace(OPTIONS.intervals, resamples=60))
    found = estimate(problem, lambda: Limited(steepest), options)
    assert found.intervals.bootstrap is not None
    count = found.intervals.bootstrap.failed
    assert {"none": count == 0, "few": 0 < count <= 6, "many": count > 6}[failed]
    told = [warning for warning in found.warnings if "fits of the bootstrap" in warning]
    assert told == ([f"{count} of 60 fits of the bootstrap failed and are left out"] if count else [])
    assert (found.ci95["m.slope"] == (-np.inf, np.inf)) == (failed == "many")


def test_too_few_windows_are_refused() -> None:
    with pytest.raises(IdentificationError, match="uncertainty: 4 windows are too few to be drawn from") as caught:
        fitted(scattered(4, np.random.default_rng(4)))
    assert "profile" in str(caught.value)


def test_percentiles_are_those_of_students_t() -> None:
    low, high = _levels(np.linspace(-1, 1, 101), 0.0, None, 12)
    assert (low, high) == pytest.approx(stats.norm.cdf(np.sqrt(12 / 11) * stats.t.ppf([0.025, 0.975], 11)))


def test_bca_is_that_of_scipy() -> None:
    """Of the mean of a skewed sample, at the level that is for so few windows."""
    sample = np.random.default_rng(6).exponential(size=30)
    level = 1 - 2 * stats.norm.sf(np.sqrt(30 / 29) * stats.t.ppf(0.975, 29))
    expected = stats.bootstrap((sample,), np.mean, method="BCa", confidence_level=level, random_state=7)
    mean, means = float(sample.mean()), expected.bootstrap_distribution
    ends = np.quantile(means, _levels(means, mean, (mean - sample) / 29, 30))
    assert ends == pytest.approx(list(expected.confidence_interval), rel=1e-6)


@pytest.mark.slow
def test_intervals_cover_the_mean_of_windows_that_scatter() -> None:
    rng, inside, draws = np.random.default_rng(8), 0, 40
    options = replace(OPTIONS, intervals=replace(OPTIONS.intervals, resamples=100))
    for _ in range(draws):
        problem = scattered(12, rng)
        slope = ParameterSet((Parameter("m.slope", 0.9),))
        low, high = fitted(replace(problem, parameters=slope), options).ci95["m.slope"]
        inside += low <= 1.0 <= high
    assert inside >= stats.binom.ppf(1e-3, draws, 0.95), inside / draws
