"""The flexible arm against finite elements, quadrature, closed forms and an implicit integrator."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from fmus import library
from fmus.modelling import ops
from fmus.modelling.instance import Instance
from fmus.modelling.model import namespace, start_values
from fmus.models.plants import flexible_arm
from orchestrator.trace import FloatArray
from tests.support.fmus.stepping import Signal, grid, stepped
from tests.support.identification import beam
from tests.support.identification.beam import Arm

MODEL = library.find("flexible_arm")
MODES = range(1, beam.MODES + 1)
COORDINATES = ["angle", *(f"deflection_{i}" for i in MODES)]
RATES = ["speed", *(f"deflection_rate_{i}" for i in MODES)]
UNDAMPED: dict[str, float] = dict.fromkeys((f"damping_{i}" for i in MODES), 0.0)
FRICTIONLESS: dict[str, float] = {"coulomb_friction": 1e-9, "viscous_friction": 0.0, "bristle_damping": 0.0}
FREE = FRICTIONLESS | UNDAMPED

positive = st.floats(0.2, 3.0)
arms = st.builds(
    lambda *factors: Arm(*(f * d for f, d in zip(factors, (7.906, 0.4131, 1.0, 0.003, 0.02, 0.3), strict=True))),
    *[positive] * 6,
)


def given_by(arm: Arm, **more: float) -> SimpleNamespace:
    """The model's parameters with the arm's constants."""
    return namespace(start_values(MODEL) | vars(arm) | more)


def compliance(arm: Arm) -> FloatArray:
    """M^-1 as the model applies it, column by column."""
    columns = []
    for unit in np.eye(beam.MODES + 1):
        hub, modal = flexible_arm.accelerations(unit[0], list(unit[1:]), given_by(arm))
        columns.append([hub, *modal])
    return np.array(columns).T


def state_matrix(**values: float) -> FloatArray:
    """A of the rates of coordinates and their rates around rest, without bristles, by central differences."""
    p = namespace(
        start_values(MODEL) | {"coulomb_friction": 1e12, "bristle_stiffness": 1e-6, "bristle_damping": 0.0} | values
    )
    names = COORDINATES + RATES
    rest: dict[str, float] = dict.fromkeys((state.name for state in MODEL.states), 0.0)
    columns = []
    for name in names:
        sides = []
        for offset in (1e-3, -1e-3):
            x = rest | {name: offset} | ({"motor_speed": offset} if name == "speed" else {})
            found = flexible_arm.derivatives(0.0, namespace(x), namespace({"torque": 0.0}), p)
            sides.append(np.array([found[name] for name in names]))
        columns.append((sides[0] - sides[1]) / 2e-3)
    return np.array(columns).T


def flexible_modes(a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Frequencies [Hz] and damping ratios of the oscillating modes, slowest first."""
    poles = np.linalg.eigvals(a)
    poles = sorted((pole for pole in poles if pole.imag > 1.0), key=abs)
    return np.abs(poles) / (2 * math.pi), -np.real(poles) / np.abs(poles)


def run(values: dict[str, float], outputs: list[str], time: FloatArray, torque: Signal = lambda t: 0.0) -> FloatArray:
    """(K, len(outputs)) of the arm under a torque."""
    return stepped(MODEL, values, outputs, time, {"torque": torque})


@pytest.mark.parametrize("payload", [0.0, 0.2, 0.3, 0.4])
def test_the_first_three_modes_are_those_of_finite_elements(payload: float) -> None:
    found, _ = flexible_modes(state_matrix(payload=payload, **FREE))
    assert found[:3] == pytest.approx(beam.finite_element_modes(Arm(payload=payload), 3), rel=0.006)


@pytest.mark.slow
@settings(max_examples=30)
@given(arms)
def test_three_modes_are_those_of_finite_elements_whatever_the_constants(arm: Arm) -> None:
    found, _ = flexible_modes(state_matrix(**vars(arm), **FREE))
    assert found[:3] == pytest.approx(beam.finite_element_modes(arm, 3), rel=0.03)


