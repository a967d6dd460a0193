"""Delays of commands and readings: applied as documented, found again with their intervals, kept in the result."""

from __future__ import annotations

import itertools
import json
import math
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from fmus.errors import InputError, ScenarioError
from fmus.modelling.instance import Instance
from fmus.models.plants import dc_motor, pendulum
from identification.calibrate import calibrate_study
from identification.output_error.free_runs.window import FreeRunWindow
from identification.output_error.schema import OutputErrorBlock
from identification.output_error.times.delays import HeldCommand, late_outputs
from identification.output_error.windows import cut_windows
from identification.recordings.campaign import StudyTrace
from identification.validation import validate_result
from orchestrator import formats
from orchestrator.trace import FloatArray, Trace
from tests.support.identification.small_study import LENGTH, TRUTH, plain_study, study, write_study
from tests.support.ssv import read_values

pytestmark = pytest.mark.usefixtures("in_this_process")

STEP, COUNT, FINE = 0.0025, 401, 25  # a study's step, its instants, and steps of the true rig in one of them
COMMAND, READING = 0.0037, 0.0061  # true delays [s], no multiples of the step
LATE = {"hand.angle": {"signal": "angle", "delay": "lag"}}
FREE = {"start": 0.002, "min": -0.01, "max": 0.02}


def command(seed: int, time: FloatArray) -> FloatArray:
    """(K,) a random voltage that changes every 50 ms [V]."""
    levels = np.random.default_rng([1, seed]).uniform(-0.01, 0.01, 100)
    return np.asarray(levels[np.clip(np.floor(time / 0.05 + 1e-9).astype(int), 0, None)])


def swing(seed: int, mass: float, late: float) -> tuple[FloatArray, FloatArray]:
    """(N,) angle and (N,) speed of the true rig, in steps of 0.1 ms, its voltage late by so much [s]."""
    time = np.arange((COUNT - 1) * FINE + 1) * STEP / FINE
    motor = Instance(dc_motor.MODEL, {"torque_gain": TRUTH["motor.torque_gain"]})
    own = {name.removeprefix("hand."): value for name, value in TRUTH.items() if name.startswith("hand.")}
    hand = Instance(pendulum.MODEL, {**own, "added_mass": mass, "added_length": LENGTH})
    angle, speed = [], []
    for at, voltage in zip(time, command(seed, time - late), strict=True):
        angle.append(hand.get("angle"))
        speed.append(hand.get("speed"))
        motor.set("voltage", float(voltage))
        hand.set("torque", motor.get("torque"))
        hand.step(float(at), STEP / FINE)
    return np.array(angle), np.array(speed)


def record(folder: Path, reading: float = READING, noise: float = 2e-5) -> Path:
    """Recordings of the true rig: angle stamped `reading` [s] late, speed in time."""
    folder.mkdir()
    time = np.arange(COUNT) * STEP
    shift = round(reading / STEP * FINE)
    for number, (name, mass) in enumerate({"rig_0__a": 0.0, "rig_50__b": 0.05, "rig_100__c": 0.1}.items()):
        angle, speed = swing(number, mass, COMMAND)
        rows = np.clip(np.arange(COUNT) * FINE - shift, 0, len(angle) - 1)
        rng = np.random.default_rng(number)
        columns = {
            "voltage": command(number, time),
            "angle": angle[rows] + rng.normal(0, noise, COUNT),
            "speed": speed[::FINE] + rng.normal(0, 100 * noise, COUNT),
        }
        formats.write(Trace(time, columns), folder / f"{name}.csv")
    return folder


