"""Recordings that come less often than steps are compared at their own samples, wherever these lie."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from fmus.errors import IdentificationError, TraceError
from identification.output_error.calibration import PreparedStudy
from identification.output_error.free_runs.window import FreeRunWindow
from identification.output_error.search.estimate import Estimate
from identification.output_error.shooting.segments import segments
from identification.output_error.windows import cut_windows
from identification.recordings.campaign import StudyTrace
from orchestrator import run
from orchestrator.fmi.interface import Port
from orchestrator.trace import FloatArray, Trace
from tests.support.identification.small_study import calibrated, plain_study, record, write_study

pytestmark = pytest.mark.usefixtures("in_this_process")

STEP, EVERY = 0.001, 0.01  # of the free runs, and between samples [s]
TRUTH = {"hand.inertia": 0.00325, "hand.gravity_torque": 0.04905, "hand.viscous_friction": 0.001}
GAIN, NOISE, DRAWS = 10.0, 2e-3, 60
HELD = {"motor.voltage": {"signal": "voltage", "interpolation": "hold"}}
Stamps = Literal["at steps", "beside steps", "jittering"]


def recording(time: FloatArray, angle: FloatArray, name: str = "run", **signals: FloatArray) -> StudyTrace:
    trace = Trace(time, {"voltage": voltage(time), "angle": angle, **signals}, name=name)
    return StudyTrace(trace, {}, Path(f"{name}.csv"), "", "even", values={"hand.added_mass": 0.0})


def voltage(time: FloatArray) -> FloatArray:
    """(K,) a sine of 4 Hz, of which each sample is held until the next [V]."""
    return np.asarray(0.2 * np.sin(8 * np.pi * time + 1.5))


def cuts(recorded: StudyTrace, ports: dict[str, Port] | None = None, **changes: Any) -> list[FreeRunWindow]:
    asked = plain_study(**{"step": STEP, "windows": {"length": 0.5}, "initial": {}, **changes})
    return cut_windows(asked.run, [recorded], asked.windows, ports)


def squares(every: float, count: int, offset: float = 0.0) -> StudyTrace:
    time = offset + np.arange(count) * every
    return recording(time, time**2)


@pytest.mark.parametrize("offset", [0.0, 0.00037])
def test_a_window_holds_the_samples_within_it_and_the_free_run_at_their_instants(offset: float) -> None:
    for window in cuts(squares(EVERY, 121, offset)):
        inside = np.arange(121) * EVERY + offset
        inside = inside[(inside > window.start - 1e-9) & (inside < window.start + 0.5 + 1e-9)]
        np.testing.assert_allclose(window.time, inside, atol=1e-12)
        np.testing.assert_allclose(window.measured[:, 0], inside**2, atol=1e-12)
        np.testing.assert_allclose(window.recorded(window.run_time[:, None] ** 2, {})[:, 0], inside**2, atol=1e-12)


def test_recordings_of_one_study_are_compared_each_at_its_rate() -> None:
    asked = plain_study(step=STEP, windows={"length": 0.5, "most": 1}, initial={})
    rates = {EVERY: 51, 0.002: 251, STEP: 501, 0.0005: 501}  # the last comes more often, and is read at the steps
    found = cut_windows(asked.run, [squares(every, round(0.6 / every)) for every in rates], asked.windows)
    assert [len(window.measured) for window in found] == list(rates.values())


def test_outputs_with_delays_of_their_own_are_compared_with_the_same_samples() -> None:
    time = np.arange(121) * EVERY
    outputs = {
        "hand.angle": {"signal": "angle", "delay": 0.0134},
        "hand.speed": {"signal": "speed", "delay": "lag"},
        "hand.energy": {"signal": "energy"},
    }
    free = {**plain_study_parameters(), "lag": {"start": 0.0, "min": -0.005, "max": 0.007}}
    recorded = recording(time, (time - 0.0134) ** 2, speed=time, energy=2 * time)
    window = cuts(recorded, outputs=outputs, parameters=free)[0]
    np.testing.assert_allclose(window.time, time[(time >= 0.0134) & (time <= 0.5 - 0.005)])
    simulated = np.column_stack([window.run_time**2, window.run_time, 2 * window.run_time])
    found = window.recorded(simulated, {"lag": 0.0})
    np.testing.assert_allclose(found, window.measured, atol=1e-12)
    late = window.recorded(simulated, {"lag": 0.002})
    np.testing.assert_allclose(late - found, [[0.0, -0.002, 0.0]] * len(found), atol=1e-12)


def plain_study_parameters() -> dict[str, Any]:
    return {name: {"start": value, "max": 1.0} for name, value in TRUTH.items()}


def test_an_output_that_changes_in_steps_has_the_value_of_the_step_before() -> None:
    time = 0.00037 + np.arange(121) * EVERY
    counter = Port("angle", 0, "Integer", "output")
    window = cuts(recording(time, np.floor(10 * time)), {"hand.angle": counter})[0]
    simulated = np.floor(10 * window.run_time + 1e-9)[:, None]
    np.testing.assert_array_equal(window.recorded(simulated, {}), window.measured)


@pytest.mark.parametrize("offset", [0.0, 0.00037])
def test_segments_share_out_the_samples_of_a_window(offset: float) -> None:
    [window, *_] = cuts(squares(EVERY, 121, offset))
    parts = segments(window, 4, (0,), "shooting")
    np.testing.assert_allclose(np.concatenate([part.time for part in parts]), window.time)
    np.testing.assert_array_equal(np.concatenate([part.measured for part in parts]), window.measured)
    with pytest.raises(IdentificationError, match="with 1 instants to compare; cut into fewer"):
        segments(window, 50, (0,), "shooting")


def test_a_window_of_less_than_two_samples_is_refused() -> None:
    with pytest.raises(TraceError, match=r"run: has a sample every 0\.01 s, fewer than two in the window from 0 s"):
        cuts(squares(EVERY, 121), windows={"length": 0.009})
    assert {len(cut.measured) for cut in cuts(squares(EVERY, 121), windows={"length": EVERY})} == {2}


def test_the_exported_free_run_has_every_step(tmp_path: Path) -> None:
    file = write_study(tmp_path / "study.yaml", step=STEP, inputs=HELD)
    calibrated(file, record(tmp_path / "data"), tmp_path / "out")
    [case] = run(tmp_path / "out" / "free_run.yaml").cases
    [check] = case.checks
    assert case.passed and check.figure == pytest.approx(0.0, abs=1e-9)
    assert (tmp_path / "out" / "free_run_outputs.csv").read_text().count("\n") == 1001 + 1


def stamps(kind: Stamps, rng: np.random.Generator) -> FloatArray:
    """(201,) 2 s of them [s]."""
    time = np.arange(201) * EVERY
    if kind == "jittering":
        time[1:-1] += rng.uniform(-1e-3, 1e-3, 199)
    return np.asarray(time + 0.00037 * (kind == "beside steps"))


def solved(time: FloatArray, inertia: float, gravity: float, friction: float) -> FloatArray:
    """(K,) the angle at these stamps, at rest until the first step after the first of them, by SciPy alone."""
    begin, angle, state = STEP * np.ceil(time[0] / STEP - 1e-9), [0.0], np.zeros(2)

    def moved(_: float, x: FloatArray, volts: float) -> list[float]:
        return [x[1], (GAIN * volts - friction * x[1] - gravity * np.sin(x[0])) / inertia]

    for at, after, volts in zip(time, time[1:], voltage(time), strict=False):
        span = (max(at, begin), after)
        state = solve_ivp(moved, span, state, "DOP853", args=(volts,), rtol=1e-9, atol=1e-12).y[:, -1]
        angle.append(float(state[0]))
    return np.array(angle)


def drawn(kind: Stamps, seed: int) -> tuple[FloatArray, FloatArray]:
    """(K,) stamps and (K,) noisy angles."""
    rng = np.random.default_rng([3, seed])
    time = stamps(kind, rng)
    return time, solved(time, *TRUTH.values()) + rng.normal(0, NOISE, len(time))


def estimated(time: FloatArray, angle: FloatArray) -> Estimate:
    asked = plain_study(
        step=STEP,
        components={"motor": {"model": "dc_motor"}, "hand": {"model": "pendulum"}},
        traces={"files": "run.csv"},
        inputs=HELD,
        windows={"length": 1.99},
        validation=None,
        parameters={
            **{name: {"start": 1.1 * value, "min": 0, "max": 10 * value} for name, value in TRUTH.items()},
            "motor.torque_gain": {"start": GAIN, "fixed": True},
        },
        truth=None,
    )
    return PreparedStudy.of(asked, [recording(time, angle)]).calibrated().estimate


@pytest.mark.parametrize("kind", ["at steps", "jittering"])
def test_estimates_and_deviations_are_those_of_scipy_at_the_samples(kind: Stamps) -> None:
    time, angle = drawn(kind, 0)
    shown = (time > -1e-9) & (time < 1.99 + 1e-9)
    start, size = np.ones(3), np.array(list(TRUTH.values()))
    other = least_squares(lambda z: (solved(time, *(z * size)) - angle)[shown], start, x_scale=1e-2, diff_step=1e-5)
    variance = 2 * other.cost / (np.count_nonzero(shown) - 3)
    std = size * np.sqrt(np.diag(np.linalg.inv(other.jac.T @ other.jac)) * variance)
    found = estimated(time, angle)
    assert found.uncertainty.is_white
    for i, name in enumerate(TRUTH):
        assert found.values[name] == pytest.approx(other.x[i] * size[i], abs=0.3 * std[i])  # inputs by means of steps
        assert found.std[name] == pytest.approx(std[i], rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["at steps", "beside steps", "jittering"])
def test_its_intervals_hold_the_truth_and_its_estimates_are_without_bias(kind: Stamps) -> None:
    found = [estimated(*drawn(kind, seed)) for seed in range(DRAWS)]
    least = stats.binom.ppf(1e-3, DRAWS, 0.95)
    for name, true in TRUTH.items():
        off = np.array([one.values[name] / true - 1 for one in found])
        assert sum(low <= true <= high for low, high in (one.ci95[name] for one in found)) >= least
        assert abs(off.mean()) < 1e-4 + 4 * off.std() / np.sqrt(DRAWS)
    assert sum(not one.uncertainty.is_white for one in found) <= stats.binom.ppf(0.999, DRAWS, 0.02)
