"""The scheduled PDPC: with equal gains it is the PDPC, between payloads its gains are linear, and they never jump."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus import library
from fmus.modelling.instance import Instance, StepError
from fmus.models.controllers.gain_schedule import gain_schedule
from tests.support.fmus.stepping import sampled

SCHEDULE = library.find("gain_schedule")
TABLE = {"payloads[1]": 0.0, "payloads[2]": 0.1, "payloads[3]": 0.4, "kp[1]": 0.5, "kp[2]": 0.9, "kp[3]": 0.3}
FAST = {"payload_rate": 1e6}


@given(st.integers(0, 1000))
def test_with_equal_gains_it_is_the_pdpc(seed: int) -> None:
    names = ("reference", "position", "speed", "strain")
    inputs = dict(zip(names, np.random.default_rng(seed).standard_normal((4, 20)), strict=True))
    outputs = ["voltage", "effort", "compensation", "saturated"]
    payload = {"payload": np.random.default_rng(seed).uniform(-1, 1, 20)}
    found = sampled(SCHEDULE, {}, outputs, inputs | payload)
    assert found == pytest.approx(sampled(library.find("pdpc"), {}, outputs, inputs), abs=1e-14)


@given(st.floats(-0.5, 1.0))
def test_between_payloads_the_gain_is_linear_and_outside_that_of_the_end(payload: float) -> None:
    inputs = {"reference": [1.0], "payload": [payload]}
    [[effort]] = sampled(SCHEDULE, TABLE | FAST, ["effort"], inputs)
    assert effort == pytest.approx(np.interp(payload, [0.0, 0.1, 0.4], [0.5, 0.9, 0.3]))


def test_the_payload_is_followed_no_faster_than_its_rate() -> None:
    payload = np.repeat([0.4, 0.0], 300)
    found = sampled(SCHEDULE, {"payload_rate": 0.3}, ["scheduled_payload"], {"payload": payload})[:, 0]
    assert np.abs(np.diff(found)).max() == pytest.approx(0.001)
    assert found[[199, 299, 599]] == pytest.approx([0.4, 0.4, 0.1])


def test_a_payload_that_is_not_known_leaves_the_last_one() -> None:
    known = np.repeat([0.0, 1.0, 0.0], 5)
    payload = np.repeat([0.0, 0.3, 0.1], 5)
    found = sampled(SCHEDULE, FAST, ["scheduled_payload"], {"payload": payload, "payload_known": known})[:, 0]
    assert found == pytest.approx(np.repeat([0.2, 0.3, 0.3], 5))


@pytest.mark.parametrize("payloads", [(0.0, 0.0, 0.4), (0.0, 0.4, 0.2)])
def test_payloads_that_do_not_rise_are_refused(payloads: tuple[float, ...]) -> None:
    values = {f"payloads[{i}]": value for i, value in enumerate(payloads, start=1)}
    with pytest.raises(StepError, match="do not rise"):
        Instance(SCHEDULE, values).step(0.0, 1 / 300)


def test_a_table_has_as_many_payloads_as_are_asked_for() -> None:
    assert gain_schedule(2).arrays == dict.fromkeys(("payloads", "kp", "kd", "ks"), (2,))
    [[effort]] = sampled(gain_schedule(2), FAST | {"kp[2]": 1.0}, ["effort"], {"reference": [1.0], "payload": [0.2]})
    assert effort == pytest.approx((0.5935 + 1) / 2)
