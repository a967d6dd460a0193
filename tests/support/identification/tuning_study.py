"""A small study of tuning, that tests change here and there: a PI controller for two integrators with a lag."""

from __future__ import annotations

import json
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm

STEP = 0.01
LOAD = """
from . import Model, State, input_, output, parameter


def derivatives(t, x, u, p):
    return {"angle": x.speed, "speed": (u.torque - p.damping * x.speed) / p.inertia}


MODEL = Model(
    name="load",
    description="A load with damping",
    variables=(
        input_("torque", "N.m", "Torque"),
        output("angle", "rad", "Angle"),
        parameter("inertia", "kg.m2", 0.1, "Inertia", minimum=1e-6),
        parameter("damping", "N.m.s/rad", 1.0, "Damping", minimum=0),
    ),
    states=(State("angle"), State("speed")),
    derivatives=derivatives,
    solver_step=lambda p: 0.001,
)
"""


def lagging(gain: float, lag: float = 0.1) -> dict[str, Any]:
    """y'' lag + y' = gain u, under a held u, as matrices of a study."""
    block = np.zeros((3, 3))
    block[:2, :2], block[1, 2] = [[0, 1], [0, -1 / lag]], gain / lag
    whole = expm(block * STEP)
    return {
        "A": whole[:2, :2].tolist(),
        "B": whole[:2, 2:].tolist(),
        "C": [[1.0, 0.0]],
        "sample_time": STEP,
        "inputs": {"u": "V"},
        "outputs": {"position": "V"},
    }


STUDY: dict[str, Any] = {
    "title": "A servo with two loads",
    "method": "tune",
    "controller": {"model": "pi", "parameters": {"sample_time": STEP, "ki": 0}},
    "plants": {"light": {"matrices": lagging(2.0)}, "heavy": {"matrices": lagging(1.0)}},
    "connections": ["plant.position -> controller.position", "controller.voltage -> plant.u"],
    "reference": "controller.reference",
    "tracked": "plant.position",
    "step": {"duration": 4},
    "goals": [{"measure": "phase margin", "at_least": "60 deg"}],
    "minimise": [{"measure": "itae"}],
    "design": {"unknowns": {"kp": {"start": 0.5, "min": 0.01, "max": 20}}},
}


def study(**changes: Any) -> dict[str, Any]:
    """The study with other keys at its top; None takes one out."""
    merged = deepcopy(STUDY) | changes
    return {key: value for key, value in merged.items() if value is not None}


def write(folder: Path, document: dict[str, Any]) -> Path:
    """The study as a file (JSON is YAML)."""
    file = folder / "study.yaml"
    file.write_text(json.dumps(document))
    return file


def system_study(folder: Path, **plant: Any) -> dict[str, Any]:
    """A load that an input moves, from a file."""
    (folder / "load.py").write_text(LOAD)
    outputs = {"position": {"of": "load.angle", "factor": 5, "unit": "V"}}
    own = {"components": {"load": {"model": "load.py"}}, "inputs": {"u": "load.torque"}, "outputs": outputs}
    return study(
        plants={"load": own | plant},
        connections=["plant.position -> controller.position", "controller.voltage -> plant.u"],
        goals=[{"measure": "phase margin", "at_least": 60}],
    )


def driven(folder: Path, **plant: Any) -> dict[str, Any]:
    """The load behind a drive."""
    document = system_study(folder, **plant)
    [load] = document["plants"].values()
    load["components"] = {
        "drive": {"model": "servo_drive", "parameters": {"torque_constant": 2.0}},
        **load["components"],
    }
    load["connections"] = ["drive.torque -> load.torque"]
    load["inputs"] = {"u": "drive.voltage"}
    return document
