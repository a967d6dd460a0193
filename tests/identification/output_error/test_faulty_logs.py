"""A rig of one inertia on a bus whose log has a fault: the truth is found, and what is left out is said."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import InputError
from identification.calibrate import calibrate_study
from identification.validation import validate_result
from orchestrator.can import logs
from orchestrator.can.codec.encoding import Encoder
from orchestrator.can.database.database import load
from orchestrator.can.database.protection import checksums
from orchestrator.can.frames import Frames
from orchestrator.progress import silent
from orchestrator.trace import BoolArray, FloatArray, Trace

pytestmark = pytest.mark.usefixtures("in_this_process")

DBC = """VERSION ""
BU_: Controller Rig
BO_ 256 Command: 8 Controller
 SG_ torque : 0|32@1- (1,0) [-5|5] "N.m" Rig
 SG_ alive_counter : 32|4@1+ (1,0) [0|15] "" Rig
 SG_ crc : 56|8@1+ (1,0) [0|255] "" Rig
BO_ 512 Sensors: 8 Rig
 SG_ speed : 0|32@1- (1,0) [-1000|1000] "rad/s" Controller
 SG_ alive_counter : 32|4@1+ (1,0) [0|15] "" Controller
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "ChecksumSignal" STRING ;
BA_DEF_ BO_ "CounterSignal" STRING ;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "ChecksumSignal" "";
BA_DEF_DEF_ "CounterSignal" "";
BA_ "GenMsgCycleTime" BO_ 256 10;
BA_ "GenMsgCycleTime" BO_ 512 10;
BA_ "ChecksumSignal" BO_ 256 "crc";
BA_ "CounterSignal" BO_ 256 "alive_counter";
SIG_VALTYPE_ 256 torque : 1;
SIG_VALTYPE_ 512 speed : 1;
"""
STEP, COUNT, NOISE = 0.01, 1201, 0.02  # 12 s
BEGIN, END = 5.0, 7.0  # of the fault [s]
TRUTH = {"rotor.inertia": 0.01, "rotor.viscous_friction": 0.02}
COMMAND, SENSORS = 256, 512


def driven() -> FloatArray:
    """(K,) a random torque that changes every tenth cycle [N m]."""
    return np.repeat(np.random.default_rng(1).uniform(-1, 1, COUNT // 10 + 1), 10)[:COUNT]


def turned(torque: FloatArray) -> FloatArray:
    """(K,) the speed, exactly [rad/s]."""
    inertia, friction = TRUTH.values()
    decay, speed = math.exp(-friction / inertia * STEP), [0.0]
    for value in torque[:-1]:
        speed.append(decay * speed[-1] + (1 - decay) * float(value) / friction)
    return np.array(speed)


def recorded(folder: Path, spoil: Callable[[Frames, BoolArray], Frames] | None, rests: bool = True) -> Path:
    """The folder with database and log, spoilt during the fault, in which the rig `rests` without a torque."""
    (folder / "rig.dbc").write_text(DBC)
    database, time, torque = load(folder / "rig.dbc"), STEP * np.arange(COUNT), driven()
    there = (time >= BEGIN) & (time < END)
    speed = turned(np.where(there & rests, 0.0, torque)) + np.random.default_rng(2).normal(0, NOISE, COUNT)
    frames = Encoder(database, ["torque", "speed"]).encode(Trace(time, {"torque": torque, "speed": speed}))
    if spoil is not None:
        frames = spoil(frames, (frames.time >= BEGIN) & (frames.time < END))
    logs.write(folder / "run.blf", [frames[np.argsort(frames.time, kind="stable")]])
    return folder


def lost(identifier: int) -> Callable[[Frames, BoolArray], Frames]:
    return lambda frames, there: frames[~(there & (frames.id == identifier))]


def told(torque: float, counts: bool = True, right: bool = True) -> Callable[[Frames, BoolArray], Frames]:
    """Commands of this torque, whose counter goes on and whose checksum is right, or not."""

    def spoil(frames: Frames, there: BoolArray) -> Frames:
        data, rows = frames.data.copy(), np.flatnonzero(there & (frames.id == COMMAND))
        data[rows, :4] = np.frombuffer(np.float32(torque).tobytes(), np.uint8)
        data[rows, 4] = data[rows, 4] if counts else data[rows[0], 4]
        data[rows, 7] = checksums(data[rows], "CRC8_SAE_J1850", 7) ^ (0 if right else 1)
        return replace(frames, data=data)

    return spoil


def late(frames: Frames, there: BoolArray) -> Frames:
    """Nobody read meanwhile; then all that had waited was stamped in a burst."""
    return replace(frames, time=np.where(there, END - 1e-3 + 1e-6 * np.arange(len(frames)), frames.time))


FAULTS: dict[str, tuple[Callable[[Frames, BoolArray], Frames] | None, bool, tuple[str, ...]]] = {
    "nothing": (None, False, ()),
    "commands lost": (lost(COMMAND), True, ("gap",)),
    "readings lost": (lost(SENSORS), False, ("gap",)),
    "wrong checksums": (told(1.0, right=False), True, ("checksum",)),
    "a counter that stands still": (told(1.0, counts=False), True, ("counter",)),
    "torques out of range": (told(60.0), True, ("range",)),
    "torques that are none": (told(math.nan), True, ("nan",)),
    "late stamps": (late, False, ("late",)),
}


def study(folder: Path, **traces: Any) -> Path:
    parameters = {
        "rotor.inertia": {"start": 0.02, "min": 0.001, "max": 0.1, "scale": "log"},
        "rotor.viscous_friction": {"start": 0.01, "min": 0.0001, "max": 0.5, "scale": "log"},
    }
    document = {
        "title": "A rotor from the bus",
        "method": "output-error",
        "components": {"rotor": {"model": "pendulum", "parameters": {"gravity_torque": 0}}},
        "step": STEP,
        "traces": {"files": "*.blf", "layout": {"database": "rig.dbc"}} | traces,
        "inputs": {"rotor.torque": {"signal": "torque"}},
        "outputs": {"rotor.speed": {"signal": "speed"}},
        "initial": {"rotor.speed_start": {"signal": "speed", "half_width": 0.045, "estimated": True}},
        "windows": {"length": 1},
        "parameters": parameters,
        "truth": TRUTH,
    }
    (folder / "study.yaml").write_text(json.dumps(document))
    return folder / "study.yaml"


def found(folder: Path, **traces: Any) -> Any:
    return calibrate_study(study(folder, **traces), None, folder / "out", silent)


def assert_true(document: Any) -> None:
    for name, entry in document["parameters"].items():
        low, high = entry["ci95"]
        assert low <= TRUTH[name] <= high and high - low < 0.1 * TRUTH[name], (name, entry)


@pytest.mark.parametrize("fault", FAULTS)
def test_the_truth_is_within_its_interval_whatever_the_fault_and_what_is_left_out_is_said(
    fault: str, tmp_path: Path
) -> None:
    spoil, rests, kinds = FAULTS[fault]
    document = found(recorded(tmp_path, spoil, rests))
    assert_true(document)
    (trace,) = document["data"]
    assert {mark.kind for mark in trace.get("marks", [])} == set(kinds)
    warned = [warning for warning in document["warnings"] if "are left out" in warning]
    assert bool(warned) == bool(kinds)
    assert ("from [s]" in (tmp_path / "out" / "report.html").read_text()) == bool(kinds)
    assert trace.get("left_out", 0) == pytest.approx(2 if kinds else 0, abs=0.05)
    assert document["fit"]["train"]["windows"] in ((8, 9, 10) if kinds else (12,))
    assert document["verdict"]["held"] and not document["verdict"]["said"]


def test_what_is_kept_spoils_the_fit_and_that_is_no_success(tmp_path: Path) -> None:
    document = found(recorded(tmp_path, told(1.0, counts=False)), keep=["counter"])
    (trace,) = document["data"]
    assert (
        "taken all the same, as the study says: a counter that stands still of torque from 5 to 7 s"
        in trace["notes"][-1]
    )
    assert document["fit"]["train"]["median"] < 0.5 and "left_out" not in trace
    assert not document["verdict"]["held"] and document["verdict"]["said"].startswith("DOUBTFUL: median FIT, fitted")


@pytest.mark.parametrize(
    "exclude", [[[5, 7]], [{"trace": "run", "from": 5, "to": 7}], [{"signal": "torque", "above": 3}]]
)
def test_what_a_study_excludes_is_left_out(exclude: Any, tmp_path: Path) -> None:
    """The rig was held for two seconds, which nothing in the log tells; or a torque of 4 N m says so."""
    document = found(recorded(tmp_path, told(4.0)), exclude=exclude)
    assert_true(document)
    (trace,) = document["data"]
    assert [mark.kind for mark in trace["marks"]] == ["excluded"]
    assert trace["left_out"] == pytest.approx(2, abs=0.03)


def test_a_result_is_validated_on_other_recordings_than_those_its_exclusions_name(tmp_path: Path) -> None:
    found(recorded(tmp_path, told(4.0)), exclude=[{"trace": "run", "from": 5, "to": 7}, [11, 11.5]])
    other = tmp_path / "other"
    other.mkdir()
    recorded(other, lost(COMMAND))
    (other / "run.blf").rename(other / "new.blf")
    judged = validate_result(tmp_path / "out", other, tmp_path / "judged", silent)
    assert judged["fit"]["unseen"]["median"] > 0.9
    assert {mark.kind for mark in judged["data"][0]["marks"]} == {"gap", "excluded"}


@pytest.mark.parametrize(
    ("exclude", "problem"),
    [
        ([[7, 5]], "`from` is after `to`"),
        ([[5]], r"a stretch has two ends: \[from, to\]"),
        ([{"trace": "walk", "from": 1}], "there is no trace 'walk'; there are run"),
        ([[20, 30]], "lies in no trace; the longest ends at 12 s"),
        ([{"signal": "torque"}], "`signal` goes with `above` or `below`"),
        ([{"signal": "volts", "above": 1}], "has no signal 'volts'"),
        ([{}], "give `from`, `to`, or a `signal`"),
    ],
)
def test_an_exclusion_that_means_nothing_is_refused(exclude: Any, problem: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=problem):
        found(recorded(tmp_path, None), exclude=exclude)
