"""Energy control against the thesis' equations by hand, and against the decay it predicts (Eq. 114)."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from fmus import library
from fmus.errors import ModelError
from fmus.modelling.instance import Instance, StepError
from fmus.packaging import targets
from orchestrator.trace import FloatArray

CONTROLLER, PENDULUM = library.find("energy_controller"), library.find("pendulum")
P1, P2, P3, P4 = 0.00325, 0.001, 0.04905, 10.0
UPRIGHT = math.pi


def controlled(angle: float, speed: float, **values: float) -> float:
    """The voltage after one sample at this angle and speed."""
    instance = Instance(CONTROLLER, values)
    instance.set("angle", angle)
    instance.set("speed", speed)
    instance.step(0.0, 0.005)
    return instance.get("voltage")


@given(st.floats(0.1, 3), st.floats(0.1, 5), st.floats(0.3, 2.5), st.floats(0, 2), st.floats(-0.5, 0.5))
def test_voltage_is_that_of_equations_103_105_and_109(
    angle: float, speed: float, amplitude: float, gain: float, equilibrium: float
) -> None:
    energy = P1 / 2 * speed**2 + P3 * (1 - math.cos(angle - equilibrium))
    wanted = P3 * (1 - math.cos(amplitude))
    if min(abs(energy), abs(energy - 2 * P3)) < 1e-5:
        return
    expected = P2 / P4 * speed - gain * speed * (energy - wanted)
    found = controlled(angle, speed, amplitude=amplitude, gain=gain, equilibrium_angle=equilibrium)
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-15)


def test_it_tells_the_energy_that_it_has_sampled() -> None:
    instance = Instance(CONTROLLER, {"equilibrium_angle": 0.2})
    instance.set("angle", 1.0)
    instance.set("speed", 2.0)
    instance.step(0.0, 0.005)
    assert instance.get("energy") == pytest.approx(P1 / 2 * 4 + P3 * (1 - math.cos(0.8)), rel=1e-12)


def test_voltage_by_hand() -> None:
    """Half a turn per second at the bottom with an amplitude of a right angle: E = p1 pi^2 / 2, E* = p3."""
    found = controlled(0.0, math.pi, amplitude=math.pi / 2, gain=2.0)
    assert found == pytest.approx(0.0001 * math.pi - 2 * math.pi * (0.00325 * math.pi**2 / 2 - 0.04905), rel=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
def test_voltage_is_limited_in_either_direction(sign: int) -> None:
    assert controlled(0.5, sign * 2.0, gain=1e4, voltage_limit=0.7, amplitude=2.5) == sign * 0.7


@pytest.mark.parametrize(
    ("angle", "speed", "amplitude", "reason"),
    [
        (0.0, 0.0, 1.0, "start energy is that of the downward equilibrium"),
        (UPRIGHT, 0.0, 1.0, "start energy is that of the upright equilibrium"),
        (0.0, math.sqrt(4 * P3 / P1), 1.0, "start energy is that of the upright equilibrium"),
        (0.5, 0.0, 0.0, "amplitude asks for the energy of the downward equilibrium"),
        (0.5, 0.0, 2 * math.pi, "amplitude asks for the energy of the downward equilibrium"),
        (0.5, 0.0, UPRIGHT, "amplitude asks for the energy of the upright equilibrium"),
    ],
)
def test_what_lemma_8_excludes_is_refused_with_its_reason(
    angle: float, speed: float, amplitude: float, reason: str
) -> None:
    with pytest.raises(StepError, match=reason):
        controlled(angle, speed, amplitude=amplitude)


def test_equilibria_are_those_of_the_shifted_pendulum() -> None:
    with pytest.raises(StepError, match="downward"):
        controlled(0.3, 0.0, equilibrium_angle=0.3)
    assert controlled(0.0, 0.0, equilibrium_angle=0.3) == 0.0


def test_a_refused_start_stays_refused() -> None:
    instance = Instance(CONTROLLER)
    for _ in range(2):
        with pytest.raises(StepError, match="Lemma 8"):
            instance.step(0.0, 0.005)


@settings(deadline=None, max_examples=12)
@given(
    amplitude=st.floats(0.5, 3.13),
    friction=st.floats(0.5, 1.5),
    limit=st.floats(1e-6, 1e-3),
    late=st.integers(0, 1),
    start=st.floats(0.3, 3.0),
)
@example(amplitude=3.13, friction=0.5, limit=1e-3, late=1, start=3.0)  # too much is compensated: it goes over the top
@example(amplitude=3.13, friction=1.5, limit=1e-6, late=0, start=0.3)  # too little, and hardly any torque
def test_near_its_limits_the_voltage_stays_within_them_and_an_energy_that_is_not_reached_is_told(
    amplitude: float, friction: float, limit: float, late: int, start: float
) -> None:
    given = {"amplitude": amplitude, "gain": 0.02, "voltage_limit": limit, "patience": 2.0, "sample_time": 0.01}
    controller, plant = (
        Instance(CONTROLLER, given),
        Instance(PENDULUM, {"angle_start": start, "viscous_friction": friction * P2}),
    )
    voltages, wanted, away = [0.0] * (late + 1), P3 * (1 - math.cos(amplitude)), 0
    for k in range(800):
        energy = P1 / 2 * plant.get("speed") ** 2 + P3 * (1 - math.cos(plant.get("angle")))
        controller.set("angle", plant.get("angle"))
        controller.set("speed", plant.get("speed"))
        controller.step(k * 0.01, 0.01)
        voltages.append(float(controller.get("voltage")))
        assert abs(voltages[-1]) <= limit
        assert controller.get("saturated") == 0.0 or abs(voltages[-1]) == limit
        away = away + 1 if abs(energy - wanted) > 0.05 * wanted else 0
        if away != 200:  # exactly as long as its patience, which rounding decides
            assert controller.get("unreached") == float(away > 200)
        plant.set("torque", P4 * voltages[-1 - late])
        plant.step(k * 0.01, 0.01)


def test_an_energy_that_is_reached_is_no_longer_told_as_unreached() -> None:
    controller = Instance(CONTROLLER, {"patience": 0.05, "amplitude": 1.0})
    told = []
    for k, angle in enumerate([0.5] * 20 + [1.0] * 3 + [1.5] * 8):
        controller.set("angle", angle)
        controller.step(k * 0.005, 0.005)
        told.append(controller.get("unreached"))
    assert told[:9] == [0.0] * 9
    assert told[11:20] == [1.0] * 9
    assert told[20:] == [0.0] * 11


def closed_loop(angle: float, amplitude: float, gain: float, stop: float, period: float = 0.002) -> FloatArray:
    """(K, 3) time, speed and energy of the synthetic pendulum (Eq. 62) under the controller, a sample each row."""
    controller = Instance(CONTROLLER, {"amplitude": amplitude, "gain": gain, "sample_time": period})
    plant = Instance(PENDULUM, {"angle_start": angle})
    rows = []
    for k in range(round(stop / period)):
        rows.append((k * period, plant.get("speed"), plant.get("energy")))
        controller.set("angle", plant.get("angle"))
        controller.set("speed", plant.get("speed"))
        controller.step(k * period, period)
        plant.set("torque", P4 * controller.get("voltage"))
        plant.step(k * period, period)
    return np.array(rows)


@pytest.mark.parametrize("start", [0.4, 1.3, 2.0])
def test_energy_error_decays_as_equation_114_predicts(start: float) -> None:
    """ln I(t) - ln I(0) = -p4 gamma times the integral of the squared speed; friction is compensated."""
    gain, amplitude = 0.01, 1.0
    time, speed, energy = closed_loop(start, amplitude, gain, 4.0).T
    error = energy - P3 * (1 - math.cos(amplitude))
    predicted = -P4 * gain * np.concatenate(([0.0], np.cumsum((speed[1:] ** 2 + speed[:-1] ** 2) / 2 * np.diff(time))))
    found = np.log(error / error[0])
    assert predicted[-1] < -1.0
    assert found[-1] == pytest.approx(predicted[-1], rel=0.03)
    assert found == pytest.approx(predicted, abs=0.03 * abs(predicted[-1]))


@pytest.mark.parametrize("start", [0.1, 2.8])
def test_the_oscillation_reaches_the_wanted_amplitude_from_inside_and_outside(start: float) -> None:
    energy = closed_loop(start, 1.2, 0.2, 15.0, 0.005)[:, 2]
    assert energy[-400:] == pytest.approx(P3 * (1 - math.cos(1.2)), rel=0.02)


def test_an_amplitude_of_more_than_half_a_turn_is_refused_for_it_would_be_taken_for_a_smaller_one(
    tmp_path: Path,
) -> None:
    with pytest.raises(ModelError, match=r"amplitude.*4.*bounds"):
        targets.build("energy_controller", tmp_path / "controller.fmu", target="python", parameters={"amplitude": 4.0})
