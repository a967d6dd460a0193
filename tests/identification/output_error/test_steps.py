"""Parameters that act in steps: what is flat is within the interval, what has no effect has none, and both are said."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from identification.estimation.parameters import Parameter, ParameterSet
from identification.output_error.search.estimator import SILENT, estimate
from identification.output_error.search.problem import Problem, Window
from tests.support.identification.closed_form import INSTANTS

TRUE = {"rig.switch": 1.234, "rig.rate": 0.7}
GRID = 0.1  # [s], on which the switch acts
PARAMETERS = (Parameter("rig.switch", 0.62, 0.2, 3.0, "s"), Parameter("rig.rate", 0.4, 0.1, 2.0))


def switched(values, time=INSTANTS):
    """(K, 1) a rise that begins at the first instant of a clock of `GRID` after the switch."""
    begin = GRID * math.ceil(values["rig.switch"] / GRID)
    return (values["rig.rate"] * np.maximum(time - begin, 0.0) + 0.2 * np.sin(time))[:, None]


class Switched:
    def simulate(self, window, values):
        return switched(values)

    def close(self):
        pass


def problem(seed=0, noise=0.01, parameters=PARAMETERS, truth=TRUE, windows=3):
    rng = np.random.default_rng(seed)
    clean = switched(truth)
    cut = [Window(f"{i}", "bench", clean + noise * rng.normal(size=clean.shape), np.ones(1)) for i in range(windows)]
    return Problem(ParameterSet(parameters), tuple(cut), ("y",))


@pytest.mark.parametrize("seed", range(5))
def test_a_parameter_that_acts_in_steps_has_its_flat_range_within_its_interval(seed):
    truth = {"rig.switch": float(np.random.default_rng(seed).uniform(0.9, 1.8)), "rig.rate": 0.7}
    found = estimate(problem(seed, truth=truth), Switched)
    low, high = found.flat["rig.switch"]
    step = GRID * math.floor(truth["rig.switch"] / GRID)
    assert step - 5e-4 < low <= step and step + GRID <= high < step + GRID + 5e-4
    (bottom, top) = found.ci95["rig.switch"]
    assert bottom <= min(low, truth["rig.switch"]) and max(high, truth["rig.switch"]) <= top
    assert found.values["rig.rate"] == pytest.approx(0.7, abs=0.03)
    assert any("rig.switch acts in steps" in warning for warning in found.warnings)


@pytest.mark.slow
def test_intervals_hold_the_truth_in_95_of_100_draws_where_one_parameter_acts_in_steps():
    found = [estimate(problem(seed), Switched).ci95 for seed in range(40)]
    held = {name: sum(low <= TRUE[name] <= high for low, high in (ci[name] for ci in found)) for name in TRUE}
    assert min(held.values()) >= 35  # of 40: 1 in 400 by chance where 95 % hold


def test_a_smooth_parameter_is_not_said_to_act_in_steps():
    fixed = replace(PARAMETERS[0], start=TRUE["rig.switch"], fixed=True)
    found = estimate(problem(parameters=(fixed, PARAMETERS[1])), Switched)
    assert not found.flat and found.converged


def test_a_parameter_without_effect_has_no_interval_and_the_search_has_not_converged():
    idle = Parameter("rig.idle", 1.0, 0.1, 10.0, scale="log")
    found = estimate(problem(parameters=(*PARAMETERS, idle)), Switched)
    assert not found.converged and found.message == f"{SILENT} rig.idle"
    assert math.isinf(found.std["rig.idle"]) and "rig.idle" not in found.flat
    assert found.values["rig.rate"] == pytest.approx(0.7, abs=0.03)


def test_a_parameter_that_acts_on_one_side_only_is_open_to_the_other():
    """A switch after the end of the recording: later ones are all the same."""
    late = {"rig.switch": 3.95, "rig.rate": 0.7}
    parameters = (Parameter("rig.switch", 3.97, 0.2, 9.0, "s"), replace(PARAMETERS[1], start=0.7, fixed=True))
    found = estimate(problem(parameters=parameters, truth=late), Switched)
    assert found.flat["rig.switch"][1] == 9.0 and found.flat["rig.switch"][0] > 3.5


class Lying(Switched):
    """Best where it starts, by cliffs on both sides; slopes lead away from there."""

    def simulate(self, window, values):
        offset = values["rig.rate"] - 0.4
        cliff = 0.3 * (abs(offset) > 1e-9) * np.cos(40 * INSTANTS)[:, None]
        return switched({"rig.switch": 1.234, "rig.rate": 0.4}) + 5.0 * offset + cliff


@pytest.mark.parametrize(("beside", "converged"), [(0.0, True), (1e-6, True), (0.01, False)])
def test_a_search_that_finds_no_better_point_has_converged_only_where_little_is_left_over(beside, converged):
    start = Lying().simulate(0, {"rig.rate": 0.4})
    cut = Window("w", "bench", start + beside, np.ones(1))
    found = estimate(Problem(ParameterSet((PARAMETERS[1],)), (cut,), ("y",)), Lying)
    assert found.values["rig.rate"] == pytest.approx(0.4, abs=1e-9)
    assert found.converged == converged == ("while slopes promise 0.023 of FIT" not in found.message)


@pytest.mark.parametrize("effect", [1e-4, 5e-4, 1e-3])
def test_a_parameter_on_a_log_scale_of_which_not_even_the_size_is_known_has_a_reason_and_no_interval(effect):
    faint = Parameter("rig.faint", 1.0, 1e-12, 1e12, scale="log")

    class Faint(Switched):
        def simulate(self, window, values):
            return switched(values) + effect * values["rig.faint"] * np.cos(INSTANTS)[:, None]

    fixed = replace(PARAMETERS[0], start=TRUE["rig.switch"], fixed=True)
    found = estimate(problem(parameters=(fixed, PARAMETERS[1], faint)), Faint)
    low, high = found.ci95["rig.faint"]
    assert math.isinf(found.std["rig.faint"]) and low <= 0 and math.isinf(high)
    assert any("rig.faint" in warning for warning in found.warnings)
    assert math.isfinite(found.std["rig.rate"])
