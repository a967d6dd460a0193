"""What is known of parameters before, against the closed form, and beside recordings that say little or otherwise."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pytest
from scipy import stats

from fmus.errors import IdentificationError
from identification.estimation.parameters import Parameter, ParameterSet
from identification.estimation.prior import LogNormal, Normal, Prior, Uniform
from identification.output_error.search.estimate import Estimate
from identification.output_error.search.estimator import estimate
from identification.output_error.search.options import IntervalOptions, SearchOptions
from identification.output_error.search.problem import Problem, Window
from orchestrator.trace import FloatArray

TIGHT = SearchOptions(cost_tolerance=1e-10, step_tolerance=1e-10)
TIME = np.linspace(0.0, 2.0, 50)
COLUMNS = np.column_stack([np.ones(50), TIME])
TRUTH = np.array([1.0, -2.0])
NAMES = ("m.offset", "m.slope")


@dataclass
class Plain:
    """A function as a simulator."""

    model: Callable[[Mapping[str, float]], FloatArray]

    def simulate(self, window: int, values: Mapping[str, float]) -> FloatArray:
        return self.model(values)[:, None]

    def close(self) -> None:
        return None


def line(values: Mapping[str, float]) -> FloatArray:
    return np.asarray(COLUMNS @ [values[name] for name in NAMES])


def product(values: Mapping[str, float]) -> FloatArray:
    return values["m.a"] * values["m.b"] * TIME


def fitted(
    model: Callable[[Mapping[str, float]], FloatArray],
    clean: FloatArray,
    parameters: tuple[Parameter, ...],
    options: SearchOptions = TIGHT,
    windows: int = 1,
) -> tuple[Estimate, Problem]:
    rng = np.random.default_rng(1)
    cut = tuple(Window(str(w), "t", (clean + 0.3 * rng.normal(size=50))[:, None], np.ones(1)) for w in range(windows))
    problem = Problem(ParameterSet(parameters), cut, ("y",))
    return estimate(problem, lambda: Plain(model), options), problem


def with_prior(mean: float, std: float) -> tuple[Parameter, ...]:
    return Parameter("m.offset", 0.8), Parameter("m.slope", -1.5, prior=Normal(mean, std))


def closed_form(y: FloatArray, mean: float, std: float) -> tuple[FloatArray, FloatArray]:
    """Estimate and covariance, with the noise's variance by least squares alone."""
    variance = float(np.linalg.lstsq(COLUMNS, y, rcond=None)[1][0]) / 48
    known = np.diag([0.0, 1 / std**2])
    matrix = COLUMNS.T @ COLUMNS / variance + known
    return np.linalg.solve(matrix, COLUMNS.T @ y / variance + known @ [0.0, mean]), np.linalg.inv(matrix)


@pytest.mark.parametrize(("mean", "std"), [(-2.0, 0.05), (-1.8, 0.1), (-2.0, 10.0)])
def test_of_a_line_the_estimate_is_the_closed_form(mean: float, std: float) -> None:
    found, problem = fitted(line, COLUMNS @ TRUTH, with_prior(mean, std))
    expected, covariance = closed_form(problem.windows[0].measured[:, 0], mean, std)
    assert found.converged
    assert [found.values[name] for name in NAMES] == pytest.approx(expected, rel=2e-3)
    assert found.covariance == pytest.approx(covariance, rel=0.03)
    known = found.known["m.slope"]
    assert known.added == pytest.approx(1 - covariance[1, 1] / std**2, abs=0.02)
    assert known.off == pytest.approx((expected[1] - mean) / std, abs=0.01)
    assert found.residuals[0].shape == (50, 1)


@pytest.mark.parametrize("times", [2, 5])
@pytest.mark.parametrize("by", ["local", "profile"])
def test_windows_that_are_there_more_than_once_do_not_outweigh_it(by: Literal["local", "profile"], times: int) -> None:
    """The posterior is that of the closed form with each sample once, its mean, covariance and interval."""
    mean, std, options = -1.8, 0.1, replace(TIGHT, intervals=IntervalOptions(by))
    once, problem = fitted(line, COLUMNS @ TRUTH, with_prior(mean, std), options)
    again = replace(problem, windows=problem.windows * times, counted=float(times))
    found = estimate(again, lambda: Plain(line), options)
    expected, covariance = closed_form(problem.windows[0].measured[:, 0], mean, std)
    assert [found.values[name] for name in NAMES] == pytest.approx(expected, rel=2e-3)
    assert found.covariance == pytest.approx(covariance, rel=0.05)
    for name in NAMES:
        assert np.diff(found.ci95[name]) == pytest.approx(np.diff(once.ci95[name]), rel=0.05)


def test_profiles_count_what_is_known_before() -> None:
    options = replace(TIGHT, intervals=IntervalOptions("profile"))
    found, _ = fitted(line, COLUMNS @ TRUTH, with_prior(-1.8, 0.1), options)
    for name in NAMES:
        assert found.ci95[name] == pytest.approx(found.local95[name], rel=1e-3)


def test_a_bootstrap_counts_it_too() -> None:
    options = replace(TIGHT, intervals=IntervalOptions("bootstrap", 100, 1))
    found, _ = fitted(line, COLUMNS @ TRUTH, with_prior(-2.0, 1e-3), options, windows=12)
    low, high = found.ci95["m.slope"]
    assert -2.004 < low < high < -1.996


