"""ILQR against its matrix recursion in NumPy, and in a loop designed by SciPy's Riccati solver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm, solve_discrete_are

from fmus.modelling.control import WINDUP
from fmus.modelling.instance import Instance
from fmus.models.controllers.ilqr import ilqr
from orchestrator.assembly.whole_arrays import elements
from orchestrator.trace import FloatArray
from tests.support.fmus.stepping import sampled

T = 1 / 300
CLAMPING = WINDUP.index("clamping") + 1


def with_matrices(**matrices: FloatArray) -> dict[str, float]:
    return {name: float(value) for name, value in elements({n: m.tolist() for n, m in matrices.items()}).items()}


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 8), st.integers(0, 1000))
def test_it_computes_its_recursion(order: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, c = rng.standard_normal((order, order)), rng.standard_normal((order, 1)), rng.standard_normal((1, order))
    a *= 0.9 / max(abs(np.linalg.eigvals(a)))
    k, gain, x = (
        0.1 * rng.standard_normal((1, order)),
        0.1 * rng.standard_normal((order, 1)),
        rng.standard_normal(order),
    )
    reference, position = rng.standard_normal((2, 40))
    values = with_matrices(A=a, B=b, C=c, K=k, L=gain, x_start=x) | {"kp": 0.7, "ki": 0.45, "voltage_limit": 2.0}
    found = sampled(ilqr(order), values, ["voltage", "estimate"], {"reference": reference, "position": position})
    total, expected = 0.0, []
    for r, y in zip(reference, position, strict=True):
        total += 0.0015 * (r - y)
        u = np.clip(0.7 * r + total - k @ x, -2, 2)
        expected.append([u[0], (c @ x)[0]])
        x = a @ x + b @ u + gain @ (y - c @ x)
    assert found == pytest.approx(np.array(expected), rel=1e-12, abs=1e-12)


@dataclass(frozen=True)
class Design:
    """A position servo with a flexible mode and the ILQR for it; kp by the steady state in closed form."""

    a: FloatArray
    b: FloatArray
    c: FloatArray
    k: FloatArray
    gain: FloatArray
    kp: float

    def parameters(self) -> dict[str, float]:
        return with_matrices(A=self.a, B=self.b, C=self.c, K=self.k, L=self.gain) | {"kp": self.kp}


def designed() -> Design:
    """States: angle, its rate, and a mode at 3 Hz that the command also excites and that the position shows."""
    w = 2 * np.pi * 3
    block = np.zeros((5, 5))
    block[0, 1], block[1, 1], block[2, 3], block[3, 2], block[3, 3] = 1.0, -2.0, 1.0, -(w**2), -0.1 * w
    block[:4, 4] = [0, 4.0, 0, -3.0]
    a, b = np.split(expm(block * T)[:4], [4], axis=1)
    c = np.array([[1.0, 0, 1, 0]])
    s = solve_discrete_are(a, b, np.diag([1.0, 0.01, 1, 0]), np.array([[0.5]]))
    k = np.linalg.solve(b.T @ s @ b + 0.5, b.T @ s @ a)
    p = solve_discrete_are(a.T, c.T, np.eye(4), np.array([[10.0]]))
    gain = a @ p @ c.T / (c @ p @ c.T + 10)
    return Design(a, b, c, k, gain, 1 / (c @ np.linalg.solve(np.eye(4) - a + b @ k, b))[0, 0])


def loop(design: Design, disturbance: float, seconds: float = 12, **values: float) -> FloatArray:
    """Positions on the way to 1 V with a disturbance at the plant's input."""
    controller = Instance(ilqr(4), design.parameters() | values)
    controller.set("reference", 1.0)
    x, positions = np.zeros(4), []
    for i in range(round(seconds / T)):
        positions.append(float(design.c[0] @ x))
        controller.set("position", positions[-1])
        controller.step(i * T, T)
        x = design.a @ x + design.b[:, 0] * (controller.get("voltage") + disturbance)
    return np.array(positions)


def test_without_a_disturbance_the_gain_of_the_reference_brings_it_there() -> None:
    assert loop(designed(), 0.0, ki=0.0)[-1] == pytest.approx(1.0, abs=1e-6)


def test_a_step_disturbance_leaves_no_steady_error_but_with_an_integral_alone() -> None:
    assert abs(loop(designed(), -0.3, ki=0.0)[-1] - 1) > 0.1
    assert loop(designed(), -0.3, 25, ki=1.5)[-1] == pytest.approx(1.0, abs=1e-5)


@pytest.mark.slow
def test_clamping_overshoots_less_than_winding_up() -> None:
    values = {"ki": 1.5, "voltage_limit": 0.4}
    wound, clamped = (loop(designed(), -0.3, 40, anti_windup=by, **values) for by in (1, CLAMPING))
    assert clamped.max() < wound.max() - 0.02
    assert clamped[-1] == pytest.approx(1.0, abs=1e-3)


def test_the_observer_goes_on_while_another_has_the_command() -> None:
    """On enabling it knows the plant's state: the loop is that which was closed all the time."""
    design, count = designed(), 600
    controller = Instance(ilqr(4), design.parameters() | {"ki": 0.0})
    x = np.zeros(4)
    for i in range(count):
        controller.set("enabled", float(i > 450))
        controller.set("manual", 0.2)
        controller.set("position", float(design.c[0] @ x))
        controller.step(i * T, T)
        x = design.a @ x + design.b[:, 0] * controller.get("voltage")
    found = [controller.get("estimate"), *(getattr(controller.x, f"x_{i}") for i in range(1, 5))]
    assert found[1:] == pytest.approx(x, abs=1e-9)
