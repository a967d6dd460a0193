"""An output that comes ten times as seldom as it is compared: what lies between samples narrows no interval."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from scipy import stats

from identification.estimation.parameters import Parameter, ParameterSet
from identification.output_error.search.estimate import Estimate
from identification.output_error.search.estimator import estimate
from identification.output_error.search.options import IntervalOptions, SearchOptions
from identification.output_error.search.problem import Problem, Window
from orchestrator.trace import FloatArray

TIME = np.arange(1001) * 1e-3
EACH, NOISE, DRAWS = 10, 0.05, 60
TRUTH = {"m.size": 1.0, "m.rate": 6.0}
WEIGHT = np.full(2, 1 / NOISE)
Between = Literal["lines", "held"]


class Swing:
    """Two outputs of a swing, in closed form."""

    def simulate(self, window: int, values: Mapping[str, float]) -> FloatArray:
        return values["m.size"] * np.column_stack((np.sin(values["m.rate"] * TIME), np.cos(values["m.rate"] * TIME)))

    def close(self) -> None:
        return None


def slow(noise: FloatArray, between: Between) -> FloatArray:
    """Noise (K,) of every tenth sample, carried on to all."""
    if between == "lines":
        return np.asarray(np.interp(TIME, TIME[::EACH], noise[::EACH]))
    return np.repeat(noise[::EACH], EACH)[: len(noise)]


def fitted(between: Between, seed: int, options: SearchOptions) -> Estimate:
    noise = NOISE * np.random.default_rng(seed).standard_normal((len(TIME), 2))
    noise[:, 1] = slow(noise[:, 1], between)
    measured = Swing().simulate(0, TRUTH) + noise
    free = ParameterSet((Parameter("m.size", 1.05), Parameter("m.rate", 6.02)))
    return estimate(Problem(free, (Window("w", "t", measured, WEIGHT),), ("fast", "slow")), Swing, options)


@pytest.mark.slow
@pytest.mark.parametrize("between", ["lines", "held"])
def test_its_intervals_hold_the_truth_as_often_as_they_say(between: Between) -> None:
    held, least = dict.fromkeys(TRUTH, 0), stats.binom.ppf(1e-3, DRAWS, 0.95)
    for seed in range(DRAWS):
        found = fitted(between, seed, SearchOptions())
        for name, true in TRUTH.items():
            held[name] += found.ci95[name][0] <= true <= found.ci95[name][1]
    assert all(count >= least for count in held.values()), held


@pytest.mark.parametrize("between", ["lines", "held"])
def test_profiles_allow_for_it_as_local_intervals_do_and_what_it_tells_is_said(between: Between) -> None:
    found = fitted(between, 1, replace(SearchOptions(), intervals=IntervalOptions("profile")))
    for name in TRUTH:
        assert found.ci95[name] == pytest.approx(found.local95[name], rel=2e-3)
    fast, coarse = found.noise
    assert fast.samples_each < 2 < coarse.samples_each == pytest.approx(EACH, rel=0.5)
    assert any("residuals are not white, of slow" in warning for warning in found.warnings)
