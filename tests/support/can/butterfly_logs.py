"""CAN logs of the Butterfly robot: its recordings as the bus of `butterfly.dbc` would have carried them.

Values have the resolution of the database, stamps jitter, and some frames are lost.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from orchestrator import formats
from orchestrator.can import logs
from orchestrator.can.codec.encoding import Encoder
from orchestrator.can.database.database import load
from orchestrator.can.frames import Frames
from orchestrator.formats import Layout

DATABASE = Path(__file__).parents[3] / "scenarios" / "butterfly" / "butterfly.dbc"
LAYOUT = Layout("D", 0, {"voltage": 1, "angle": 2, "speed": 3})
JITTER, LOST = 2e-4, 0.005  # rms [s], share of the frames
START = 1.6e9  # POSIX time of the first frame [s]


def write_logs(recordings: Path, target: Path, pattern: str = "Data_*.mat", seed: int = 0) -> list[Path]:
    """One BLF file a recording, by its name."""
    target.mkdir(parents=True, exist_ok=True)
    database, written = load(DATABASE), []
    for number, file in enumerate(sorted(recordings.glob(pattern))):
        trace = formats.read(file, LAYOUT).trace
        frames = Encoder(database, list(trace.names)).encode(trace, START)
        log = target / f"{file.stem}.blf"
        logs.write(log, [on_a_real_bus(frames, np.random.default_rng([seed, number]))], database)
        written.append(log)
    return written


def on_a_real_bus(frames: Frames, rng: np.random.Generator) -> Frames:
    """The frames with jittered stamps, without those that are lost."""
    kept = frames[rng.random(len(frames)) >= LOST]
    late = replace(kept, time=kept.time + rng.normal(0, JITTER, len(kept)))
    return late[np.argsort(late.time, kind="stable")]