@settings(max_examples=30)
@given(arms)
def test_accelerations_solve_with_the_mass_matrix_of_the_beams_kinetic_energy(arm: Arm) -> None:
    mass, _ = beam.matrices(arm)
    assert mass @ compliance(arm) == pytest.approx(np.eye(beam.MODES + 1), abs=1e-8)


@settings(max_examples=30)
@given(arms)
def test_modal_stiffness_is_that_of_the_bent_beam(arm: Arm) -> None:
    _, stiffness = beam.matrices(arm)
    found = np.diag(flexible_arm.modal_stiffness(given_by(arm)))
    assert np.abs(found - stiffness[1:, 1:]).max() < 1e-6 * stiffness.max()


def test_without_payload_the_modes_are_damped_as_the_rig_is() -> None:
    _, bare = flexible_modes(state_matrix(viscous_friction=0.0))
    assert bare == pytest.approx([0.012, 0.028, 0.025, 0.02, 0.02], rel=0.01)
    _, total = flexible_modes(state_matrix())
    assert total[:3] == pytest.approx([0.030, 0.046, 0.028], abs=0.001)


def test_energy_is_what_the_torque_has_put_in() -> None:
    """A torque that is constant over each step; its work is the torque times the angle it turned through."""
    time = grid(0.5, 1 / 1200)
    found = run(FREE | {"payload": 0.2}, [*COORDINATES, *RATES], time, lambda t: 2.0 * math.cos(30 * t))
    energy = beam.energy(Arm(payload=0.2), found[:, : beam.MODES + 1], found[:, beam.MODES + 1 :])
    work = np.cumsum(2.0 * np.cos(30 * time[:-1]) * np.diff(found[:, 0]))
    assert energy[1:] == pytest.approx(work, abs=2e-4 * work.max())


def test_energy_of_the_free_arm_does_not_change() -> None:
    time = grid(1.0, 0.01)
    found = run(FREE | {"backlash": 0.0}, [*COORDINATES, *RATES], time, lambda t: 2.0 if t < 0.05 else 0.0)
    energy = beam.energy(Arm(), found[:, : beam.MODES + 1], found[:, beam.MODES + 1 :])[6:]
    assert energy == pytest.approx(energy[0], rel=1e-3)
    assert energy[0] > 0.01


def test_strains_under_a_steady_acceleration_are_those_of_the_bending_moment() -> None:
    """Turning ever faster, each part needs its force: the moment at x is the sum of those beyond, times their arms."""
    arm, p = Arm(payload=0.1), given_by(Arm(payload=0.1))
    acceleration = 3.0
    mass, stiffness = beam.matrices(arm)
    bent = -np.linalg.solve(stiffness[1:, 1:], mass[1:, 0]) * acceleration
    x = namespace({f"deflection_{i}": q for i, q in zip(MODES, bent.tolist(), strict=True)})
    for position in (0.1, 0.3, 0.5):
        rest = arm.length - position
        tip = (arm.tip_fixture + arm.payload) * arm.length * rest
        distributed = arm.mass_per_length * (arm.length**3 / 3 - position * arm.length**2 / 2 + position**3 / 6)
        moment = acceleration * (tip + distributed)
        expected = -0.5 * 0.003 * moment / arm.bending_stiffness
        assert flexible_arm.strain(position, x, p) == pytest.approx(expected, rel=0.02)


def test_strain_is_half_the_thickness_times_the_curvature_of_the_modes() -> None:
    xi = np.array([0.0, 0.03, 0.5, 0.9])
    expected = 0.5 * 0.003 * beam.shapes(xi, 2)
    for i in MODES:
        x = namespace({f"deflection_{j}": float(i == j) for j in MODES})
        found = [flexible_arm.strain(position, x, given_by(Arm())) for position in xi.tolist()]
        assert found == pytest.approx(expected[i - 1], rel=1e-6, abs=1e-6)


