"""The flexible link against what is known of it by other means: its free modes, its friction, its command."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from fmus.modelling import symbolic
from fmus.modelling.instance import Instance, StepError
from fmus.modelling.model import namespace, start_values
from fmus.models.plants import flexible_link
from tests.support.fmus.stepping import grid, stepped
from tests.support.identification import beam
from tests.support.identification.beam import Arm

MODEL = flexible_link.MODEL
STATES = [state.name for state in MODEL.states]
MODES = (1, 2, 3)
FREE: dict[str, float] = {"viscous_friction": 0.0, "damping_1": 0.0, "damping_2": 0.0, "damping_3": 0.0}
RIG: dict[str, float] = {  # about what the real link was found to have
    "torque_gain": 2.7e-3,
    "command_limit": 250,
    "drive_time": 0.003,
    "torque_bias": 6e-4,
    "inertia": 0.01,
    "viscous_friction": 0.13,
    "coulomb_friction": 0.009,
    "bristle_stiffness": 5.3,
    "cogging_torque": 0.0045,
    "cogging_period": 0.08,
    "cogging_angle": -0.007,
    "frequency_1": 2.54,
    "damping_1": 0.013,
    "participation_1": 0.806,
    "tip_1": 1.41,
    "frequency_2": 17.5,
    "damping_2": 0.01,
    "participation_2": 0.11,
    "tip_2": -1.12,
    "frequency_3": 52.0,
    "damping_3": 0.038,
    "tip_3": 2.0,
    "softening": 0.15,
    "softening_deflection": 0.0057,
    "softening_mix": -0.67,
    "drag": 4.1,
}


def parameters(**changed: float) -> SimpleNamespace:
    """All parameters, as the model's functions take them."""
    return namespace(start_values(MODEL) | changed)


def slope(x: np.ndarray, p: SimpleNamespace, command: float = 0.0) -> np.ndarray:
    state = SimpleNamespace(**dict(zip(STATES, x.tolist(), strict=True)))
    found = flexible_link.derivatives(0.0, state, SimpleNamespace(command=command), p)
    return np.array([found[name] for name in STATES])


def test_free_modes_are_those_of_the_mass_and_stiffness_matrices() -> None:
    p = parameters(damping_1=0, damping_2=0, damping_3=0, viscous_friction=0, bristle_stiffness=1e-9)
    jacobian = np.array([(slope(1e-6 * row, p) - slope(-1e-6 * row, p)) / 2e-6 for row in np.eye(len(STATES))]).T
    moving = [STATES.index(f"deflection{kind}_{i}") for kind in ("", "_rate") for i in (1, 2, 3)]
    found = np.unique(np.round(np.abs(np.linalg.eigvals(jacobian[np.ix_(moving, moving)]).imag), 6))
    coupling = np.array([getattr(p, f"participation_{i}") for i in (1, 2, 3)])
    mass = np.block([[np.eye(1), coupling[None]], [coupling[:, None], np.eye(3)]])
    stiffness = np.diag([0.0, *((2 * np.pi * getattr(p, f"frequency_{i}")) ** 2 for i in (1, 2, 3))])
    expected = np.sqrt(np.maximum(eigh(stiffness, mass, eigvals_only=True), 0))[1:]
    assert found == pytest.approx(expected, rel=1e-5)


def test_sliding_friction_is_dry_and_viscous_friction_together() -> None:
    p = parameters(coulomb_friction=0.02, viscous_friction=0.1, bristle_stiffness=1.0)
    for speed in (-2.0, 0.5):
        bristle = p.coulomb_friction / p.bristle_stiffness * np.sign(speed)
        state = SimpleNamespace(speed=speed, bristle=bristle)
        assert flexible_link.bristle_rate(state, p) == pytest.approx(0.0, abs=1e-12)
        assert flexible_link.friction_torque(state, p) == pytest.approx(0.02 * np.sign(speed) + 0.1 * speed)


def test_a_stuck_hub_springs_back_on_its_bristles() -> None:
    p = parameters(bristle_stiffness=2.0)
    state = SimpleNamespace(speed=0.0, bristle=1e-3)
    assert flexible_link.friction_torque(state, p) == pytest.approx(2e-3)


