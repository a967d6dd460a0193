"""Difference steps by the noise that simulations have of themselves: of an FMU whose noise is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identification.estimation.arrow_least_squares import LEAST_SQUARES, Iterate, Point, evaluated
from identification.estimation.parameters import Parameter, ParameterSet
from identification.estimation.workers import LocalPool
from identification.output_error.search.free_run import FreeRun, Tally
from identification.output_error.search.problem import Problem, Window
from identification.output_error.search.roughness import roughness
from identification.output_error.search.steps import moved
from orchestrator import formats
from orchestrator.trace import FloatArray, Trace
from tests.support.identification.small_study import calibrated, write_study

RIPPLE = 1e-4
LAG = f'''"""A lag whose reading has a ripple so fine that it is noise."""
from . import Model, State, input_, ops, output, parameter

MODEL = Model(
    name="lag",
    description="Lag with a ripple",
    variables=(
        input_("drive", "1", "Drive"),
        output("reading", "1", "State with the ripple"),
        parameter("gain", "1", 1.0, "Gain"),
        parameter("lag", "s", 0.5, "Time constant", minimum=1e-3),
    ),
    states=(State("level", 0.0),),
    derivatives=lambda t, x, u, p: {{"level": (p.gain * u.drive - x.level) / p.lag}},
    solver_step=lambda p: 0.01,
    outputs=lambda t, x, u, p: {{"reading": x.level + {RIPPLE} * ops.sin(1e9 * x.level)}},
)
'''
TIME = np.arange(201) * 0.02


class Rippled:
    """The step answer of that lag, by its formula, with a ripple of a size."""

    def __init__(self, ripple: float) -> None:
        self._ripple = ripple

    def simulate(self, window: int, values: Any) -> FloatArray:
        level = values["lag.gain"] * (1 - np.exp(-TIME / values["lag.lag"]))
        return np.asarray((level + self._ripple * np.sin(1e9 * level))[:, None])

    def close(self) -> None:
        """Nothing is open."""


def run_of(ripple: float) -> tuple[FreeRun, Iterate]:
    """Free runs with a ripple, and the start."""
    parameters = ParameterSet((Parameter("lag.gain", 1.0, 0.1, 10.0), Parameter("lag.lag", 0.5, 0.05, 5.0)))
    measured = Rippled(0.0).simulate(0, {"lag.gain": 1.2, "lag.lag": 0.6})
    problem = Problem(parameters, (Window("w", "w", measured, np.ones(1)),), ("lag.reading",))
    run = FreeRun(problem, LocalPool(lambda: Rippled(ripple)), Tally(), (0,), 1e-4)
    here = evaluated(run, problem.start([0]), LEAST_SQUARES)
    assert here is not None
    return run, here


def off(run: FreeRun, here: Iterate, column: int, step: float) -> float:
    """By which part of it a forward difference with this step is off the slope of the lag without its ripple."""
    smooth, at = run_of(0.0)
    shifts = [moved(at.point, column, h) for h in (1e-5, -1e-5)]
    above, below = ((smooth.residuals(point) or [])[0] for point in shifts)
    true = (above - below) / 2e-5
    there = (run.residuals(moved(here.point, column, step)) or [])[0]
    return float(np.linalg.norm((there - here.residuals[0]) / step - true) / np.linalg.norm(true))


@pytest.mark.parametrize("ripple", [1e-3, 1e-5, 1e-8])
def test_noise_is_measured_and_steps_are_near_the_best(ripple: float) -> None:
    run, here = run_of(ripple)
    found = roughness(run, here, [0, 1])
    assert [*found] == [0, 1]
    for column, one in found.items():
        assert one.noise == pytest.approx(ripple / np.sqrt(2), rel=0.3)
        best = min(off(run, here, column, float(step)) for step in np.geomspace(1e-7, 0.03, 30))
        assert off(run, here, column, one.step) < max(5 * best, 1e-3)
    if ripple > 1e-6:
        assert off(run, here, 1, found[1].step) < 0.2 * off(run, here, 1, run.step)


@pytest.mark.parametrize("ripple", [1e-5, 1e-6])
def test_steps_balance_the_noise_against_the_curvature_or_stay_where_was_looked_when_noise_hides_it(
    ripple: float,
) -> None:
    """Of the time constant by the steps of the source; the gain is linear and has no curvature."""
    (run, here), (smooth, at) = run_of(ripple), run_of(0.0)
    gain, lag = roughness(run, here, [0, 1]).values()
    ahead, middle, behind = ((smooth.residuals(moved(at.point, 1, h)) or [])[0] for h in (3e-3, 0.0, -3e-3))
    curvature = float(np.sqrt(np.mean((ahead - 2 * middle + behind) ** 2))) / 3e-3**2
    noise = ripple / np.sqrt(2)
    assert lag.step == pytest.approx(8**0.25 * np.sqrt(noise / curvature), rel=0.1)
    assert lag.central == pytest.approx((3 * noise / curvature) ** (1 / 3), rel=0.1)
    assert gain.step == pytest.approx(0.03, rel=0.1)


def test_what_is_smooth_has_no_noise_and_the_step_that_is_asked_for() -> None:
    run, here = run_of(0.0)
    found = roughness(run, here, [0, 1])
    assert [*found] == [0, 1]
    assert all(one.noise < 1e-10 and one.step == run.step for one in found.values())


class Gridded(Rippled):
    """One that switches on a grid of 5 ms."""

    def simulate(self, window: int, values: Any) -> FloatArray:
        return super().simulate(window, {**values, "lag.lag": 0.005 * np.ceil((values["lag.lag"] - 1e-3) / 0.005)})


def test_what_acts_in_steps_is_not_taken_for_noise() -> None:
    run, _ = run_of(0.0)
    run = replace(run, pool=LocalPool(lambda: Gridded(0.0)))
    here = evaluated(run, run.problem.start([0]), LEAST_SQUARES)
    assert here is not None
    ahead = run.residuals(moved(here.point, 1, 4e-3))
    assert ahead is not None and float(np.abs(ahead[0] - here.residuals[0]).max()) > 1e-3  # within the row
    assert 1 not in roughness(run, here, [0, 1])


def test_what_has_no_room_between_its_bounds_is_left_out() -> None:
    run, here = run_of(1e-5)
    cornered = Point(np.array([run.problem.parameters.z_bounds[0][0], 0.0]), here.point.states)
    there = evaluated(run, cornered, LEAST_SQUARES)
    assert there is not None and list(roughness(run, there, [0, 1])) == [1]


@pytest.mark.slow
@pytest.mark.usefixtures("in_this_process")
def test_an_fmu_with_noise_is_fitted_and_the_summary_says_how_rough_it_is(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    drive = np.repeat(random.uniform(-1, 1, 21), 10)[:201]
    level = np.zeros(201)
    for k in range(200):
        level[k + 1] = 1.3 * drive[k] + (level[k] - 1.3 * drive[k]) * np.exp(-0.02 / 0.4)
    signals = {"drive": drive, "reading": level + random.normal(0, 1e-3, 201)}
    (tmp_path / "data").mkdir()
    formats.write(Trace(TIME, signals), tmp_path / "data" / "rig_0.csv")
    (tmp_path / "lag.py").write_text(LAG)
    study = write_study(
        tmp_path / "study.yaml",
        components={"lag": {"model": "lag.py", "solver": {"method": "RK45", "relative_tolerance": 1e-6}}},
        connections=None,
        step=0.02,
        traces={"files": "rig_*.csv"},
        inputs={"lag.drive": {"signal": "drive"}},
        outputs={"lag.reading": {"signal": "reading"}},
        windows={"length": 4},
        validation=None,
        weight="none",
        parameters={
            "lag.gain": {"start": 1.0, "min": 0.1, "max": 10},
            "lag.lag": {"start": 0.5, "min": 0.05, "max": 5},
        },
        truth={"lag.gain": 1.3, "lag.lag": 0.4},
    )
    found = calibrated(study, tmp_path / "data", tmp_path / "out")
    for entry in found["search"]["rough"].values():
        assert entry["noise"] == pytest.approx(RIPPLE / np.sqrt(2), rel=0.3) and entry["step"] > 1e-3
    for entry in found["parameters"].values():
        assert abs(entry["value"] - entry["truth"]) < 2 * (entry["ci95"][1] - entry["value"])
    assert found["search"]["converged"]