def test_the_acceleration_of_the_tip_is_that_of_its_position() -> None:
    time = grid(0.05, 1e-4)
    found = run({}, ["tip_position", "tip_acceleration"], time, lambda t: 1.0)
    differences = np.diff(found[:, 0], 2) / 1e-8
    assert differences == pytest.approx(found[1:-1, 1], abs=0.01 * np.abs(found[:, 1]).max())


# Friction


def ramp(end: float) -> Signal:
    """A torque that rises over 0.4 s, slowly enough for the beam, and stays."""
    return lambda t: end * min(t / 0.4, 1.0)


@pytest.mark.parametrize("torque", [0.05, 0.15, -0.2])
def test_below_the_dry_friction_the_hub_only_bends_its_bristles(torque: float) -> None:
    """Pushed slowly, they creep towards slipping: x = -T_c/s0 log(1 - T/T_c), and more where the beam trembles."""
    found = run({}, ["angle", "friction_torque"], grid(0.6, 0.01), ramp(torque))
    crept = -0.235 / 2000 * math.log(1 - abs(torque) / 0.235)
    assert 0.98 * crept < abs(found[-1, 0]) < 1.3 * crept
    assert found[-1, 1] == pytest.approx(torque, abs=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1, -1])
def test_the_hub_breaks_away_at_the_dry_friction(sign: int) -> None:
    held, moved = (run({}, ["angle"], grid(0.6, 0.01), ramp(sign * k * 0.235))[-1, 0] for k in (0.95, 1.08))
    assert abs(held) < 1e-3
    assert sign * moved > 3e-3


@pytest.mark.parametrize("speed", [0.02, 0.5, -6.0])
def test_steady_sliding_meets_the_dry_and_the_viscous_friction(speed: float) -> None:
    values = {"viscous_friction": 2.0, "stribeck_friction": 0.1, "stop_angle": 100.0}
    expected = math.copysign(0.235 + 0.1 * math.exp(-((speed / 0.05) ** 2)), speed) + 2.0 * speed
    instance = Instance(MODEL, values | {"speed_start": speed})
    for k in range(80):
        instance.set("torque", expected)
        instance.step(0.01 * k, 0.01)
    assert instance.get("friction_torque") == pytest.approx(expected, rel=2e-3)
    assert instance.get("speed") == pytest.approx(speed, rel=0.02)


def exact(arm: Arm, torque: float, start: FloatArray, time: FloatArray) -> FloatArray:
    """(K, 2) angle and speed under LuGre's friction as published, by an implicit method."""
    friction = {"s0": 2000.0, "s1": 2.5, "vs": 0.05, "Tc": 0.235, "c": 0.03}
    ratios = [start_values(MODEL)[f"damping_{i}"] for i in MODES]
    rates = beam.lugre(arm, ratios, torque, friction)
    found = solve_ivp(rates, (time[0], time[-1]), start, method="Radau", t_eval=time, rtol=1e-7, atol=1e-10)
    return np.asarray(found.y[[0, beam.MODES + 1]].T)


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "torque"), [(0.0, 0.6), (6.0, -1.0), (0.6, -0.6), (20.0, 0.0)])
def test_motion_is_that_of_lugre_with_an_implicit_method(speed: float, torque: float) -> None:
    """From slipping at up to 20 rad/s, where the bristles' time constant is 6 us, through rest and back."""
    time = grid(0.25, 1 / 300)
    start = np.zeros(2 * beam.MODES + 3)
    start[beam.MODES + 1] = speed
    expected = exact(Arm(), torque, start, time)
    found = run({"speed_start": speed, "stop_angle": 50.0}, ["angle", "speed"], time, lambda t: torque)
    assert np.std(found - expected, axis=0) == pytest.approx([0, 0], abs=5e-3 * float(np.abs(expected).max()))


# Stops and backlash


