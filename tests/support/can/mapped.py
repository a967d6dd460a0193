"""Couplings of a rig to a database, and what they make of frames and values."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from orchestrator.bridge.mapping import Coupling, coupled
from orchestrator.bridge.signals.outputs import SentMessage
from orchestrator.can.database.database import Database
from orchestrator.crossing import NamedUnit, crossing
from orchestrator.scenario.can_block import CanBlock
from orchestrator.trace import FloatArray
from tests.support.can.coupling_samples import frame, sample_system

STEP = Fraction(1, 1000)
AS_IT_IS = crossing("rig.any", NamedUnit(), NamedUnit())
INPUTS = ["rig.enable", "rig.gear", "rig.label", "rig.page", "rig.target", "rig.voltage"]  # in the order of the values
SAFE = {"signal": "Command.voltage", "safe": 1.5}


def couple(rig: Database, **block: Any) -> Coupling:
    return coupled(CanBlock(database=rig.path, **block), sample_system(), [rig], STEP)


def sent(message: SentMessage, outputs: list[float], resting: bool = False) -> bytes:
    """The data of the next frame."""
    found = message.frame(outputs, message.signals if resting else ())
    assert found is not None
    return bytes(found.data)


def received(coupling: Coupling, *frames: tuple[int, bytes]) -> FloatArray:
    """The inputs after these frames."""
    given = np.zeros(len(INPUTS))
    for identifier, data in frames:
        coupling.reception.take(frame(identifier, data), given)
    return given