def late_study(path: Path, outputs: Mapping[str, Any] | None = None, **changes: Any) -> Path:
    """The small study with a delay of its command and of its angle."""
    both = {"hand.angle": {"signal": "angle", "delay": "reading"}, "hand.speed": {"signal": "speed"}}
    free = {name: study()["parameters"][name] for name in ("motor.torque_gain", "hand.viscous_friction")}
    known = {name: {"start": value, "fixed": True} for name, value in TRUTH.items() if name not in free}
    plain = {
        "step": STEP,
        "inputs": {"motor.voltage": {"signal": "voltage", "delay": "wire"}},
        "outputs": outputs or both,
        "parameters": {**free, **known, "wire": FREE, "reading": FREE},
        "truth": TRUTH | {"wire": COMMAND, "reading": READING},
    }
    return write_study(path, **plain | changes)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("late") / "data")


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory, data: Path) -> Path:
    folder = tmp_path_factory.mktemp("delayed")
    calibrate_study(late_study(folder / "study.yaml"), data, folder / "out", lambda fraction, remark: None)
    return folder / "out"


def calibrated(study_file: Path, data: Path) -> dict[str, Any]:
    return calibrate_study(study_file, data, study_file.parent / "out", lambda fraction, remark: None)


STAMPS = np.arange(201) * 0.01
STAIRS = np.floor(STAMPS / 0.05 + 1e-9)


def cuts(**changes: Any) -> list[FreeRunWindow]:
    """Windows of parabolas and a staircase, recorded every 10 ms for 2 s."""
    signals = {"voltage": STAIRS, "angle": STAMPS**2, "speed": 1 - STAMPS**2}
    asked = plain_study(**changes)
    return cut_windows(
        asked.run, [StudyTrace(Trace(STAMPS, signals, name="run"), {}, Path("run.csv"), "00", "fine")], asked.windows
    )


def cut(**changes: Any) -> FreeRunWindow:
    """One window of 1 s after 0.5 s."""
    (window,) = cuts(**{"windows": {"length": 1, "skip": 0.5, "most": 1}} | changes)
    return window


def late(**more: Any) -> dict[str, Any]:
    """A delay named `lag`, free in these bounds."""
    return study()["parameters"] | {"lag": {"start": 0.004, "min": -0.013, "max": 0.021} | more}


def summary(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return document


@pytest.mark.slow
def test_fractional_delays_are_found_inside_narrow_intervals(result: Path) -> None:
    parameters = summary(result)["parameters"]
    for name, true in {"wire": COMMAND, "reading": READING, "motor.torque_gain": 8.0}.items():
        low, high = parameters[name]["ci95"]
        assert low <= true <= high, name
    for name in ("wire", "reading"):
        assert parameters[name]["unit"] == "s"
        assert parameters[name]["ci95"][1] - parameters[name]["ci95"][0] < 0.1 * STEP


@pytest.mark.slow
def test_a_clock_that_is_ahead_is_a_negative_delay(tmp_path: Path) -> None:
    data = record(tmp_path / "data", reading=-0.0048)
    parameters = calibrated(late_study(tmp_path / "study.yaml"), data)["parameters"]
    low, high = parameters["reading"]["ci95"]
    assert low <= -0.0048 <= high < -0.004


def test_delays_are_no_parameters_of_fmus_but_validation_uses_them(result: Path, data: Path, tmp_path: Path) -> None:
    names = set(summary(result)["parameters"]) - {"wire", "reading"} | {"hand.added_length"}
    assert set(read_values(result / "parameters.ssv")) == names
    assert re.search(r"wire.{0,200}0\.0037", (result / "report.html").read_text(), re.DOTALL)
    judged = validate_result(result, data, tmp_path / "judged", lambda fraction, remark: None)
    fit = summary(result)["fit"]
    assert judged["fit"] == {"unseen": fit["validation"], "fitted": fit["train"]}


def test_a_result_that_does_not_tell_its_delays_is_refused(result: Path, data: Path, tmp_path: Path) -> None:
    spoilt = shutil.copytree(result, tmp_path / "out")
    document = summary(result)
    del document["parameters"]["wire"]
    (spoilt / "summary.json").write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"summary\.json: does not tell the delays of its study .* calibrate again"):
        validate_result(spoilt, data, tmp_path / "judged", lambda fraction, remark: None)