@pytest.mark.parametrize("scale", ["linear", "log"])
@pytest.mark.parametrize("prior", [Normal(2.0, 0.1), LogNormal(2.0, 1.05)])
def test_what_only_goes_together_is_told_apart_by_a_prior(prior: Prior, scale: str) -> None:
    a = Parameter("m.a", 1.5, 0.1, 10.0, scale=scale, prior=prior)  # type: ignore[arg-type]
    found, _ = fitted(product, 6.0 * TIME, (a, Parameter("m.b", 2.0, 0.1, 10.0)))
    assert found.values["m.a"] == pytest.approx(2.0, rel=1e-3)
    assert found.values["m.b"] == pytest.approx(3.0, rel=0.03)
    assert found.std["m.a"] == pytest.approx(prior.std(2.0), rel=0.02)
    assert found.std["m.b"] == pytest.approx(3 * prior.std(2.0) / 2, rel=0.05)
    assert any("only their ratio" in w or "a product" in w or "a sum" in w for w in found.warnings)
    assert any("what is told beyond that is by priors" in warning for warning in found.warnings)
    assert any("m.a is what was known before" in warning and "add 0 %" in warning for warning in found.warnings)


def test_a_prior_that_recordings_contradict_is_named() -> None:
    found, _ = fitted(line, COLUMNS @ TRUTH, with_prior(-1.0, 0.05))
    assert any("m.slope is" in w and "standard deviations from what was known before" in w for w in found.warnings)


def test_a_weak_prior_changes_nothing_and_is_not_warned_of() -> None:
    bare = (Parameter("m.offset", 0.8), Parameter("m.slope", -1.5))
    (found, _), (without, _) = (
        fitted(line, COLUMNS @ TRUTH, with_prior(0.0, 100.0)),
        fitted(line, COLUMNS @ TRUTH, bare),
    )
    assert found.values == pytest.approx(without.values, rel=1e-5)
    assert found.warnings == () and found.known["m.slope"].added > 0.999


def test_a_uniform_prior_bounds() -> None:
    slope = Parameter("m.slope", -1.5, -5.0, 0.0, prior=Uniform(-1.9, -1.0))
    found, _ = fitted(line, COLUMNS @ TRUTH, (Parameter("m.offset", 0.8), slope))
    assert slope.lower == -1.9
    assert found.values["m.slope"] == -1.9


@pytest.mark.parametrize(
    ("prior", "message"),
    [
        (Normal(5.0, 1.0), "mean 5 is outside the parameter's bounds, 0 to 2"),
        (Normal(1.0, 0.0), "std 0 is not positive"),
        (LogNormal(3.0, 1.1), "median 3 is outside"),
        (LogNormal(1.0, 0.9), "factor 0.9 is no spread"),
        (Uniform(-1.0, 1.0), "min -1 is outside"),
        (Uniform(1.0, 1.0), "leaves no room"),
    ],
)
def test_a_prior_outside_the_bounds_is_refused_with_its_place(prior: Prior, message: str) -> None:
    with pytest.raises(IdentificationError, match=message) as caught:
        Parameter("m.a", 1.0, 0.0, 2.0, prior=prior)
    assert caught.value.place == "parameters.m.a.prior" and caught.value.fix


def test_a_start_outside_of_a_uniform_prior_is_refused() -> None:
    with pytest.raises(IdentificationError, match=r"start 0.1 is not within 1 to 2"):
        Parameter("m.a", 0.1, 0.0, 2.0, prior=Uniform(1.0, 2.0))


@pytest.mark.parametrize("prior", [Normal(2.0, 0.3), LogNormal(2.0, 1.2)])
def test_distances_are_those_of_the_distributions(prior: Prior) -> None:
    reference = stats.norm(2.0, 0.3) if isinstance(prior, Normal) else stats.lognorm(math.log(1.2), scale=2.0)
    for level in (0.025, 0.16, 0.5, 0.9):
        value = float(reference.ppf(level))
        assert prior.distance(value) == pytest.approx(stats.norm.ppf(level), abs=1e-9)
        slope = (prior.distance(value + 1e-6) - prior.distance(value - 1e-6)) / 2e-6
        assert prior.slope(value) == pytest.approx(slope, rel=1e-6)


@pytest.mark.slow
def test_intervals_cover_truths_drawn_from_the_prior() -> None:
    rng, inside, draws = np.random.default_rng(5), np.zeros(2), 300
    for _ in range(draws):
        truth = np.array([1.0, rng.normal(-2.0, 0.05)])
        y = COLUMNS @ truth + 0.3 * rng.normal(size=50)
        problem = Problem(ParameterSet(with_prior(-2.0, 0.05)), (Window("w", "t", y[:, None], np.ones(1)),), ("y",))
        found = estimate(problem, lambda: Plain(line), TIGHT)
        inside += [found.ci95[n][0] <= true <= found.ci95[n][1] for n, true in zip(NAMES, truth, strict=True)]
    low, high = stats.binom.interval(0.999, draws, 0.95)
    assert np.all((low <= inside) & (inside <= high)), inside / draws
