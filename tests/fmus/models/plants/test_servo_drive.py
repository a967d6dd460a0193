"""The drive against the straight line and the limits of its characteristic."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus import library
from fmus.modelling import symbolic
from fmus.modelling.instance import Instance

DRIVE = library.find("servo_drive")


def driven(voltage: float, **values: float) -> tuple[float, float]:
    """(current [A], torque [N m])."""
    drive = Instance(DRIVE, dict(values))
    drive.set("voltage", voltage)
    return drive.get("current"), drive.get("torque")


@given(st.floats(-10, 10))
def test_half_an_ampere_a_volt_turns_with_the_torque_constant(voltage: float) -> None:
    assert driven(voltage) == pytest.approx((0.5 * voltage, 0.5876 * 0.5 * voltage))


def test_the_stall_torque_of_the_motor_is_reached_at_ten_volts() -> None:
    assert driven(10.0) == pytest.approx((5.0, 2.938), rel=1e-3)


@given(st.floats(10, 1e6), st.sampled_from([1, -1]))
def test_a_command_beyond_the_limit_gives_no_more(voltage: float, sign: int) -> None:
    assert driven(sign * voltage) == driven(sign * 10.0)


@given(st.floats(-20, 20))
def test_a_clockwise_drive_is_the_other_one_with_the_sign_changed(voltage: float) -> None:
    assert driven(voltage, direction=2) == tuple(-value for value in driven(voltage))


def test_a_gear_multiplies_the_torque_and_not_the_current() -> None:
    current, torque = driven(1.0)
    assert driven(1.0, gear_ratio=5.0) == pytest.approx((current, 5 * torque))


def test_the_torque_follows_the_command_at_once() -> None:
    assert symbolic.feed_through(DRIVE) == {"torque": ("voltage",), "current": ("voltage",)}
