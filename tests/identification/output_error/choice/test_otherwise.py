"""Outputs with the other sign or in the other unit of angle are named, and nothing else that does not fit is."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.modelling.instance import Instance
from fmus.models.plants import dc_motor, pendulum
from identification.output_error.calibration import Calibration, PreparedStudy
from identification.recordings.campaign import StudyTrace
from orchestrator.trace import FloatArray, Trace
from tests.support.identification.small_study import STEP, TRUTH, plain_study

pytestmark = pytest.mark.usefixtures("in_this_process")

COUNT, NOISE, DRAWS = 301, 5e-3, 12  # samples, noise of the outputs' spread, and draws
DEGREES = 180 / math.pi
OTHER_SIGN, AS_DEGREES, AS_RADIANS = "taken with the other sign", "taken as degrees", "taken as radians"
TOLD = "once recordings are taken"


def swung(seed: int) -> dict[str, FloatArray]:
    """(K,) voltage, angle and speed of the true rig."""
    rng = np.random.default_rng([5, seed])
    driven = np.repeat(rng.uniform(-0.01, 0.01, COUNT // 10 + 1), 10)[:COUNT]
    motor = Instance(dc_motor.MODEL, {"torque_gain": TRUTH["motor.torque_gain"]})
    hand = Instance(pendulum.MODEL, {n.split(".")[1]: v for n, v in TRUTH.items() if n.startswith("hand.")})
    outputs = np.zeros((COUNT, 2))
    for k in range(COUNT):
        outputs[k] = hand.get("angle"), hand.get("speed")
        motor.set("voltage", float(driven[k]))
        hand.set("torque", motor.get("torque"))
        hand.step(k * STEP, STEP)
    angle, speed = (outputs + NOISE * outputs.std(axis=0) * rng.normal(size=outputs.shape)).T
    return {"voltage": driven, "angle": angle, "speed": speed}


def fitted(seed: int, outputs: tuple[str, ...] = ("angle",), *, lag: int = 0, **factors: float) -> Calibration:
    """The small study of one recording, signals times these factors, and all inputs so many samples late."""
    signals = {name: factors.get(name, 1.0) * values for name, values in swung(seed).items()}
    signals["voltage"] = np.roll(signals["voltage"], lag)
    near = {"signal": "angle", "half_width": 0.05}
    asked = plain_study(
        components={"motor": {"model": "dc_motor"}, "hand": {"model": "pendulum"}},
        traces={"files": "run.csv"},
        outputs={f"hand.{name}": {"signal": name} for name in outputs},
        initial={"hand.angle_start": near, "hand.speed_start": {**near, "derivative": 1}},
        validation=None,
        truth=None,
    )
    trace = Trace(np.arange(COUNT) * STEP, signals, name="run")
    return PreparedStudy.of(asked, [StudyTrace(trace, {}, Path("run.csv"), "", "even")]).calibrated()


def said(calibration: Calibration) -> list[str]:
    return [line for line in calibration.warnings if TOLD in line]


@pytest.mark.parametrize(
    ("outputs", "factors", "place", "way"),
    [
        (("angle",), {"angle": -1.0}, "outputs.hand.angle:", OTHER_SIGN),
        (("angle",), {"voltage": -1.0}, "outputs.hand.angle:", OTHER_SIGN),
        (("angle",), {"angle": DEGREES}, "outputs.hand.angle:", AS_DEGREES),
        (("angle", "speed"), {"speed": -1.0}, "outputs.hand.speed:", OTHER_SIGN),
        (("angle", "speed"), {"angle": DEGREES}, "outputs.hand.angle:", AS_DEGREES),
        (("angle", "speed"), {"speed": 1 / DEGREES}, "outputs.hand.speed:", AS_RADIANS),
        (("angle", "speed"), {"voltage": -1.0}, "outputs.hand.angle and hand.speed:", OTHER_SIGN),
        (("angle", "speed"), dict.fromkeys(("angle", "speed"), DEGREES), "outputs.hand.angle and", AS_DEGREES),
    ],
)
def test_what_was_recorded_otherwise_is_named(
    outputs: tuple[str, ...], factors: dict[str, Any], place: str, way: str
) -> None:
    [line] = said(fitted(0, outputs, **factors))
    assert line.startswith(place) and way in line


@pytest.mark.slow
@pytest.mark.parametrize("outputs", [("angle",), ("angle", "speed")])
@pytest.mark.parametrize(("way", "factor"), [(OTHER_SIGN, -1.0), (AS_DEGREES, DEGREES)])
def test_it_is_named_in_nearly_every_draw_and_never_as_something_else(
    outputs: tuple[str, ...], way: str, factor: float
) -> None:
    """A draw whose start values are read badly fits little better either way."""
    lines = [said(fitted(seed, outputs, angle=factor)) for seed in range(DRAWS)]
    assert sum(map(len, lines)) >= DRAWS - 1
    assert all(way in line and line.startswith("outputs.hand.angle:") for own in lines for line in own)


@pytest.mark.slow
@pytest.mark.parametrize("outputs", [("angle",), ("angle", "speed")])
def test_commands_that_come_much_too_late_fit_as_badly_and_are_not_taken_for_it(outputs: tuple[str, ...]) -> None:
    found = [fitted(seed, outputs, lag=50) for seed in range(DRAWS)]
    assert max(one.train.median for one in found) < 0.7
    assert not [line for one in found for line in said(one)]


@pytest.mark.parametrize("outputs", [("angle",), ("angle", "speed")])
def test_what_fits_is_not_tried_otherwise(outputs: tuple[str, ...]) -> None:
    assert not said(fitted(0, outputs))
