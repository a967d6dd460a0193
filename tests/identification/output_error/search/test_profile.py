"""Profile likelihood against closed forms, and what it says where there is no end to an interval."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import stats
from scipy.optimize import brentq, least_squares

from fmus.errors import FmuError
from identification.estimation.arrow_least_squares import Loss
from identification.estimation.parameters import InitialState, Parameter, ParameterSet, Tie
from identification.output_error.search.estimate import Estimate
from identification.output_error.search.estimator import SILENT, estimate
from identification.output_error.search.options import IntervalOptions, SearchOptions
from identification.output_error.search.problem import Problem, Window
from orchestrator.trace import FloatArray

PROFILE = SearchOptions(cost_tolerance=1e-9, step_tolerance=1e-9, intervals=IntervalOptions("profile"))
Model = Callable[[int, Mapping[str, float]], FloatArray]


@dataclass
class Plain:
    """A function as a simulator."""

    model: Model

    def simulate(self, window: int, values: Mapping[str, float]) -> FloatArray:
        return np.asarray(self.model(window, values), dtype=float)

    def close(self) -> None:
        return None


def question(
    model: Model,
    truth: Mapping[str, float],
    parameters: tuple[Parameter, ...],
    *,
    noise: float = 0.1,
    windows: int = 1,
    seed: int = 0,
    ties: tuple[Tie, ...] = (),
    states: tuple[InitialState, ...] = (),
) -> Problem:
    rng = np.random.default_rng(seed)
    clean = [model(w, truth) for w in range(windows)]
    cut = tuple(
        Window(str(w), "t", y + noise * rng.normal(size=y.shape), np.ones(y.shape[1])) for w, y in enumerate(clean)
    )
    outputs = tuple(f"y{i}" for i in range(clean[0].shape[1]))
    return Problem(ParameterSet(parameters, ties), cut, outputs, states)


def fitted(problem: Problem, model: Model, options: SearchOptions = PROFILE) -> Estimate:
    return estimate(problem, lambda: Plain(model), options)


COLUMNS = np.random.default_rng(3).normal(size=(60, 3))
LINEAR = {"m.a": 1.0, "m.b": -2.0, "m.c": 0.5}
FREE = tuple(Parameter(name, 0.9 * value) for name, value in LINEAR.items())


def linear(window: int, values: Mapping[str, float]) -> FloatArray:
    return (COLUMNS @ [values[name] for name in LINEAR])[:, None]


def test_of_a_linear_model_profile_local_and_closed_form_are_one() -> None:
    problem = question(linear, LINEAR, FREE)
    found = fitted(problem, linear)
    y = problem.windows[0].measured[:, 0]
    best, rest, *_ = np.linalg.lstsq(COLUMNS, y, rcond=None)
    half = stats.t.ppf(0.975, 57) * np.sqrt(rest[0] / 57 * np.diag(np.linalg.inv(COLUMNS.T @ COLUMNS)))
    for i, name in enumerate(LINEAR):
        expected = (best[i] - half[i], best[i] + half[i])
        assert found.ci95[name] == pytest.approx(expected, rel=1e-5)
        assert found.local95[name] == pytest.approx(expected, rel=1e-5)
        curve = found.intervals.profiles[name]
        assert curve.threshold == pytest.approx(stats.f.ppf(0.95, 1, 57))
        assert curve.rise == pytest.approx(((curve.values - best[i]) / half[i]) ** 2 * curve.threshold, abs=1e-4)


def test_an_estimated_start_value_is_fitted_anew_along_the_profile() -> None:
    def with_start(window: int, values: Mapping[str, float]) -> FloatArray:
        return linear(window, values) + values["m.x"]

    states = (InitialState("m.x", (0.1, -0.1), estimated=True),)
    problem = question(with_start, {**LINEAR, "m.x": 0.0}, FREE, windows=2, states=states)
    found = fitted(problem, with_start)
    dense = np.vstack([np.column_stack([COLUMNS, np.ones(60), np.zeros(60)])] * 2)
    dense[60:, 3:] = dense[60:, :2:-1]
    y = np.concatenate([window.measured[:, 0] for window in problem.windows])
    best, rest, *_ = np.linalg.lstsq(dense, y, rcond=None)
    half = stats.t.ppf(0.975, 115) * np.sqrt(rest[0] / 115 * np.diag(np.linalg.inv(dense.T @ dense)))
    for i, name in enumerate(LINEAR):
        assert found.ci95[name] == pytest.approx((best[i] - half[i], best[i] + half[i]), rel=1e-4)


TIME = np.linspace(0.0, 3.0, 25)


def decay(window: int, values: Mapping[str, float]) -> FloatArray:
    return np.exp(-values["m.rate"] * TIME)[:, None]


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_of_one_parameter_the_ends_are_where_the_exact_likelihood_says(scale: str) -> None:
    rate = Parameter("m.rate", 1.5, 1e-3, 100.0, scale=scale)  # type: ignore[arg-type]
    problem = question(decay, {"m.rate": 2.0}, (rate,), noise=0.3)
    found = fitted(problem, decay)
    y = problem.windows[0].measured

    def rest(value: float) -> float:
        return float(np.sum((decay(0, {"m.rate": value}) - y) ** 2))

    best = found.values["m.rate"]
    limit = rest(best) * (1 + stats.f.ppf(0.95, 1, 24) / 24)
    low, high = (brentq(lambda v: rest(v) - limit, *ends) for ends in ((1e-2, best), (best, 80.0)))
    assert found.ci95["m.rate"] == pytest.approx((low, high), rel=2e-3)
    assert high - best > 1.5 * (best - low), "an interval that is not symmetric, or the test shows nothing"


def wave(window: int, values: Mapping[str, float]) -> FloatArray:
    return (values["m.size"] * np.sin((values["m.rate"] + window) * TIME))[:, None]


def test_the_others_are_fitted_anew_as_scipy_would() -> None:
    parameters = (Parameter("m.size", 1.0, 0.0, 5.0), Parameter("m.rate", 1.1, 0.1, 3.0))
    problem = question(wave, {"m.size": 1.0, "m.rate": 1.2}, parameters, noise=0.5, windows=2)
    found = fitted(problem, wave)

    def rest(rate: float) -> float:
        def residuals(x: FloatArray) -> FloatArray:
            values = {"m.size": float(x[0]), "m.rate": rate}
            return np.concatenate([(wave(w, values) - problem.windows[w].measured).ravel() for w in range(2)])

        return 2 * float(least_squares(residuals, [1.0], xtol=1e-14, ftol=1e-14).cost)

    limit = 2 * found.cost * (1 + stats.f.ppf(0.95, 1, 48) / 48)
    for end in found.ci95["m.rate"]:
        assert rest(end) == pytest.approx(limit, rel=2e-3)


def test_outputs_of_different_noise_count_by_their_own() -> None:
    """One output weighed wrongly by 30: the profile has to be as wide as the sandwich that local intervals rest on."""

    def two(window: int, values: Mapping[str, float]) -> FloatArray:
        return np.column_stack([linear(window, values), 30 * linear(window, values)])

    found = fitted(question(two, LINEAR, FREE, windows=12), two)
    for name in LINEAR:
        assert found.ci95[name] == pytest.approx(found.local95[name], rel=1e-3)


def test_a_robust_loss_has_the_intervals_of_its_curvature() -> None:
    problem = question(linear, LINEAR, FREE, windows=40)
    found = fitted(replace(problem, loss=Loss("huber", 0.2)), linear)
    for name in LINEAR:
        (low, high), local = found.ci95[name], found.local95[name]
        assert high - low == pytest.approx(local[1] - local[0], rel=0.02)


def test_a_side_that_the_data_do_not_exclude_is_open_and_said() -> None:
    slow = Parameter("m.rate", 0.1, 0.0, 100.0)
    found = fitted(question(decay, {"m.rate": 0.05}, (slow,), noise=0.5), decay)
    low, high = found.ci95["m.rate"]
    assert low == -math.inf and 0.05 < high < 2.0
    assert dict(found.intervals.profiles["m.rate"].open) == {"lower": "the data do not exclude its bound"}
    assert any("m.rate: its 95 % interval has no lower end" in warning for warning in found.warnings)
    assert found.intervals.profiles["m.rate"].values.min() == 0.0, "the curve goes as far as the bound"


def test_no_run_leaves_the_bounds() -> None:
    tried: list[float] = []

    def watched(window: int, values: Mapping[str, float]) -> FloatArray:
        tried.append(values["m.rate"])
        return decay(window, values)

    fitted(question(decay, {"m.rate": 0.5}, (Parameter("m.rate", 0.5, 0.45, 0.55),)), watched)
    assert min(tried) >= 0.45 and max(tried) <= 0.55


def test_where_runs_fail_the_interval_is_open() -> None:
    def failing(window: int, values: Mapping[str, float]) -> FloatArray:
        if values["m.rate"] > 2.2:
            raise FmuError("m", "too fast")
        return decay(window, values)

    found = fitted(question(decay, {"m.rate": 2.0}, (Parameter("m.rate", 1.5, 0.0, 9.0),), noise=0.3), failing)
    assert found.ci95["m.rate"][1] == math.inf
    assert found.intervals.profiles["m.rate"].open["upper"] == "runs beyond it fail"


def test_a_parameter_that_does_nothing_has_no_profile_and_no_interval() -> None:
    nothing = Parameter("m.nothing", 1.0, 0.0, 2.0)
    found = fitted(question(decay, {"m.rate": 2.0}, (Parameter("m.rate", 1.5, 0.0, 9.0), nothing)), decay)
    assert set(found.intervals.profiles) == {"m.rate"}
    assert found.ci95["m.nothing"] == (-math.inf, math.inf)
    assert not found.converged and found.message == f"{SILENT} m.nothing"
    assert math.isfinite(found.ci95["m.rate"][0])


def test_parameters_that_only_go_together_reach_as_far_as_their_bounds() -> None:
    def product(window: int, values: Mapping[str, float]) -> FloatArray:
        return (values["m.a"] * values["m.b"] * TIME)[:, None]

    both = tuple(Parameter(name, 1.0, 0.1, 10.0, scale="log") for name in ("m.a", "m.b"))
    found = fitted(question(product, {"m.a": 1.0, "m.b": 2.0}, both), product)
    curve = found.intervals.profiles["m.a"]
    assert set(curve.open) == {"upper"} and dict(curve.held_by) == {"lower": ("m.b",)}
    assert found.ci95["m.a"] == (pytest.approx(0.2, rel=0.1), math.inf)
    assert any("m.a: the lower end of its 95 % interval is where m.b cannot" in warning for warning in found.warnings)


def test_a_better_point_met_on_the_way_becomes_the_estimate() -> None:
    """The search ends in a valley beside the right one; the profile climbs out of it and sees that."""
    time = np.linspace(0.0, 20.0, 120)

    def sine(window: int, values: Mapping[str, float]) -> FloatArray:
        return np.sin(values["m.rate"] * time)[:, None]

    problem = question(sine, {"m.rate": 2.0}, (Parameter("m.rate", 2.35, 1.0, 3.0),), noise=1.0)
    local = fitted(problem, sine, replace(PROFILE, intervals=IntervalOptions()))
    assert local.values["m.rate"] > 2.3
    found = fitted(problem, sine)
    low, high = found.ci95["m.rate"]
    assert low < 2.0 < high < 2.1 and found.cost < local.cost


def test_what_is_tied_has_the_interval_of_the_other() -> None:
    def both(window: int, values: Mapping[str, float]) -> FloatArray:
        return decay(window, {"m.rate": values["m.rate"] - 0.5 * values["m.other"]})

    rate = Parameter("m.rate", 1.5, 0.0, 100.0)
    tied = (Tie("m.other", "m.rate", -2.0),)
    found = fitted(question(both, {"m.rate": 1.0, "m.other": -2.0}, (rate,), noise=0.3, ties=tied), both)
    low, high = found.ci95["m.rate"]
    assert found.ci95["m.other"] == pytest.approx((-2 * high, -2 * low))


def test_a_perfect_match_has_local_intervals_and_says_so() -> None:
    found = fitted(question(decay, {"m.rate": 2.0}, (Parameter("m.rate", 1.5, 0.0, 9.0),), noise=0.0), decay)
    assert found.intervals.by == "local"
    assert any("no noise to hold values against" in warning for warning in found.warnings)


@pytest.mark.slow
def test_profiles_cover_where_local_intervals_do_not() -> None:
    """A decay of which few samples tell: the likelihood is far from a parabola, and mostly flat to one side."""
    inside = np.zeros(2)
    draws = 300
    for seed in range(draws):
        rate = Parameter("m.rate", 8.0, 1e-3, 1e3)
        found = fitted(question(decay, {"m.rate": 8.0}, (rate,), noise=0.3, seed=seed), decay)
        intervals = (found.ci95["m.rate"], found.local95["m.rate"])
        inside += [low <= 8.0 <= high for low, high in intervals]
    low, high = stats.binom.interval(0.999, draws, 0.95)
    assert low <= inside[0] <= high, inside / draws
    assert inside[1] < low, inside / draws