LAG = '''"""A first-order lag of 0.1 s."""
from .model import Model, State, input_, output

MODEL = Model("lag", "Lag", (input_("v", "V", "Input"), output("y", "1", "Output")), states=(State("y"),),
              derivatives=lambda t, x, u, p: {"y": (u.v - x.y) / 0.1}, solver_step=lambda p: 0.001)
'''


def lagging(driven: FloatArray, late: float) -> FloatArray:
    """(K,) the lag's output, recorded so much too late [s]: exact for its held input, in steps of 0.1 ms."""
    held = np.concatenate([np.zeros(round(late / 1e-4)), np.repeat(driven, 50)])
    decay, y = math.exp(-1e-4 / 0.1), [0.0]
    for v in held[:-1]:
        y.append(v + (y[-1] - v) * decay)
    return np.array(y)[: 50 * len(driven) : 50] + np.random.default_rng(1).normal(0, 1e-3, len(driven))


@pytest.mark.slow
def test_of_a_command_and_a_reading_that_are_both_late_only_the_sum_is_seen(tmp_path: Path) -> None:
    (tmp_path / "lag.py").write_text(LAG)
    time = np.arange(201) * 0.005
    driven = np.sin(math.pi * np.clip((time - 0.1) / 0.8, 0, 1)) ** 2
    formats.write(Trace(time, {"v": driven, "y": lagging(driven, 0.0083)}), tmp_path / "lag.csv")
    study_file = late_study(
        tmp_path / "study.yaml",
        components={"lag": {"model": "lag.py"}},
        connections=None,
        step=0.005,
        traces={"files": "lag.csv"},
        inputs={"lag.v": {"signal": "v", "delay": "wire"}},
        outputs={"lag.y": {"signal": "y", "delay": "reading"}},
        parameters={"wire": FREE, "reading": FREE},
        validation=None,
        truth=None,
    )
    document = calibrated(study_file, tmp_path)
    told = [*document["uncertainty"]["unseen"], *document["uncertainty"]["weak"]]
    (message,) = [each for each in told if each in document["warnings"]]
    assert re.match(
        r"wire and reading: (only|hardly more than) a sum of them is seen, wire \+ (1|0\.99\d*|1\.00\d*) \*", message
    )
    total = document["parameters"]["wire"]["value"] + document["parameters"]["reading"]["value"]
    assert total == pytest.approx(0.0083, abs=2e-4)


@given(
    stamps=st.lists(st.floats(0.01, 1), min_size=1, max_size=6),
    edges=st.lists(st.floats(0.05, 2), min_size=1, max_size=6),
    begin=st.floats(-3, 3),
    seed=st.integers(0, 99),
)
def test_a_held_command_has_the_mean_of_its_pieces(
    stamps: list[float], edges: list[float], begin: float, seed: int
) -> None:
    time = np.concatenate([[0.0], np.cumsum(stamps)])
    values = np.random.default_rng(seed).normal(size=len(time))
    limits = begin + np.concatenate([[0.0], np.cumsum(edges)])
    starts, stops = np.append(-np.inf, time[1:]), np.append(time[1:], np.inf)
    expected = [
        np.sum(values * np.maximum(0.0, np.minimum(stops, high) - np.maximum(starts, low))) / (high - low)
        for low, high in itertools.pairwise(limits)
    ]
    held = HeldCommand(time, values)
    np.testing.assert_allclose(held.means(limits), expected, atol=1e-12)
    part = held.between(float(limits[0]), float(limits[-1]))
    np.testing.assert_allclose(part.means(limits), expected, atol=1e-12)


