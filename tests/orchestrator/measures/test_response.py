"""Figures of a step response are those of python-control and of the closed forms."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import TraceError
from orchestrator.measures import (
    final_value,
    overshoot,
    peak,
    residual_rms,
    retreat,
    rise_time,
    settling_time,
    steady_error,
)

PLANTS = {
    "second order": control.tf([4.0], [1.0, 0.8, 4.0]),
    "first order": control.tf([3.0], [2.0, 1.0]),
    "with a zero": control.tf([2.0, 1.0], [1.0, 1.2, 1.0]),
    "downwards": control.tf([-2.0], [1.0, 0.6, 1.0]),
}


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
def test_figures_are_those_of_python_control(plant: control.TransferFunction) -> None:
    t = np.linspace(0.0, 40.0, 8001)
    y = control.step_response(plant, t).outputs
    final = float(plant.dcgain())
    other = control.step_info(y, t, final_output=final)
    sample = t[1]
    assert rise_time(t, y, 0.0, final) == pytest.approx(other["RiseTime"], abs=sample)
    assert settling_time(t, y, final, 0.02 * abs(final)) == pytest.approx(other["SettlingTime"], abs=sample)
    assert 100 * overshoot(t, y, 0.0, final) == pytest.approx(other["Overshoot"], abs=1e-6)
    assert peak(t, y) == pytest.approx((other["Peak"], other["PeakTime"]))
    assert final_value(t, y) == pytest.approx(other["SteadyStateValue"], rel=1e-3)


@given(st.floats(0.1, 0.9), st.floats(0.5, 20.0), st.floats(-10.0, 10.0), st.floats(0.1, 5.0))
def test_a_second_order_system_overshoots_by_its_damping(zeta: float, w: float, start: float, step: float) -> None:
    damped = w * math.sqrt(1 - zeta**2)
    t = np.linspace(0.0, 3 * math.pi / damped, 3001)
    decay = np.exp(-zeta * w * t)
    y = start + step * (1 - decay * (np.cos(damped * t) + zeta * w / damped * np.sin(damped * t)))
    expected = math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2))
    assert overshoot(t, y, start, start + step) == pytest.approx(expected, rel=1e-4, abs=1e-9)
    assert peak(t, y, start)[1] == pytest.approx(math.pi / damped, abs=2 * t[1])


@given(st.integers(20, 200), st.integers(0, 1000))
def test_times_of_a_first_order_lag_do_not_depend_on_where_the_samples_lie(count: int, seed: int) -> None:
    t = np.append(0.0, np.sort(np.random.default_rng(seed).uniform(0.0, 8.0, count)))
    t = np.unique(np.append(t, 8.0))
    y = 1 - np.exp(-t)
    coarse = float(np.diff(t).max())
    assert settling_time(t, y, 1.0, 0.05) == pytest.approx(math.log(20), abs=coarse)
    assert rise_time(t, y, 0.0, 1.0) == pytest.approx(math.log(9), abs=2 * coarse)


def test_levels_are_met_on_the_line_or_at_the_sample_that_has_them() -> None:
    t, y = np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.0, 1.0, 2.0, 2.0])
    assert settling_time(t, y, 2.0, 0.5) == pytest.approx(1.5)
    assert settling_time(t, y, 2.0, 0.5, hold=True) == 2.0
    assert rise_time(t, y, 0.0, 2.0) == pytest.approx(1.6)
    assert rise_time(t, y, 0.0, 2.0, hold=True) == 1.0
    assert final_value(t, y, 1.5) == pytest.approx((0.5 * 1.75 + 2.0) / 1.5)
    assert final_value(t, y, 1.5, hold=True) == pytest.approx((0.5 * 1.0 + 2.0) / 1.5)


def test_what_does_not_happen_has_no_time() -> None:
    t = np.linspace(0.0, 1.0, 11)
    assert settling_time(t, t, 2.0, 0.1) is None
    assert residual_rms(t, t, 2.0, 0.1) is None
    assert rise_time(t, t, 0.0, 2.0) is None
    assert settling_time(t, t, 0.5, 0.6) == 0.0
    assert overshoot(t, t, 0.0, 2.0) == 0.0


def test_what_is_left_is_measured_from_the_settling_on() -> None:
    t = np.linspace(0.0, 100.0, 100_001)
    y = np.where(t < 10, 5.0, 1.0 + 0.1 * np.sin(t))
    assert residual_rms(t, y, 1.0, 0.2) == pytest.approx(0.1 / math.sqrt(2), rel=0.02)
    assert steady_error(t, y, 1.0, over=2 * math.pi) == pytest.approx(0.0, abs=1e-6)
    assert steady_error([0.0, 1.0], [0.0, 3.0], 2.0) == 1.0


def test_a_signal_retreats_by_how_far_it_goes_back() -> None:
    t, y = np.arange(5.0), np.array([0.0, 2.0, 1.5, 3.0, 2.8])
    assert retreat(t, y) == 0.5
    assert retreat(t, -y, falling=True) == 0.5
    assert retreat(t, y, falling=True) == 3.0
    assert retreat(t, np.sort(y)) == 0.0


def test_what_cannot_be_told_is_refused() -> None:
    with pytest.raises(TraceError, match="starts at its target, 1"):
        overshoot([0.0, 1.0], [1.0, 1.0], 1.0, 1.0)
    with pytest.raises(TraceError, match="is to be taken over 2 s of 1 s"):
        final_value([0.0, 1.0], [1.0, 1.0], over=2.0)
