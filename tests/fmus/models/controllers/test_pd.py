"""The PD controller against its law written out anew, sample by sample."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus import library
from fmus.modelling import symbolic
from fmus.modelling.instance import Instance
from fmus.models.controllers.pd import SIGNS
from tests.support.fmus.stepping import stepped

PD = library.find("pd")
volts = st.floats(-10, 10)
BY = {name: number for number, name in enumerate(SIGNS, start=1)}


def sampled(reference: float, position: float, speed: float, **values: float) -> dict[str, float]:
    """The outputs after one sample."""
    controller = Instance(PD, dict(values))
    for name, value in (("reference", reference), ("position", position), ("speed", speed)):
        controller.set(name, value)
    controller.step(0.0, 1 / 300)
    return {name: controller.get(name) for name in ("voltage", "effort", "compensation")}


@given(volts, volts, volts, st.floats(0, 3), st.floats(0, 5))
def test_without_compensation_it_is_a_pd(reference: float, position: float, speed: float, kp: float, kd: float) -> None:
    effort = kp * (reference - position) - kd * speed
    found = sampled(reference, position, speed, kp=kp, kd=kd)
    assert found == pytest.approx({"voltage": min(max(effort, -10), 10), "effort": effort, "compensation": 0.0})


@given(volts, volts, volts)
def test_conditional_compensation_is_equation_4_8(reference: float, position: float, speed: float) -> None:
    found = sampled(
        reference,
        position,
        speed,
        compensated_by=BY["effort"],
        compensation_voltage=0.7,
        error_band=0.05,
        speed_band=0.05,
    )
    effort = 1.0 * (reference - position) - 2.8 * speed
    away = abs(reference - position) >= 0.05 or abs(speed) >= 0.05
    expected = (0.7 if effort >= 0 else -0.7) if away else 0.0
    assert found["compensation"] == expected
    assert found["effort"] == pytest.approx(effort, abs=1e-12)


@pytest.mark.parametrize(("error", "speed", "height"), [(0.04, 0.04, 0.0), (0.06, 0.0, 0.8), (0.0, 0.06, -0.8)])
def test_either_of_error_and_speed_outside_its_band_brings_the_compensation(
    error: float, speed: float, height: float
) -> None:
    found = sampled(error, 0.0, speed, compensated_by=BY["effort"], error_band=0.05, speed_band=0.05)
    assert found["compensation"] == height


@given(volts, volts, volts)
def test_compensation_has_the_sign_it_goes_by(reference: float, position: float, speed: float) -> None:
    for name, value in (("speed", speed), ("error", reference - position)):
        found = sampled(reference, position, speed, compensated_by=BY[name], compensation_voltage=0.9)
        assert found["compensation"] == (math.copysign(0.9, value) if value else 0.0)


def test_at_rest_compensation_by_speed_or_error_is_none_and_by_effort_is_positive() -> None:
    found = [sampled(0.0, 0.0, 0.0, compensated_by=BY[name])["compensation"] for name in SIGNS]
    assert found == [0.0, 0.8, 0.0, 0.0]


def test_gains_in_amperes_ask_for_the_voltage_that_gives_them() -> None:
    assert sampled(1.0, 0.2, 0.1, gains=2)["effort"] == pytest.approx((0.8 - 0.28) / 0.5)


def test_effort_and_compensation_together_keep_the_limit() -> None:
    assert sampled(9.5, 0.0, 0.0, compensated_by=BY["effort"])["voltage"] == 10.0


def test_the_voltage_is_held_between_samples() -> None:
    time = np.arange(41) / 1200
    found = stepped(PD, {"kd": 0.0}, ["voltage"], time, {"reference": lambda t: t})[1:, 0]
    assert found == pytest.approx(np.repeat(np.arange(10) / 300, 4), abs=1e-12)


def test_the_voltage_reacts_within_the_sample() -> None:
    assert symbolic.feed_through(PD)["voltage"] == ("reference", "position", "speed")