@given(delay=st.floats(-0.2, 0.3), seed=st.integers(0, 99))
def test_late_readings_are_exact_for_parabolas_each_with_its_own_delay(delay: float, seed: int) -> None:
    time, rows = np.arange(21) * 0.1, slice(3, 19)
    first, second = (np.polynomial.Polynomial(c) for c in np.random.default_rng(seed).normal(size=(2, 3)))
    outputs = np.column_stack([first(time), second(time), first(time)])
    found = late_outputs(outputs, 0.1, [delay, None, 0.1], np.arange(21.0)[rows])
    expected = np.column_stack([first(time - delay), second(time), first(time - 0.1)])[rows]
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_late_readings_of_three_instants_are_exact_for_parabolas_and_of_two_for_lines() -> None:
    time = np.arange(3) * 0.1
    assert late_outputs((time**2)[:, None], 0.1, [0.05], np.array([1.0, 2.0])).ravel() == pytest.approx(
        [0.05**2, 0.15**2]
    )
    assert late_outputs(time[:2, None], 0.1, [0.03], np.array([1.0])).ravel() == pytest.approx([0.07])


def test_a_delayed_command_counts_by_its_mean_and_one_without_a_delay_by_its_value() -> None:
    delayed = cut(inputs={"motor.voltage": {"signal": "voltage", "delay": "lag"}}, parameters=late())
    found = delayed.driven({"lag": 0.004})["motor.voltage"]
    np.testing.assert_allclose(found[10:13], [11.6, 12, 12])  # the stair of 0.6 s comes at 0.604 s
    np.testing.assert_allclose(delayed.stimuli["motor.voltage"], found)
    np.testing.assert_allclose(delayed.driven({"lag": -0.01})["motor.voltage"][8:10], [11, 12])
    plain = cut()
    assert plain.driven({})["motor.voltage"][10] == 12
    assert plain.driven({}) == plain.stimuli


@pytest.mark.parametrize("delay", [-0.013, 0.0, 0.004, 0.021])
def test_a_delayed_command_is_right_to_the_last_instant_for_every_delay_within_the_bounds(delay: float) -> None:
    inputs = {"motor.voltage": {"signal": "voltage", "delay": "lag", "factor": 2}}
    window = cut(inputs=inputs, parameters=late())
    edges = 0.5 + np.arange(102) * 0.01 - delay
    expected = 2 * HeldCommand(STAMPS, STAIRS).means(edges)
    np.testing.assert_allclose(window.driven({"lag": delay})["motor.voltage"], expected, atol=1e-9)


def test_windows_end_where_the_last_corrected_recording_does() -> None:
    """An output that is 0.25 s late was recorded up to 1.75 s of the rig's time."""
    outputs = {
        "hand.angle": {"signal": "angle", "delay": 0.25},
        "hand.speed": {"signal": "speed", "delay": 0.05},
    }
    windows = cuts(outputs=outputs, windows={"length": "0.9"})
    assert [window.start for window in windows] == pytest.approx([-0.05, 0.85])
    assert len(cuts(outputs=outputs, windows={"length": "0.91"})) == 1


def test_as_many_instants_are_compared_for_every_delay_within_the_bounds() -> None:
    window = cut(outputs=LATE, parameters=late())
    np.testing.assert_array_equal(window.at, np.arange(3, 99))
    assert len(window.run_time) == 101
    np.testing.assert_allclose(window.time, 0.5 + np.arange(3, 99) * 0.01)
    np.testing.assert_allclose(window.measured[:, 0], window.time**2)
    for delay in (-0.013, 0.0, 0.021):
        found = window.recorded(window.run_time[:, None] ** 2, {"lag": delay})
        np.testing.assert_allclose(found[:, 0], (window.time - delay) ** 2, atol=1e-12)


def test_a_known_delay_of_an_output_corrects_its_stamps() -> None:
    """Nothing is cut off for it, and a window can begin as early as the corrected recording does."""
    window = cut(outputs={"hand.angle": {"signal": "angle", "delay": "1/250"}})
    np.testing.assert_allclose(window.at, np.arange(1, 101) - 0.4)  # the samples, no instants of the free run
    np.testing.assert_allclose(window.measured[:, 0], (window.time + 0.004) ** 2)
    np.testing.assert_allclose(window.recorded(window.run_time[:, None] ** 2, {})[:, 0], window.time**2)
    early = cut(outputs={"hand.angle": {"signal": "angle", "delay": 0.025}}, windows={"length": 1})
    assert early.start == -0.02 and early.measured[0, 0] == pytest.approx(0.01**2)
    assert early.driven({})["motor.voltage"][0] == 0  # before its first stamp a command has its first value


