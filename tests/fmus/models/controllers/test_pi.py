"""The PI controller against its discrete transfer function, and what its integral promises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from fmus import library
from fmus.modelling.control import WINDUP
from fmus.modelling.instance import Instance
from orchestrator.trace import FloatArray
from tests.support.fmus.stepping import sampled

PI = library.find("pi")
CLAMPING = WINDUP.index("clamping") + 1
T = 1 / 300


def errors(reference: FloatArray, position: FloatArray) -> dict[str, FloatArray]:
    return {"reference": reference, "position": position}


@given(st.floats(0, 3), st.floats(0, 20), st.integers(0, 1000))
def test_it_is_its_transfer_function(kp: float, ki: float, seed: int) -> None:
    """kp + ki T z / (z - 1)."""
    reference, position = np.random.default_rng(seed).standard_normal((2, 40))
    found = sampled(PI, {"kp": kp, "ki": ki, "voltage_limit": 1e9}, ["voltage"], errors(reference, position))[:, 0]
    expected = lfilter([kp + ki * T, -kp], [1, -1], reference - position)
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_gains_in_amperes_ask_for_the_voltage_that_gives_them() -> None:
    error = errors(np.ones(20), np.zeros(20))
    volts, amperes = (sampled(PI, {"ki": 2.0, "gains": gains}, ["voltage"], error) for gains in (1, 2))
    assert amperes == pytest.approx(2 * volts)


def with_friction(load: float, **values: float) -> FloatArray:
    """Positions of a lag, x' = (u - load - x) / 0.1 s, that the controller moves to 1."""
    controller, position, positions = Instance(PI, values), 0.0, []
    controller.set("reference", 1.0)
    decay = np.exp(-T / 0.1)
    for k in range(1500):
        controller.set("position", position)
        controller.step(k * T, T)
        position = decay * position + (1 - decay) * (controller.get("voltage") - load)
        positions.append(position)
    return np.array(positions)


@pytest.mark.parametrize("load", [-2.0, 0.0, 3.0])
def test_a_step_disturbance_leaves_no_steady_error(load: float) -> None:
    assert with_friction(load, kp=1.0, ki=8.0)[-1] == pytest.approx(1.0, abs=1e-9)


def test_without_an_integral_the_disturbance_stays() -> None:
    assert with_friction(1.0, kp=1.0, ki=0.0)[-1] == pytest.approx(0.0, abs=1e-9)  # kp (1 - x) - load = x


def test_clamping_overshoots_less_than_winding_up() -> None:
    wound, clamped = (with_friction(1.0, kp=1.0, ki=20.0, voltage_limit=2.1, anti_windup=by) for by in (1, CLAMPING))
    assert wound.max() > 1.05
    assert clamped.max() < 1 + 0.5 * (wound.max() - 1)
    assert clamped[-1] == pytest.approx(1.0, abs=1e-6)
