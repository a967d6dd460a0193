"""The pendulum against SciPy's integrator, against energy, and against its own solver with finer steps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from fmus import library
from fmus.modelling.instance import Instance
from fmus.modelling.model import Model
from orchestrator.trace import FloatArray
from tests.support.fmus.stepping import Signal, grid, stepped

PENDULUM = library.find("pendulum")
FRICTION = {
    "coulomb_friction_positive": 0.004,
    "coulomb_friction_negative": 0.009,
    "stribeck_friction": 0.003,
    "stribeck_speed": 0.4,
    "friction_speed": 0.2,
}
CASES: dict[str, dict[str, float]] = {
    "ideal": {"viscous_friction": 0.0},
    "viscous": {},
    "added mass": {"added_mass": 0.2, "added_length": 0.02},
    "equilibrium": {"equilibrium_angle": 0.3},
    "other gravity": {"added_mass": 0.2, "added_length": 0.02, "gravity": 1.62},
    "coulomb forward": {"coulomb_friction_positive": 0.01, "friction_speed": 0.2},
    "coulomb backward": {"coulomb_friction_negative": 0.01, "friction_speed": 0.2},
    "everything": FRICTION | {"added_mass": 0.1, "added_length": 0.03, "equilibrium_angle": -0.2},
}


def reference(values: Mapping[str, float], time: FloatArray, torque: Signal) -> FloatArray:
    """(K, 2) angle and speed by SciPy, from the equations as the thesis prints them (Eqs. 5, 78) and dry friction."""
    p = {variable.name: float(variable.start or 0) for variable in PENDULUM.of("parameter")} | dict(values)
    inertia = p["inertia"] + p["added_mass"] * p["added_length"] ** 2
    weight = p["gravity_torque"] + p["added_mass"] * p["gravity"] * p["added_length"]

    def rates(t: float, y: FloatArray) -> tuple[float, float]:
        angle, speed = y
        sign = math.tanh(speed / p["friction_speed"])
        coulomb = (p["coulomb_friction_positive"] * (1 + sign) + p["coulomb_friction_negative"] * (1 - sign)) / 2
        peak = p["stribeck_friction"] * math.exp(-((speed / p["stribeck_speed"]) ** 2))
        friction = p["viscous_friction"] * speed + (coulomb + peak) * sign
        return speed, (torque(t) - friction - weight * math.sin(angle - p["equilibrium_angle"])) / inertia

    start = (p["angle_start"], p["speed_start"])
    solution = solve_ivp(rates, (time[0], time[-1]), start, "DOP853", time, rtol=1e-10, atol=1e-12, max_step=0.01)
    return solution.y.T


def finer(model: Model, factor: float) -> Model:
    """The same model with a solver step that many times shorter."""
    step = model.solver_step
    assert step is not None
    return replace(model, solver_step=lambda p: step(p) / factor)


@pytest.mark.parametrize("case", CASES)
def test_free_motion_is_that_of_an_independent_integrator(case: str) -> None:
    values = CASES[case] | {"angle_start": 1.5, "speed_start": -1.0}
    time = grid(4.0, 0.02)
    found = stepped(PENDULUM, values, ("angle", "speed"), time)
    assert found == pytest.approx(reference(values, time, lambda t: 0.0), abs=2e-5)


@pytest.mark.parametrize("case", CASES)
def test_driven_motion_is_that_of_an_independent_integrator(case: str) -> None:
    time = grid(4.0, 0.25)

    def held(t: float) -> float:
        return 0.02 * math.sin(3 * (math.floor(t / 0.25 + 1e-9) * 0.25))

    found = stepped(PENDULUM, CASES[case], ("angle", "speed"), time, {"torque": held})
    assert found == pytest.approx(reference(CASES[case], time, held), abs=1e-4)


@pytest.mark.slow
def test_coulomb_friction_stops_each_direction_after_its_own_distance() -> None:
    """Without gravity a body with speed w comes to rest after J w^2 / (2 friction), smooth passage aside."""
    distances = {}
    for sign, name in ((1, "coulomb_friction_positive"), (-1, "coulomb_friction_negative")):
        values = {
            "gravity_torque": 0.0,
            "viscous_friction": 0.0,
            "friction_speed": 0.001,
            "speed_start": 2.0 * sign,
            "coulomb_friction_positive": 0.01,
            "coulomb_friction_negative": 0.025,
        }
        distances[name] = sign * stepped(PENDULUM, values, ("angle",), grid(2.0, 0.1))[-1, 0]
        assert distances[name] == pytest.approx(0.00325 * 4 / (2 * values[name]), rel=2e-3)


def test_stribeck_friction_fades_with_speed_as_a_bell() -> None:
    def braking(speed: float) -> float:
        instance = Instance(
            PENDULUM,
            {
                "stribeck_friction": 0.02,
                "stribeck_speed": 0.5,
                "friction_speed": 1e-6,
                "viscous_friction": 0.0,
                "speed_start": speed,
            },
        )
        return -instance.get("acceleration") * 0.00325

    for speed in (-2.0, -0.5, -0.01, 0.01, 0.3, 1.5):
        assert braking(speed) == pytest.approx(math.copysign(0.02 * math.exp(-4 * speed**2), speed), rel=1e-12)
    assert braking(0.0) == 0.0


def test_added_mass_shifts_the_small_oscillation_to_the_frequency_of_the_thesis() -> None:
    """Eq. 79: w = sqrt((p3 + m g l) / (p1 + m l^2)) without damping; measured by the period of a small free swing."""
    mass, length = 0.1, 0.01
    values = {"added_mass": mass, "added_length": length, "viscous_friction": 0.0, "angle_start": 1e-4}
    time = grid(20.0, 0.005)
    angle = stepped(PENDULUM, values, ("angle",), time)[:, 0]
    rising = np.flatnonzero((angle[:-1] < 0) & (angle[1:] >= 0))
    crossings = time[rising] - angle[rising] * 0.005 / (angle[rising + 1] - angle[rising])
    expected = math.sqrt((0.04905 + mass * 9.81 * length) / (0.00325 + mass * length**2))
    assert 2 * math.pi / np.diff(crossings).mean() == pytest.approx(expected, rel=1e-6)


@given(st.floats(-3, 3), st.floats(-5, 5), st.floats(-1, 1))
def test_energy_is_that_of_equation_105(angle: float, speed: float, equilibrium: float) -> None:
    values = {"angle_start": angle, "speed_start": speed, "equilibrium_angle": equilibrium}
    expected = 0.5 * 0.00325 * speed**2 + 0.04905 * (1 - math.cos(angle - equilibrium))
    assert Instance(PENDULUM, values).get("energy") == pytest.approx(expected, rel=1e-12, abs=1e-15)


def test_acceleration_is_the_rate_of_the_speed() -> None:
    values = FRICTION | {"angle_start": 1.0}
    found = stepped(PENDULUM, values, ("speed", "acceleration"), grid(1.0, 0.001))
    assert found[1:-1, 1] == pytest.approx((found[2:, 0] - found[:-2, 0]) / 0.002, abs=0.01)


def test_energy_is_conserved_without_friction() -> None:
    values = {"viscous_friction": 0.0, "angle_start": 2.5, "speed_start": 0.0, "added_mass": 0.1, "added_length": 0.05}
    energy = stepped(PENDULUM, values, ("energy",), grid(20.0, 0.02))[:, 0]
    assert np.max(np.abs(energy / energy[0] - 1)) < 1e-6


def test_friction_only_takes_energy() -> None:
    energy = stepped(PENDULUM, FRICTION | {"angle_start": 2.0}, ("energy",), grid(5.0, 0.01))[:, 0]
    assert np.all(np.diff(energy) < 1e-12)
    assert energy[-1] < 0.1 * energy[0]


def test_halving_the_step_divides_the_error_by_sixteen() -> None:
    values = {"angle_start": 2.0, "speed_start": 1.0}
    exact = reference(values, np.array([0.0, 2.0]), lambda t: 0.0)[-1]

    def error(step: float) -> float:
        model = replace(PENDULUM, solver_step=lambda p: step)
        return float(np.abs(stepped(model, values, ("angle", "speed"), np.array([0.0, 2.0]))[-1] - exact).max())

    errors = [error(0.04 / 2**k) for k in range(4)]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert orders == pytest.approx(4.0, abs=0.2)


def test_rest_at_the_equilibrium_is_kept() -> None:
    found = stepped(PENDULUM, {"equilibrium_angle": 0.7, "angle_start": 0.7}, ("angle", "speed"), grid(1.0, 0.1))
    assert np.array_equal(found, np.tile([0.7, 0.0], (11, 1)))


def test_a_constant_torque_holds_the_angle_whose_weight_balances_it() -> None:
    torque = 0.02
    values = {"viscous_friction": 0.02}
    angle = stepped(PENDULUM, values, ("angle",), grid(10.0, 0.1), {"torque": lambda t: torque})[-1, 0]
    assert angle == pytest.approx(math.asin(torque / 0.04905), abs=1e-6)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(
    inertia=st.floats(-4, 0).map(lambda x: 10.0**x),
    swing=st.floats(-0.5, 1.3).map(lambda x: 10.0**x),
    damping=st.floats(-3, 0.5).map(lambda x: 10.0**x),
    coulomb=st.tuples(st.floats(0, 0.3), st.floats(0, 0.3), st.floats(0, 0.2)),
    friction_speed=st.floats(-1.5, 0).map(lambda x: 10.0**x),
    angle=st.floats(-1.5, 1.5),
    drive=st.tuples(st.floats(0, 0.4), st.floats(0.2, 3)),
)
def test_solver_step_is_short_enough_for_any_sensible_parameters(
    inertia: float,
    swing: float,
    damping: float,
    coulomb: tuple[float, float, float],
    friction_speed: float,
    angle: float,
    drive: tuple[float, float],
) -> None:
    """Dry friction and drive are shares of the weight; the drive's frequency is a multiple of the swing's [rad/s]."""
    weight = inertia * swing**2
    values = {
        "inertia": inertia,
        "gravity_torque": weight,
        "viscous_friction": damping * inertia * swing,
        "coulomb_friction_positive": coulomb[0] * weight,
        "coulomb_friction_negative": coulomb[1] * weight,
        "stribeck_friction": coulomb[2] * weight,
        "friction_speed": friction_speed,
        "stribeck_speed": 0.3,
        "angle_start": angle,
    }
    duration = min(3.0, 12 / swing)
    assert PENDULUM.solver_step is not None
    assume(duration / PENDULUM.solver_step(Instance(PENDULUM, values).p) < 400)
    time = grid(duration, 0.02)
    inputs: dict[str, Signal] = {"torque": lambda t: drive[0] * weight * math.sin(drive[1] * swing * t)}
    coarse = stepped(PENDULUM, values, ("angle",), time, inputs)
    fine = stepped(finer(PENDULUM, 10), values, ("angle",), time, inputs)
    assert np.max(np.abs(coarse - fine)) < 3e-4
