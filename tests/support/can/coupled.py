"""A hand on a bus, as tests of couplings run it, and what its peers see and answer."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import can

from orchestrator import formats
from orchestrator.bridge.bridge import BridgeResult, couple
from orchestrator.bridge.preparation import BridgeJob
from orchestrator.realtime.stopping import Stop
from orchestrator.trace import Trace
from tests.support.can.coupling_samples import BUS, ScriptedBus, frame

STATE, COMMAND, EXACT = 256, 257, 258
SCENARIO: dict[str, Any] = {
    "title": "A hand on a bus",
    "components": {
        "motor": {"fmu": "dc_motor.fmu"},
        "hand": {"fmu": "pendulum.fmu", "parameters": {"angle_start": 0.5}},
    },
    "connections": ["hand.speed -> motor.speed", "motor.torque -> hand.torque"],
    "run": {"stop": 0.2, "step": 0.001},
    "record": ["hand.angle", "hand.speed", "motor.voltage"],
    "can": {
        "database": "rig.dbc",
        "receive": {"motor.voltage": {"signal": "Command.voltage", "safe": 0.25}},
        "send": {"angle": "hand.angle", "speed": {"source": "hand.speed", "safe": 0}},
        "most_late": 1e4,  # a busy computer is no fault
        "give_up": 1e5,
    },
}


def written(folder: Path, **changes: Any) -> Path:
    """The scenario with these changes; those of `can` are within the block."""
    document = SCENARIO | changes
    document["can"] = SCENARIO["can"] | changes.get("can", {})
    path = folder / "rig.yaml"
    path.write_text(json.dumps(document))
    return path


def go(
    folder: Path,
    aside: Path,
    stand_in: bool = False,
    ready: Callable[[Stop], None] = lambda stop: None,
    duration: Fraction | None = None,
    **changes: Any,
) -> BridgeResult:
    return couple(BridgeJob(written(folder, **changes), BUS, stand_in, duration=duration), aside, ready)


def angle_of(message: can.Message) -> float:
    return float(struct.unpack_from("<i", message.data)[0]) * 1e-4


def proportional(message: can.Message) -> list[can.Message]:
    """A peer whose command is 20 mV against each radian."""
    return [frame(COMMAND, struct.pack("<hH", round(-20 * angle_of(message)), 0))] if len(message.data) == 8 else []


def trace_of(coupled: BridgeResult) -> Trace:
    (case,) = coupled.result.cases
    assert case.file is not None
    return formats.read(case.file).trace


def speeds(bus: ScriptedBus) -> list[int]:
    """What was sent as the speed, which has the safe value 0."""
    return [struct.unpack_from("<h", message.data, 4)[0] for message in bus.identified(STATE)]
