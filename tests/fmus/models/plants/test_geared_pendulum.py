"""The pendulum behind a gear: with stiff teeth the pendulum itself, with play never a source of energy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus import library
from fmus.modelling.instance import Instance
from tests.support.fmus.stepping import grid, stepped

GEARED, PENDULUM = library.find("geared_pendulum"), library.find("pendulum")
BODY = {"viscous_friction": 1e-3, "gravity_torque": 0.05, "equilibrium_angle": 0.2, "angle_start": 1.0}
DRY = {"coulomb_friction_positive": 0.002, "coulomb_friction_negative": 0.004}


def test_without_play_it_is_a_pendulum_with_the_rotors_inertia_added() -> None:
    time = grid(0.6, 0.02)
    torque = {"torque": lambda t: 0.01 * np.sin(5 * t)}
    stiff = BODY | DRY | {"inertia": 3e-3, "rotor_inertia": 5e-4, "stiffness": 100.0}
    geared = stepped(GEARED, stiff, ["angle", "speed"], time, torque)
    rigid = stepped(PENDULUM, BODY | DRY | {"inertia": 3.5e-3}, ["angle", "speed"], time, torque)
    assert geared[:, 0] == pytest.approx(rigid[:, 0], abs=2e-3)
    assert geared[:, 1] == pytest.approx(rigid[:, 1], abs=2e-2)


def stored(x: Instance, p: dict[str, float]) -> float:
    """Energy of hand, rotor and teeth [J]."""
    twist = x.get("rotor_angle") - x.get("angle")
    wound = twist - np.clip(twist, -p["backlash"] / 2, p["backlash"] / 2)
    return float(
        x.get("energy") + 0.5 * p["rotor_inertia"] * x.get("rotor_speed") ** 2 + 0.5 * p["stiffness"] * wound**2
    )


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.floats(-2, 2), st.floats(-5, 5), st.floats(0, 0.05))
def test_without_torque_its_energy_never_grows(angle: float, speed: float, backlash: float) -> None:
    own = {"rotor_inertia": 3e-4, "stiffness": 20.0, "backlash": backlash}
    instance = Instance(GEARED, BODY | DRY | own | {"angle_start": angle, "speed_start": speed})
    instance.begin(0.0)
    before = first = stored(instance, own)
    for step in range(100):
        instance.step(0.01 * step, 0.01)
        now = stored(instance, own)
        assert now <= before + 1e-6 * first
        before = now


def test_within_its_play_the_rotor_passes_nothing_on() -> None:
    rest = {"angle_start": 0.2, "equilibrium_angle": 0.2, "backlash": 0.1}
    instance = Instance(GEARED, rest | {"rotor_inertia": 1e-3})
    instance.begin(0.0)
    instance.set("torque", 1e-3)
    instance.step(0.0, 0.2)
    assert instance.get("rotor_angle") - 0.2 == pytest.approx(0.5 * 1.0 * 0.2**2, rel=1e-3)
    assert (instance.get("angle"), instance.get("speed")) == (0.2, 0.0)
    instance.step(0.2, 0.3)
    assert instance.get("angle") > 0.2
