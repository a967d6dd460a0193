"""The payload estimator on a rigid arm whose payload is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fmus import library
from fmus.modelling import symbolic
from fmus.modelling.instance import Instance

ESTIMATOR = library.find("payload_estimator")
T, J, C, KV, TACHO, DRY = 1 / 300, 0.1607, 0.03, 0.2938, 0.4, 0.235


def estimated(payload: float, height: float = 2.0, seconds: float = 3.0, **values: float) -> list[tuple[float, float]]:
    """Payload and whether it is known, sample by sample, of an arm that is driven to and fro."""
    estimator, speed, rows = Instance(ESTIMATOR, values), 0.0, []
    for k in range(round(seconds / T)):
        voltage = height * math.copysign(1.0, math.sin(2 * math.pi * 0.7 * k * T))
        estimator.set("voltage", voltage)
        estimator.set("speed", TACHO * speed)
        estimator.step(k * T, T)
        rows.append((estimator.get("payload"), estimator.get("known")))
        driving = KV * voltage - C * speed
        friction = DRY * np.sign(speed) if speed else np.clip(driving, -DRY, DRY)
        speed += T / (J + payload) * float(driving - friction)
    return rows


@pytest.mark.parametrize("payload", [0.0, 0.13, 0.4])
def test_the_payload_of_a_rigid_arm_is_found(payload: float) -> None:
    assert estimated(payload)[-1] == pytest.approx((payload, 1.0), abs=1e-3)


def test_until_it_is_known_it_is_that_at_the_start() -> None:
    rows = estimated(0.4, payload_start=0.1)
    first = [known for _, known in rows].index(1.0)
    assert 0 < first < 0.5 / T
    assert {payload for payload, known in rows if not known} == {0.1}
    assert rows[first][0] == pytest.approx(0.4, abs=0.02)


def test_an_arm_at_rest_tells_nothing() -> None:
    assert estimated(0.4, height=0.5)[-1] == (0.2, 0.0)  # less than friction


def test_it_keeps_to_payloads_that_can_be() -> None:
    assert estimated(2.0, 4.0)[-1][0] == 0.6
    assert estimated(0.0, inertia=0.3)[-1][0] == 0.0


def test_its_outputs_do_not_react_at_once() -> None:
    assert set(symbolic.feed_through(ESTIMATOR).values()) == {()}
