"""What the regression suite adds to its scenarios, and what running them side by side gains.

The cache of built FMUs is warm. The gain needs two idle processors.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from ..figure import Figure

ROOT = Path(__file__).parents[3]
SERVOTWIN = [sys.executable, "-c", "from identification.cli import main; main()"]
COUNT, FASTER, OVERHEAD = 200, 1.8, 0.030  # scenarios, times, seconds
SCENARIO = """title: A short swing
components:
  motor: {{model: dc_motor}}
  hand: {{model: pendulum, parameters: {{angle_start: {start}}}}}
connections:
  - hand.speed -> motor.speed
  - motor.torque -> hand.torque
run: {{stop: 20, step: 0.0005}}
expect:
  - {{signal: hand.angle, below: 4}}
"""


def figures() -> list[Figure]:
    """The time of 200 short scenarios one after the other and two at a time, and what each takes besides its steps."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "suite").mkdir()
        for number in range(COUNT):
            (folder / "suite" / f"swing{number:03}.yaml").write_text(SCENARIO.format(start=0.1 + number / 1000))
        tested(folder, 1, folder / "suite" / "swing000.yaml")  # builds the FMUs
        alone = tested(folder, 1, folder / "suite")
        together = tested(folder, 2, folder / "suite")
    simulated = sum(case["stepping"]["seconds"] for one in alone["scenarios"] for case in one["result"]["cases"])
    overhead = (alone["seconds"] - simulated) / COUNT
    gain = alone["seconds"] / together["seconds"]
    return [
        Figure(f"{COUNT} short scenarios, -j 1", "-", f"{alone['seconds']:.1f} s"),
        Figure("with -j 2 faster by", f"at least {FASTER:g} x", f"{gain:.2f} x", gain >= FASTER),
        Figure(
            "a scenario beyond its steps",
            f"under {1e3 * OVERHEAD:.0f} ms",
            f"{1e3 * overhead:.1f} ms",
            overhead < OVERHEAD,
        ),
    ]


def tested(folder: Path, processes: int, path: Path) -> dict[str, Any]:
    """What the suite says of a path."""
    out = folder / f"{path.stem}_{processes}"  # new each time: to replace earlier results is more work
    command = [*SERVOTWIN, "test", str(path), "-j", str(processes), "--out", str(out), "--json"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "SERVOTWIN_CACHE": str(folder / "cache")}
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, env=environment, cwd=folder)
    document: dict[str, Any] = json.loads(done.stdout)
    return document
