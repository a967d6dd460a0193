"""A calibration of a second: a motor and a pendulum, three recordings of 1 s at 10 ms with white noise, truth known."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.modelling.instance import Instance
from fmus.models.plants import dc_motor, pendulum
from identification.calibrate import calibrate_study
from identification.output_error.schema import OutputErrorBlock
from identification.output_error.study import OutputErrorStudy
from orchestrator import formats
from orchestrator.progress import silent
from orchestrator.trace import FloatArray, Trace

STEP, COUNT, NOISE = 0.01, 101, 2e-4
LENGTH = 0.1  # of the added masses [m]
TRUTH = {
    "motor.torque_gain": 8.0,
    "hand.inertia": 0.004,
    "hand.gravity_torque": 0.04,
    "hand.viscous_friction": 0.0015,
}
RECORDINGS = {"rig_0__a": 0.0, "rig_50__b": 0.05, "rig_100__c": 0.1}  # name -> added mass [kg]


def simulated(voltage: FloatArray, added_mass: float, truth: Mapping[str, float] = TRUTH) -> FloatArray:
    """(K,) angle [rad] of the true rig from rest, by its model functions alone: no FMU, no engine."""
    motor = Instance(dc_motor.MODEL, {"torque_gain": truth["motor.torque_gain"]})
    own = {name.removeprefix("hand."): value for name, value in truth.items() if name.startswith("hand.")}
    hand = Instance(pendulum.MODEL, {**own, "added_mass": added_mass, "added_length": LENGTH})
    angle = [hand.get("angle")]
    for k in range(len(voltage) - 1):
        motor.set("voltage", float(voltage[k]))
        hand.set("torque", motor.get("torque"))
        hand.step(k * STEP, STEP)
        angle.append(hand.get("angle"))
    return np.array(angle)


def voltage(seed: int) -> FloatArray:
    """(K,) a random voltage that changes every tenth sample [V]."""
    levels = np.random.default_rng([1, seed]).uniform(-0.01, 0.01, COUNT // 10 + 1)
    return np.repeat(levels, 10)[:COUNT]


def record(folder: Path, noise: float = NOISE, recordings: Mapping[str, float] = RECORDINGS, seed: int = 0) -> Path:
    """The folder, filled with one CSV file a recording: voltage and noisy angle."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, (name, mass) in enumerate(recordings.items()):
        driven = voltage(number)
        angle = simulated(driven, mass) + np.random.default_rng([2, seed, number]).normal(0, noise, COUNT)
        trace = Trace(np.arange(COUNT) * STEP, {"voltage": driven, "angle": angle}, {"voltage": "V", "angle": "rad"})
        formats.write(trace, folder / f"{name}.csv")
    return folder


def study(**changes: Any) -> dict[str, Any]:
    """The study as plain values; `changes` replace its top keys, None removes one."""
    document: dict[str, Any] = {
        "title": "A small rig",
        "method": "output-error",
        "components": {
            "motor": {"model": "dc_motor"},
            "hand": {"model": "pendulum", "parameters": {"added_length": LENGTH}},
        },
        "connections": ["hand.speed -> motor.speed", "motor.torque -> hand.torque"],
        "step": STEP,
        "traces": {
            "files": "rig_*.csv",
            "file_name": {"pattern": r"rig_(?P<mass>\d+)__\w+", "fields": {"mass": {"factor": 0.001}}},
            "values": {"hand.added_mass": "mass"},
            "hold_out": ["rig_100__c"],
        },
        "inputs": {"motor.voltage": {"signal": "voltage"}},
        "outputs": {"hand.angle": {"signal": "angle"}},
        "windows": {"length": 1},
        "validation": {"length": 1, "at_least": 0.95},
        "parameters": {
            "motor.torque_gain": {"start": 6.0, "min": 0.5, "max": 50.0, "scale": "log"},
            "hand.inertia": {"start": 0.006, "min": 0.0005, "max": 0.02},
            "hand.gravity_torque": {"start": 0.03, "min": -0.1, "max": 0.2},
            "hand.viscous_friction": {"start": 0.001, "min": 0.0, "max": 0.05},
        },
        "truth": TRUTH,
    }
    merged = document | changes
    return {key: value for key, value in merged.items() if value is not None}


def plain_study(**changes: Any) -> OutputErrorStudy:
    """The study as the numerics take it."""
    block = OutputErrorBlock.model_validate(study(**changes))
    return block.study(block.system(Path()), block.source(Path()))


def write_study(path: Path, **changes: Any) -> Path:
    """The study as a file; JSON is YAML."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(study(**changes), indent=2))
    return path


def calibrated(study_file: Path, data: Path, target: Path) -> dict[str, Any]:
    """The summary of a calibration, whose folder is `target`."""
    calibrate_study(study_file, data, target, silent)
    return summary(target)


def summary(folder: Path) -> dict[str, Any]:
    """The summary in a folder, which is JSON as the standard has it."""
    document: dict[str, Any] = json.loads((folder / "summary.json").read_text(), parse_constant=pytest.fail)
    return document