def test_a_fixed_parameter_is_a_delay_too_and_a_tied_one_follows() -> None:
    fixed = late(start=-0.02, min=None, max=None, fixed=True)
    assert cut(outputs=LATE, parameters=fixed).at.tolist() == [*range(99)]
    twice = {"hand.angle": {"signal": "angle", "delay": "twice"}}
    assert cut(outputs=twice, parameters=late() | {"twice": {"tied": "lag", "factor": -2}}).at.tolist() == [
        *range(3, 96)
    ]


def test_a_factor_brings_recordings_to_the_units_of_variables() -> None:
    scaled = cut(
        inputs={"motor.voltage": {"signal": "voltage", "factor": 2}},
        outputs={"hand.angle": {"signal": "angle", "factor": 0.5}},
    )
    np.testing.assert_array_equal(scaled.measured, 0.5 * cut().measured)
    np.testing.assert_array_equal(scaled.stimuli["motor.voltage"], 2 * cut().stimuli["motor.voltage"])


def test_start_values_are_read_where_the_late_signal_shows_them() -> None:
    initial = {"hand.angle_start": {"signal": "angle"}, "hand.speed_start": {"signal": "angle", "derivative": 1}}
    window = cut(outputs=LATE, initial=initial, parameters=late())
    assert window.initial["hand.angle_start"] == pytest.approx(0.504**2)
    found = window.start_values({"lag": -0.01})
    assert found == pytest.approx({"hand.angle_start": 0.49**2, "hand.speed_start": 0.98})


def test_start_values_are_late_as_the_output_of_their_own_signal() -> None:
    outputs = {**LATE, "hand.speed": {"signal": "speed", "delay": 0.25}}
    initial = {"hand.speed_start": {"signal": "speed"}}
    window = cut(outputs=outputs, initial=initial, parameters=late())
    assert window.initial["hand.speed_start"] == pytest.approx(1 - 0.75**2)


def test_estimated_start_values_are_left_to_the_estimation() -> None:
    initial = {"hand.angle_start": {"signal": "angle", "estimated": True}}
    assert cut(outputs=LATE, initial=initial, parameters=late()).start_values({"lag": 0.0}) == {}


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"inputs": {"motor.voltage": {"signal": "voltage", "delay": "lagg"}}}, "delay 'lagg' is no param"),
        ({"outputs": {"hand.angle": {"signal": "angle", "delay": "hand.inertia"}}}, "delay 'hand.inertia' is no param"),
        ({"parameters": late(max=None), "outputs": LATE}, "lag: a delay needs `start`, `min` and `max`"),
        ({"parameters": late(start=None), "outputs": LATE}, "lag: a delay needs `start`, `min` and `max`"),
        ({"parameters": late() | {"lag": {"tied": "hand.inertia"}}, "outputs": LATE}, "can only be tied to another"),
        (
            {"parameters": late() | {"lag": {"tied": "two"}, "two": {"tied": "lag"}}, "outputs": LATE},
            "can only be tied to another",
        ),
        (
            {"outputs": {"hand.angle": {"signal": "angle", "delay": 0.01}, "hand.speed": {"signal": "angle"}}},
            "signal angle has two delays",
        ),
        ({"parameters": late(), "outputs": LATE, "compare": {"old": {"lag": 0.03}}}, "lag is not within its bounds"),
    ],
)
def test_delays_that_mean_nothing_are_refused(changes: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValidationError, match=problem):
        OutputErrorBlock.model_validate(study(**changes))


def test_delays_as_long_as_a_window_are_refused_with_the_way_out() -> None:
    with pytest.raises(ScenarioError, match=r"windows\.length: leaves nothing to compare .* narrow `min` and `max`"):
        cut(outputs=LATE, parameters=late(max=1.5))
