"""The disturbance observer around a rigid body with friction, whose torque it must find."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fmus import library
from fmus.modelling.instance import Instance
from orchestrator.trace import FloatArray

OBSERVER = library.find("disturbance_observer")
T, J, C, KV, TACHO = 1 / 300, 0.1607, 0.03, 0.2938, 0.4


def turned(torque: float, effort: float, count: int = 600, **values: float) -> FloatArray:
    """(count, 3) estimate, command and speed of a body on which a constant torque acts."""
    observer, speed, rows = Instance(OBSERVER, values), 0.0, []
    observer.set("effort", effort)
    for k in range(count):
        observer.set("speed", TACHO * speed)
        observer.step(k * T, T)
        rows.append([observer.get("disturbance"), observer.get("voltage"), speed])
        speed += T / J * (KV * rows[-1][1] - C * speed + torque)
    return np.array(rows)


@pytest.mark.parametrize("torque", [-0.2, 0.1])
def test_a_constant_torque_is_found_and_cancelled(torque: float) -> None:
    found = turned(torque, 0.5)
    assert found[-1, :2] == pytest.approx([torque, 0.5 - torque / KV], abs=1e-9)


def test_the_estimate_has_both_poles_at_the_bandwidth() -> None:
    """The step response of a double pole z."""
    pole = math.exp(-2 * math.pi * 2.0 * T)
    k = np.arange(1, 201)
    expected = 0.1 * (1 - pole**k - k * pole ** (k - 1.0) * (1 - pole))
    assert turned(0.1, 0.0, 200, bandwidth=2.0)[:, 0] == pytest.approx(expected, abs=1e-9)


def test_the_compensation_keeps_its_limit() -> None:
    assert turned(-2.0, 0.5, compensation_limit=0.7)[-1, 1] == pytest.approx(1.2)


def test_with_it_the_body_moves_as_without_friction() -> None:
    free = turned(0.0, 0.5)[-1, 2]
    assert turned(-0.1, 0.5)[-1, 2] == pytest.approx(free, rel=0.05)
    assert turned(-0.1, 0.5, enabled=0.0)[-1, 2] < 0.5 * free
