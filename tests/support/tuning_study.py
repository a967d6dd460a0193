"""A small study of tuning, that tests change here and there: a PI controller for two integrators with a lag."""

from __future__ import annotations

import json
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm

STEP = 0.01


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
