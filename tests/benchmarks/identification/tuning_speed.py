"""What tuning takes: PDP over three models from three starts, and a system with 1,000 draws of its parameters."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

from identification import tune

from ..figure import Figure

ROOT = Path(__file__).parents[3]
PDP = ROOT / "scenarios" / "flexible_arm" / "control" / "tuning" / "pdp.yaml"
THREE, DRAWN, DRAWS = 30, 60, 1000  # [s], [s], how many
STEP = 1 / 300
SMOOTH = {"payload": 0.2, "bristle_stiffness": 1e-6, "bristle_damping": 0}
STUDY: dict[str, Any] = {
    "title": "PDP with draws of the arm's parameters",
    "method": "tune",
    "controller": {"model": "pdp"},
    "plants": {
        "arm": {
            "components": {
                "drive": {"model": "servo_drive"},
                "arm": {"model": "flexible_arm", "parameters": SMOOTH},
                "tachometer": {
                    "model": "daq",
                    "parameters": {"gain": 0.4, "filter_order": 2, "cutoff": 60, "sample_time": STEP},
                },
            },
            "connections": ["drive.torque -> arm.torque", "arm.speed -> tachometer.signal"],
            "inputs": {"u": "drive.voltage"},
            "outputs": {
                "position": {"of": "arm.angle", "factor": 4.911, "unit": "V"},
                "strain": {"of": "arm.middle_strain", "factor": 1e4, "unit": "V"},
                "speed": {"of": "tachometer.measured", "unit": "V"},
            },
            "spread": {"arm.bending_stiffness": 0.3, "drive.torque_constant": 0.03, "arm.hub_inertia": 2e-4},
        }
    },
    "connections": [
        "plant.position -> controller.position",
        "plant.speed -> controller.speed",
        "plant.strain -> controller.strain",
        "controller.voltage -> plant.u",
    ],
    "reference": "controller.reference",
    "tracked": "plant.position",
    "goals": [{"measure": "gain margin", "at_least": 10}, {"measure": "phase margin", "at_least": 55}],
    "minimise": [{"measure": "itae"}, {"measure": "itae", "of": "plant.strain", "relative": "peak"}],
    "draws": {"count": DRAWS, "share": 0.99},
    "design": {
        "unknowns": {
            "kp": {"start": 0.3, "min": 0.005, "max": 1},
            "kd": {"start": 3, "min": 0.05, "max": 15},
            "ks": {"start": 0.1, "min": 0.005, "max": 2},
        }
    },
}


def figures() -> list[Figure]:
    """Seconds of both, and what came of them."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "draws.yaml"
        file.write_text(json.dumps(STUDY))
        return [*measured("PDP, three models, three starts", PDP, THREE), *measured("PDP, 1,000 draws", file, DRAWN)]


def measured(name: str, file: Path, most: float) -> list[Figure]:
    """Time of a study, and whether it found what holds all goals."""
    begun, busy = perf_counter(), process_time()
    summary: Any = tune(file).summary
    taken, worked = perf_counter() - begun, process_time() - busy
    draws = summary.get("draws")
    found = f"{100 * draws['held']:.1f} % of the draws" if draws else f"{summary['agree']} starts to one optimum"
    return [
        Figure(f"{name}: time", f"under {most} s", f"{taken:.1f} s, {worked:.1f} s busy", taken < most),
        Figure(f"{name}: goals held", "yes", found, bool(summary["feasible"]), certain=True),
    ]
