"""LQG against its matrix recursion in NumPy, with four sensors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus.models.controllers.lqg import lqg
from orchestrator.assembly.whole_arrays import elements
from tests.support.fmus.stepping import sampled

SENSORS = ("position", "base_strain", "middle_strain", "speed")


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 6), st.integers(0, 1000))
def test_it_computes_its_recursion(order: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    shapes = {"A": (order, order), "B": (order, 1), "C": (4, order), "K": (1, order), "L": (order, 4)}
    matrices = {name: 0.3 * rng.standard_normal(shape) for name, shape in shapes.items()}
    a, b, c, k, gain = matrices.values()
    a *= 0.9 / max(abs(np.linalg.eigvals(a)))
    x, reference, measured = np.zeros(order), rng.standard_normal(40), rng.standard_normal((40, 4))
    values = {name: float(v) for name, v in elements({n: m.tolist() for n, m in matrices.items()}).items()}
    inputs = {"reference": reference, **dict(zip(SENSORS, measured.T, strict=True))}
    found = sampled(lqg(order), values | {"kp": 1.2, "ki": 3.0, "voltage_limit": 1.5}, ["voltage"], inputs)[:, 0]
    total, expected = 0.0, []
    for r, y in zip(reference, measured, strict=True):
        total += 0.01 * (r - y[0])
        u = np.clip(1.2 * r + total - k @ x, -1.5, 1.5)
        expected.append(u[0])
        x = a @ x + b @ u + gain @ (y - c @ x)
    assert found == pytest.approx(np.array(expected), rel=1e-12, abs=1e-12)