@pytest.mark.parametrize("side", [1, -1])
def test_the_bare_hub_leaves_a_stop_with_four_tenths_of_its_speed(side: int) -> None:
    bare = {"mass_per_length": 1e-6, "tip_fixture": 0.0, "bending_stiffness": 1e-6, "bristle_stiffness": 1e5}
    start = {"speed_start": 2.0 * side, "angle_start": side * (math.radians(80) - 0.01)}
    found = run(FREE | bare | start, ["speed", "stop_torque", "angle"], grid(0.05, 0.001))
    assert found[-1, 0] == pytest.approx(-side * 2 * 0.404, rel=0.01)
    assert np.all(side * found[:, 1] <= 0.0)
    assert np.abs(found[:, 2]).max() < math.radians(80) + 2.0 * math.sqrt(0.003 / 2000)


def test_a_stop_that_was_touched_between_two_rows_is_still_told() -> None:
    start = {"speed_start": 3.0, "angle_start": 1.3}
    before, after = (run(FREE | start, ["stop_time", "angle"], grid(stop, stop)) for stop in (0.03, 0.5))
    assert before[-1, 0] == 0.0
    assert abs(after[-1, 1]) < math.radians(80)
    assert 0.001 < after[-1, 0] < 0.5


def test_a_stuck_drive_leans_on_the_stop_with_its_torque() -> None:
    found = run({"angle_start": 1.396}, ["angle", "stop_torque"], grid(0.8, 0.01), ramp(1.0))
    assert found[-1, 0] == pytest.approx(math.radians(80), abs=1e-3)
    assert 1 - 0.3 < -found[-20:, 1].mean() < 1 + 0.3


def test_within_its_play_the_motor_turns_alone() -> None:
    values = FREE | {"backlash": 0.2, "motor_share": 0.4}
    found = run(values, ["motor_angle", "angle"], grid(0.01, 0.001), lambda t: 1.0)
    time = grid(0.01, 0.001)
    assert found[:, 0] == pytest.approx(0.5 * time**2 / (0.4 * 0.003), rel=1e-6, abs=1e-9)
    assert np.all(found[:, 1] == 0.0)


def test_angular_momentum_passes_through_the_play_undiminished() -> None:
    time = grid(0.3, 0.01)
    names = ["motor_speed", *RATES]
    found = run(FREE | {"backlash": 0.01}, names, time, lambda t: 0.5)
    mass, _ = beam.matrices(Arm(hub_inertia=0.0015))
    momentum = 0.0015 * found[:, 0] + found[:, 1:] @ mass[0]
    assert momentum == pytest.approx(0.5 * time, abs=1e-6)


def test_a_gear_without_play_is_the_limit_of_a_stiff_one() -> None:
    time = grid(0.1, 0.005)
    rigid = run({}, ["angle"], time, lambda t: 1.0)
    stiff = run({"backlash": 1e-9, "gear_stiffness": 1e5}, ["angle"], time, lambda t: 1.0)
    assert stiff == pytest.approx(rigid, abs=0.01 * np.abs(rigid).max())


def test_inner_steps_resolve_the_fastest_mode_for_any_constants() -> None:
    p = given_by(Arm())
    fastest = 2 * math.pi * flexible_modes(state_matrix(**FREE))[0][-1]
    held = math.sqrt((2000 + 2000) / 0.003)
    assert flexible_arm.solver_step(p) < 0.4 / max(fastest, held) * 1.1
    assert flexible_arm.solver_step(given_by(Arm(bending_stiffness=790.6))) < 0.1 * 0.4 / fastest * 1.3


def test_constants_may_be_arrays() -> None:
    """Every function takes arrays, so that a family of arms is computed at once."""
    payload = np.array([0.0, 0.4])
    hub, modal = flexible_arm.accelerations(1.0, [0.0] * beam.MODES, given_by(Arm(), payload=payload))
    one, _ = flexible_arm.accelerations(1.0, [0.0] * beam.MODES, given_by(Arm(payload=0.4)))
    assert np.asarray(hub)[1] == pytest.approx(one)
    assert ops.absolute(modal[0]).shape == (2,)