@pytest.mark.slow
def test_the_instance_follows_an_adaptive_implicit_solver() -> None:
    values = {"torque_gain": 0.2, "speed_start": 1.0, "softening": 0.3, "drag": 1.0, "cogging_torque": 0.003}
    instance = Instance(MODEL, {**values, "command": 0.3})
    p, start = parameters(**values), np.zeros(len(STATES))
    start[STATES.index("speed")] = 1.0
    exact = solve_ivp(lambda t, x: slope(x, p, 0.3), (0, 0.5), start, "Radau", rtol=1e-9, atol=1e-12)
    for k in range(50):
        instance.step(0.01 * k, 0.01)
    assert instance.get("angle") == pytest.approx(exact.y[STATES.index("angle"), -1], rel=1e-4)
    assert instance.get("speed") == pytest.approx(exact.y[STATES.index("speed"), -1], rel=1e-3)


def test_the_command_saturates_and_keeps_its_sign() -> None:
    p = parameters(command_limit=200.0)
    assert flexible_link.saturated(1e-3, p) == pytest.approx(1e-3)
    assert flexible_link.saturated(-1e6, p) == pytest.approx(-200.0)


def energy(x: np.ndarray, p: SimpleNamespace) -> float:
    """Kinetic energy, and that of modes, softening spring, bristles and cogging [J]."""
    state = dict(zip(STATES, x.tolist(), strict=True))
    q, rate = (np.array([state[f"{name}_{i}"] for i in MODES]) for name in ("deflection", "deflection_rate"))
    c = np.array([getattr(p, f"participation_{i}") for i in MODES])
    w = 2 * np.pi * np.array([getattr(p, f"frequency_{i}") for i in MODES])
    kinetic = 0.5 * (state["speed"] ** 2 + 2 * state["speed"] * c @ rate + rate @ rate)
    y, far = q[1] + p.softening_mix * q[2], p.softening_deflection
    lost = p.softening * w[1] ** 2 * (0.5 * y**2 - far**2 * math.log(math.cosh(y / far)))
    turn = 2 * math.pi / p.cogging_period
    magnetic = -p.cogging_torque / turn * math.cos(turn * (state["angle"] - p.cogging_angle))
    at_hub = 0.5 * p.bristle_stiffness * state["bristle"] ** 2 + magnetic
    return p.inertia * (kinetic + 0.5 * (w * q) @ (w * q) - lost) + at_hub


def power(x: np.ndarray, p: SimpleNamespace) -> float:
    """Rate of that energy while nothing drives the hub, by central differences along the model's slope [W]."""
    x[STATES.index("torque")] = 0.0
    along = 1e-6 * slope(x, p)
    return (energy(x + along, p) - energy(x - along, p)) / 2e-6


SIZES = {"deflection": 0.02, "bristle": 1e-3}
motions = st.lists(st.floats(-1, 1), min_size=len(STATES), max_size=len(STATES)).map(
    lambda draws: np.array(draws) * [SIZES.get(name.rstrip("_123"), 0.5) for name in STATES]
)


@given(motions)
def test_large_deflections_and_cogging_keep_the_energy(x: np.ndarray) -> None:
    p = parameters(**RIG | FREE | {"drag": 0.0, "bristle_stiffness": 1e-9, "torque_bias": 0.0})
    x[STATES.index("bristle")] = 0.0
    assert power(x, p) == pytest.approx(0.0, abs=1e-5)


@given(motions)
def test_friction_damping_and_drag_only_take_energy(x: np.ndarray) -> None:
    assert power(x, parameters(**RIG | {"torque_bias": 0.0})) < 1e-5


UNIFORM = Arm(mass_per_length=2.1, hub_inertia=0.3, tip_fixture=0.0, bending_stiffness=1.0)  # 0.7 of 1 is the beam's


def test_defaults_are_those_of_a_uniform_beam_with_seven_tenths_of_the_inertia() -> None:
    mass, stiffness = beam.matrices(UNIFORM)
    scale = np.sqrt(np.diag(mass)[1:])
    frequencies = np.sqrt(np.diag(stiffness)[1:]) / scale
    for i in MODES:
        default = {name: start_values(MODEL)[f"{name}_{i}"] for name in ("participation", "tip", "frequency")}
        assert default["participation"] == pytest.approx(mass[0, i] / scale[i - 1], rel=2e-3)
        assert default["tip"] == pytest.approx(-2 * (-1) ** i / scale[i - 1], rel=2e-3)
        assert default["frequency"] / 2.5 == pytest.approx(frequencies[i - 1] / frequencies[0], rel=4e-3)


def test_with_them_the_hub_turns_with_the_modes_of_finite_elements() -> None:
    p = parameters(**FREE, bristle_stiffness=1e-9)
    jacobian = np.array([(slope(1e-6 * row, p) - slope(-1e-6 * row, p)) / 2e-6 for row in np.eye(len(STATES))]).T
    found = np.unique(np.abs(np.linalg.eigvals(jacobian).imag).round(4))[-3:]
    expected = beam.finite_element_modes(UNIFORM, 3)
    assert found / found[0] == pytest.approx(expected / expected[0], rel=0.02)


