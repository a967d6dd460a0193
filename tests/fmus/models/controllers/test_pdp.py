"""The PDP controller against Eq. 4-7."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus import library
from tests.support.fmus.stepping import sampled

PDP = library.find("pdp")


@given(st.floats(0, 2), st.floats(0, 6), st.floats(0, 1), st.integers(0, 1000))
def test_it_is_equation_4_7(kp: float, kd: float, ks: float, seed: int) -> None:
    reference, position, speed, strain = np.random.default_rng(seed).standard_normal((4, 20))
    inputs = {"reference": reference, "position": position, "speed": speed, "strain": strain}
    found = sampled(PDP, {"kp": kp, "kd": kd, "ks": ks}, ["voltage", "effort"], inputs)
    effort = kp * (reference - position) - kd * speed - ks * strain
    assert found[:, 1] == pytest.approx(effort, rel=1e-12, abs=1e-12)
    assert found[:, 0] == pytest.approx(np.clip(effort, -10, 10), rel=1e-12, abs=1e-12)


def test_its_gains_are_those_of_table_4_2() -> None:
    unit = np.eye(4)
    inputs = {name: unit[i] for i, name in enumerate(("reference", "position", "speed", "strain"))}
    assert sampled(PDP, {}, ["effort"], inputs)[:, 0].tolist() == [0.5935, -0.5935, -4.2664, -0.2538]
    assert sampled(PDP, {"gains": 2}, ["effort"], inputs)[:, 0].tolist() == [1.187, -1.187, -8.5328, -0.5076]
