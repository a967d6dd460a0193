"""Sweeps of a small scenario, run in this process."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orchestrator.batch.sweep.runs.queue import Queue
from orchestrator.batch.sweep.runs.setup import Chunk, ChunkResult, Setup
from orchestrator.batch.sweep.runs.worker import Worker

FALLING = {
    "title": "falling",
    "components": {"hand": {"model": "pendulum", "parameters": {"angle_start": 0.5, "added_length": 0.1}}},
    "stimuli": {"hand.torque": {"constant": 0.0}},
    "run": {"stop": 0.5, "step": 0.01},
    "expect": [{"signal": "hand.speed", "peak": {"at_most": 4.0}}],
}
DRAWN = {
    "title": "masses and starts",
    "sweep": "falling.yaml",
    "vary": {
        "hand.added_mass": {"normal": "100 g", "std": "10 g", "between": [0.05, 0.15]},
        "hand.angle_start": {"between": ["30 deg", "90 deg"]},
    },
    "design": {"by": "monte-carlo", "samples": 20, "seed": 3},
    "traces": {"signals": ["hand.angle"], "every": 0.1},
}


@dataclass(frozen=True)
class Here:
    """Runs tasks in this process.

    Attributes:
        slots: of which there are as many as are said.
        told: asked before each task.
    """

    slots: int = 2
    told: Callable[[Chunk], None] = lambda task: None

    def check(self) -> None:
        return

    def outcomes(self, queue: Queue, setup: Setup) -> Iterator[tuple[Chunk, ChunkResult]]:
        queue.slots = self.slots
        worker = Worker(setup)
        try:
            for task in queue:
                self.told(task)
                done = worker(task)
                queue.answered(task, done)
                yield task, done
        finally:
            worker.close()


def study(folder: Path, scenario: Mapping[str, Any] = FALLING, **changes: Any) -> Path:
    """The file of a study beside its scenario; keys that are None are left out."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "falling.yaml").write_text(json.dumps(scenario))
    document = {key: value for key, value in {**DRAWN, **changes}.items() if value is not None}
    (folder / "study.yaml").write_text(json.dumps(document))
    return folder / "study.yaml"


def results(folder: Path) -> dict[str, str]:
    """Name -> hash of the files that hold results: the data set and what is told of it."""
    files = [*sorted((folder / "runs").iterdir()), folder / "summary.json"]
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
