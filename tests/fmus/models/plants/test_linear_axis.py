"""The linear axis against SciPy's integrator, its steady sliding, its bristles, and what is an offset."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from fmus import library
from fmus.modelling.instance import Instance, StepError
from orchestrator.trace import FloatArray
from tests.support.fmus.stepping import grid, stepped

AXIS = library.find("linear_axis")
BODY = {"mass": 95.0, "drive_gain": 35.0}
VISCOUS = {"viscous_friction_positive": 160.0, "viscous_friction_negative": 240.0}
COULOMB = {"coulomb_friction_positive": 20.0, "coulomb_friction_negative": 26.0, "friction_speed": 0.02}
STRIBECK = {"stribeck_friction": 8.0, "stribeck_speed": 0.03}
BRISTLES = {"bristle_stiffness": 1e5, "bristle_damping": 300.0}
CASES: dict[str, dict[str, float]] = {
    "viscous": BODY | VISCOUS,
    "coulomb": BODY | VISCOUS | COULOMB,
    "offset": BODY | VISCOUS | COULOMB | {"offset": -3.0},
    "stribeck": BODY | VISCOUS | COULOMB | STRIBECK,
    "bristles": BODY | VISCOUS | COULOMB | STRIBECK | BRISTLES,
}


def reference(values: Mapping[str, float], time: FloatArray, command: float) -> FloatArray:
    """(K, 2) position and speed by SciPy, from Newton's law, either direction by itself and LuGre's equations."""
    p = {variable.name: float(variable.start or 0) for variable in AXIS.of("parameter")} | dict(values)

    def rates(t: float, y: FloatArray) -> tuple[float, float, float]:
        speed, z = y[1], y[2]
        sign = math.tanh(speed / p["friction_speed"])
        ahead, back = (1 + sign) / 2, (1 - sign) / 2
        size = p["coulomb_friction_positive"] * ahead + p["coulomb_friction_negative"] * back
        size += p["stribeck_friction"] * math.exp(-((speed / p["stribeck_speed"]) ** 2))
        viscous = (p["viscous_friction_positive"] * ahead + p["viscous_friction_negative"] * back) * speed
        s0 = p["bristle_stiffness"]
        z_rate = speed - s0 * abs(speed) * z / size if s0 else 0.0
        dry = s0 * z + p["bristle_damping"] * z_rate if s0 else size * sign
        driving = p["drive_gain"] * command - p["offset"]
        return speed, (driving - dry - viscous) / p["mass"], z_rate

    start = (p["position_start"], p["speed_start"], 0.0)
    solution = solve_ivp(rates, (time[0], time[-1]), start, "DOP853", time, rtol=1e-9, atol=1e-11, max_step=0.005)
    return solution.y[:2].T


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("command", [-2.0, 1.5])
def test_it_moves_as_its_equations_say(case: str, command: float) -> None:
    time = grid(0.8, 0.1)
    values = CASES[case] | {"position_start": 0.1, "speed_start": 0.12}
    found = stepped(AXIS, values, ["position", "speed"], time, {"command": lambda t: command})
    assert found == pytest.approx(reference(values, time, command), abs=2e-6)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("sign", [-1, 1])
def test_steady_sliding_meets_the_friction_of_its_direction(case: str, sign: int) -> None:
    values = CASES[case]
    side = "positive" if sign > 0 else "negative"
    speed = 0.2
    resisting = values[f"viscous_friction_{side}"] * speed + values.get(f"coulomb_friction_{side}", 0.0)
    needed = (sign * resisting + values.get("offset", 0.0)) / values["drive_gain"]
    found = stepped(AXIS, values, ["speed", "friction"], grid(6.0, 0.5), {"command": lambda t: needed})
    assert found[-1, 0] == pytest.approx(sign * speed, rel=2e-3)
    assert found[-1, 1] == pytest.approx(sign * resisting, rel=2e-3)


@settings(max_examples=15, deadline=None)
@given(st.sampled_from([-1.0, 1.0]), st.floats(0.1, 0.5), st.floats(-5.0, 5.0))
def test_coulomb_friction_that_differs_by_direction_is_an_offset(sign: float, speed: float, force: float) -> None:
    """Half of the difference, wherever the friction does not change sign."""
    time, driving = grid(0.5, 0.1), {"force": lambda t: 60.0 * sign + force}
    sliding = BODY | VISCOUS | {"friction_speed": 1e-3, "speed_start": sign * speed}
    by_direction = {"coulomb_friction_positive": 20.0, "coulomb_friction_negative": 26.0}
    mean = {"coulomb_friction_positive": 23.0, "coulomb_friction_negative": 23.0, "offset": -3.0}
    either = [stepped(AXIS, sliding | values, ["position"], time, driving) for values in (by_direction, mean)]
    assert either[0] == pytest.approx(either[1], abs=1e-9)


def test_bristles_hold_the_axis_below_the_breakaway_force_and_let_it_go_above() -> None:
    """Pushed slowly, dz/dx = 1 - s0 z / g: it comes to rest at x = -(g / s0) log(1 - force / g)."""
    values = CASES["bristles"] | {"coulomb_friction_negative": 20.0, "bristle_damping": 1.2e4}
    breakaway, time = 28.0, grid(2.0, 0.05)
    held = stepped(AXIS, values, ["position"], time, {"force": lambda t: 0.5 * breakaway})
    gone = stepped(AXIS, values, ["position"], time, {"force": lambda t: 1.2 * breakaway})
    assert held[-1, 0] == pytest.approx(breakaway / 1e5 * math.log(2), rel=0.03)
    assert gone[-1, 0] > 0.01


def test_bristles_without_friction_to_limit_them_are_refused() -> None:
    instance = Instance(AXIS, BODY | {"bristle_stiffness": 1e5, "speed_start": 0.1})
    with pytest.raises(StepError, match="Coulomb friction in either direction"):
        instance.begin(0.0)
        instance.step(0.0, 0.1)
