"""The motor against its static relation and against the exponential of its electrical mode."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus import library
from fmus.modelling.instance import Instance
from tests.support.fmus.stepping import grid, stepped

MOTOR = library.find("dc_motor")
MILD = st.floats(0.1, 10)


def settled(values: dict[str, float], voltage: float, speed: float = 0.0) -> tuple[float, float]:
    """Torque and current of the static motor."""
    instance = Instance(MOTOR, values)
    instance.set("voltage", voltage)
    instance.set("speed", speed)
    return instance.get("torque"), instance.get("current")


@given(voltage=st.floats(-20, 20), speed=st.floats(-50, 50), gain=MILD, resistance=MILD, back_emf=st.floats(0, 1))
def test_without_inductance_torque_and_current_follow_the_static_relation(
    voltage: float, speed: float, gain: float, resistance: float, back_emf: float
) -> None:
    torque, current = settled({"torque_gain": gain, "resistance": resistance, "back_emf": back_emf}, voltage, speed)
    assert current == pytest.approx((voltage - back_emf * speed) / resistance, rel=1e-12, abs=1e-12)
    assert torque == pytest.approx(gain * (voltage - back_emf * speed), rel=1e-12, abs=1e-12)


@given(constant=MILD, resistance=MILD)
def test_torque_gain_is_the_torque_constant_over_the_resistance(constant: float, resistance: float) -> None:
    """Eq. 6: p4 = k_i / R, so torque per ampere is k_i whatever the inductance."""
    torque, current = settled({"torque_gain": constant / resistance, "resistance": resistance}, 1.0)
    assert torque / current == pytest.approx(constant, rel=1e-12)


@pytest.mark.parametrize(("resistance", "inductance"), [(1.0, 0.05), (4.0, 0.002), (0.5, 2.0)])
@pytest.mark.parametrize("step", [0.001, 0.05])
def test_with_inductance_the_current_rises_as_the_exponential(
    resistance: float, inductance: float, step: float
) -> None:
    values = {"resistance": resistance, "inductance": inductance, "back_emf": 0.1}
    time = grid(0.2, step)
    inputs = {"voltage": lambda t: 6.0, "speed": lambda t: 10.0}
    found = stepped(MOTOR, values, ("current", "torque"), time, inputs)
    final = (6.0 - 0.1 * 10.0) / resistance
    exact = final * (1 - np.exp(-resistance / inductance * time))
    assert found[:, 0] == pytest.approx(exact, abs=2e-5 * final)
    assert found[:, 1] == pytest.approx(10.0 * resistance * found[:, 0], rel=1e-12)


@settings(max_examples=20)
@given(resistance=MILD, voltage=st.floats(-10, 10), speed=st.floats(-5, 5))
def test_the_inductive_motor_settles_where_the_static_one_is(resistance: float, voltage: float, speed: float) -> None:
    values = {"resistance": resistance, "back_emf": 0.2}
    inputs = {"voltage": lambda t: voltage, "speed": lambda t: speed}
    dynamic = stepped(MOTOR, values | {"inductance": 0.001}, ("torque",), np.array([0.0, 0.3]), inputs)[-1, 0]
    assert dynamic == pytest.approx(settled(values, voltage, speed)[0], rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("sign", [1, -1])
def test_limits_hold_in_either_direction(sign: int) -> None:
    assert settled({"voltage_limit": 5.0}, sign * 12.0) == (sign * 50.0, sign * 5.0)
    assert settled({"current_limit": 3.0}, sign * 12.0) == (sign * 30.0, sign * 3.0)
    assert settled({"current_limit": 3.0, "voltage_limit": 2.0}, sign * 12.0) == (sign * 20.0, sign * 2.0)


def test_back_emf_acts_behind_the_amplifiers_limit() -> None:
    assert settled({"voltage_limit": 5.0, "back_emf": 1.0}, 12.0, 2.0)[1] == 3.0


@pytest.mark.parametrize("sign", [1, -1])
def test_a_limited_current_leaves_its_limit_at_once_when_the_voltage_reverses(sign: int) -> None:
    """The limited amplifier stores nothing beyond the limit: from there the current falls as the exponential does."""
    values = {"resistance": 1.0, "inductance": 0.1, "current_limit": 2.0}
    time = grid(1.0, 0.005)
    voltage = {"voltage": lambda t: sign * (10.0 if t < 0.4999 else -10.0)}
    current = sign * stepped(MOTOR, values, ("current",), time, voltage)[:, 0]
    assert np.max(current) == 2.0
    assert current[50:100] == pytest.approx(2.0)
    falling = np.maximum(-10 + 12 * np.exp(-(time[100:] - 0.5) / 0.1), -2.0)
    assert current[100:] == pytest.approx(falling, abs=0.2)
    assert current[-1] == -2.0


def test_a_limit_that_is_not_reached_changes_nothing() -> None:
    inputs = {"voltage": lambda t: 5.0 * math.sin(20 * t)}
    free = {"resistance": 1.0, "inductance": 0.05}
    limited = free | {"current_limit": 5.1, "voltage_limit": 5.1}
    time = grid(1.0, 0.01)
    assert np.array_equal(
        stepped(MOTOR, free, ("current",), time, inputs), stepped(MOTOR, limited, ("current",), time, inputs)
    )
