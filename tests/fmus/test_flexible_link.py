"""The flexible link against what is known of it by other means: its free modes, its friction, its command."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from fmus import flexible_link
from fmus.instance import Instance

MODEL = flexible_link.MODEL
STATES = [state.name for state in MODEL.states]


def parameters(**changed: float) -> SimpleNamespace:
    """All parameters, as the model's functions take them."""
    starts = {variable.name: float(variable.start) for variable in MODEL.of("parameter")}
    return SimpleNamespace(**(starts | changed))


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
        assert flexible_link.friction(state, p) == pytest.approx(0.02 * np.sign(speed) + 0.1 * speed)


def test_a_stuck_hub_springs_back_on_its_bristles() -> None:
    p = parameters(bristle_stiffness=2.0)
    state = SimpleNamespace(speed=0.0, bristle=1e-3)
    assert flexible_link.friction(state, p) == pytest.approx(2e-3)


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