def test_the_tip_accelerates_as_hub_and_modes_move_it() -> None:
    instance = Instance(MODEL, RIG | {"length": 0.4, "command": 100.0})
    p, h, positions, found = parameters(**RIG), 1e-4, [], []
    for k in range(400):
        bent = sum(getattr(p, f"tip_{i}") * instance.get(f"deflection_{i}") for i in MODES)
        positions.append(0.4 * (instance.get("angle") + bent))
        found.append(instance.get("tip_acceleration"))
        instance.step(k * h, h)
    expected = np.diff(positions, 2) / h**2
    assert np.array(found[1:-1]) == pytest.approx(expected, abs=0.01 * np.abs(expected).max())


def test_readings_are_scaled_shifted_and_cut_off() -> None:
    instance = Instance(
        MODEL,
        {
            "angle_start": 0.5,
            "encoder_gain": 651.9,
            "accelerometer_gain": -2.0,
            "accelerometer_offset": 3.0,
            "torque_bias": 1.0,
        },
    )
    assert instance.get("encoder") == pytest.approx(651.9 * 0.5)
    free = instance.get("accelerometer")
    assert free == pytest.approx(3.0 - 2.0 * instance.get("tip_acceleration"))
    instance.set("accelerometer_lowest", free + 1)
    assert instance.get("accelerometer") == free + 1
    instance.set("accelerometer_lowest", free - 2)
    instance.set("accelerometer_highest", free - 1)
    assert instance.get("accelerometer") == free - 1


@pytest.mark.parametrize("command", [20.0, -20.0, 1000.0])
def test_a_steady_command_ends_at_the_speed_that_friction_allows(command: float) -> None:
    values = RIG | {"cogging_torque": 0.0}
    speed = stepped(MODEL, values, ("speed",), grid(4.0, 0.1), {"command": lambda t: command})[-1, 0]
    torque = 2.7e-3 * 250 * math.tanh(command / 250) + 6e-4
    assert speed == pytest.approx((torque - math.copysign(0.009, command)) / 0.13, rel=1e-3)


@pytest.mark.slow
def test_a_command_below_dry_friction_only_bends_the_bristles() -> None:
    """It springs back by what its torque bends them; what is left is how far they slipped on the way."""
    values = RIG | {"torque_bias": 0.0, "cogging_torque": 0.0}
    angle = stepped(MODEL, values, ("angle",), grid(6.0, 0.05), {"command": lambda t: 1.0 if t < 3 else 0.0})[:, 0]
    assert angle[60] - angle[-1] == pytest.approx(2.7e-3 / 5.3, rel=0.1)
    assert angle[60] - angle[55] == pytest.approx(0.0, abs=0.1 * 2.7e-3 / 5.3)


@pytest.mark.parametrize(("start", "detent"), [(0.02, -0.007), (0.05, 0.073), (-0.06, -0.087)])
def test_the_hub_comes_to_rest_at_the_nearest_detent(start: float, detent: float) -> None:
    values = RIG | {"torque_bias": 0.0, "coulomb_friction": 1e-6, "angle_start": start, "cogging_torque": 0.02}
    angle = stepped(MODEL, values, ("angle",), grid(3.0, 0.1))[-1, 0]
    assert angle == pytest.approx(detent, abs=1e-3)


def test_the_readings_follow_the_command_only_through_the_drive() -> None:
    assert not any("command" in inputs for inputs in symbolic.feed_through(MODEL).values())


@pytest.mark.slow
@pytest.mark.parametrize("changed", [{}, {"bristle_stiffness": 50.0}, {"cogging_torque": 0.1}, {"frequency_3": 100.0}])
def test_a_finer_solver_gives_the_same_motion(changed: dict[str, float]) -> None:
    finer = replace(MODEL, solver_step=lambda p: flexible_link.solver_step(p) / 4)
    names = ("angle", "tip_acceleration")

    def command(t: float) -> float:
        return 150 * math.sin(2 * math.pi * 6 * t * t)

    coarse, fine = (
        stepped(model, RIG | changed, names, grid(0.5, 0.01), {"command": command}) for model in (MODEL, finer)
    )
    assert np.all(np.abs(coarse - fine).max(axis=0) < 3e-3 * np.abs(fine).max(axis=0))


def test_modes_that_have_more_than_the_inertia_are_refused() -> None:
    instance = Instance(MODEL, {"participation_1": 0.99, "participation_2": 0.2})
    with pytest.raises(StepError, match="participations do not add up to less than 1"):
        instance.step(0.0, 0.01)
