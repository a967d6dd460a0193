"""An axis with one of five friction laws, recordings of it by the model's own functions, and the study that chooses."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fmus.modelling.instance import Instance
from fmus.models.plants import linear_axis
from identification.calibrate import calibrate
from identification.output_error import calibration
from orchestrator import formats
from orchestrator.trace import FloatArray, Trace
from tests.support.side_by_side import side_by_side

STEP, COUNT, NOISE = 0.005, 401, 1e-4  # [s], [1], [m]
FITTED, HELD_OUT = 5, 3  # recordings
FRICTION_SPEED = 4e-3  # [m/s]
_PLAIN = {"mass": 8.0, "viscous_friction_positive": 60.0, "viscous_friction_negative": 60.0}
_COULOMB = {**_PLAIN, "coulomb_friction_positive": 5.0, "coulomb_friction_negative": 5.0}
LAWS: Mapping[str, Mapping[str, float]] = {
    "viscous": _PLAIN,
    "Coulomb": _COULOMB,
    "asymmetric": {**_COULOMB, "coulomb_friction_negative": 5.2},
    "Stribeck": {**_COULOMB, "stribeck_friction": 1.0, "stribeck_speed": 0.03},
    "LuGre": {**_COULOMB, "bristle_stiffness": 5e3, "bristle_damping": 60.0},
}
"""Name -> parameters of the axis."""

_SIZE = {"start": 3.0, "min": 0.0, "max": 50.0}
_ALIKE = {
    "axis.coulomb_friction_positive": _SIZE,
    "axis.coulomb_friction_negative": {"tied": "axis.coulomb_friction_positive"},
}
CANDIDATES: Mapping[str, Any] = {
    "viscous": {},
    "Coulomb": {"parameters": _ALIKE},
    "asymmetric": {"parameters": {"axis.coulomb_friction_positive": _SIZE, "axis.coulomb_friction_negative": _SIZE}},
    "Stribeck": {
        "parameters": {
            **_ALIKE,
            "axis.stribeck_friction": {"start": 1.0, "min": 0.0, "max": 20.0},
            "axis.stribeck_speed": {"start": 0.05, "min": 0.005, "max": 0.5, "scale": "log"},
        }
    },
    "LuGre": {
        "parameters": {
            **_ALIKE,
            "axis.bristle_stiffness": {"start": 2e3, "min": 200.0, "max": 2e5, "scale": "log"},
            "axis.bristle_damping": {"start": 30.0, "min": 1.0, "max": 1e3, "scale": "log"},
        }
    },
}


def study(**changes: Any) -> dict[str, Any]:
    """The study as plain values; `changes` replace its top keys."""
    start = {"start": 30.0, "min": 0.0, "max": 500.0}
    return {
        "title": "Which friction",
        "method": "output-error",
        "components": {"axis": {"model": "linear_axis", "parameters": {"friction_speed": FRICTION_SPEED}}},
        "step": STEP,
        "traces": {"files": "*.csv", "hold_out": [_name(number) for number in range(FITTED, FITTED + HELD_OUT)]},
        "inputs": {"axis.command": {"signal": "command"}},
        "outputs": {"axis.position": {"signal": "position"}},
        "windows": {"length": STEP * (COUNT - 1)},
        "parameters": {
            "axis.mass": {"start": 5.0, "min": 1.0, "max": 50.0, "scale": "log"},
            "axis.viscous_friction_positive": start,
            "axis.viscous_friction_negative": {"tied": "axis.viscous_friction_positive"},
        },
        "candidates": CANDIDATES,
    } | changes


def record(folder: Path, law: str, seed: int) -> Path:
    """The folder, filled with recordings of an axis with this law: command [V] and noisy position [m]."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(FITTED + HELD_OUT):
        noise = np.random.default_rng([3, list(LAWS).index(law), seed, number]).normal(0, NOISE, COUNT)
        signals = {"command": command(number), "position": positions(law, number) + noise}
        trace = Trace(np.arange(COUNT) * STEP, signals, {"command": "V", "position": "m"})
        formats.write(trace, folder / f"{_name(number)}.csv")
    return folder


def _name(number: int) -> str:
    return f"rig{number}"


def command(number: int) -> FloatArray:
    """(K,) two sines that move the axis to and fro, fast and slow, about the size of its friction [V]."""
    time = np.arange(COUNT) * STEP
    first, second = 2.0 + 0.7 * number, 5.1 + 1.3 * number
    return np.asarray(9.0 * np.sin(first * time) + 4.0 * np.sin(second * time + number))


@cache
def positions(law: str, number: int) -> FloatArray:
    """(K,) position from rest [m], by the model's functions alone: no FMU, no engine."""
    axis = Instance(linear_axis.MODEL, {**LAWS[law], "friction_speed": FRICTION_SPEED})
    found = [axis.get("position")]
    for k, force in enumerate(command(number)[:-1]):
        axis.set("command", float(force))
        axis.step(k * STEP, STEP)
        found.append(axis.get("position"))
    return np.array(found)


def write_study(path: Path, **changes: Any) -> Path:
    """The study as a file; JSON is YAML."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(study(**changes), indent=2))
    return path


Draw = tuple[str, int]


def chosen(draw: Draw) -> str:
    """Which law the calibration of one draw (law, seed of the noise) chooses, simulated in this process."""
    law, seed = draw
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = calibrate(write_study(folder / "study.yaml"), record(folder / "recordings", law, seed))
    return str(found.summary["candidate"])  # type: ignore[typeddict-item]


def draws(count: int) -> list[Draw]:
    """So many, the laws in turn."""
    laws = list(LAWS)
    return [(laws[number % len(laws)], number // len(laws)) for number in range(count)]


def choices(asked: Sequence[Draw], processes: int) -> list[str]:
    """The laws that are chosen, in so many processes."""
    return side_by_side(_alone, asked, processes)


def _alone() -> Callable[[Draw], str]:
    """What chooses by simulating in this process, which is one of many."""
    calibration.processors = lambda: 1
    return chosen
