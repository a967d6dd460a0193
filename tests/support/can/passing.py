"""Traffic of a small rig over a scripted bus, step by step."""

from __future__ import annotations

import struct
from fractions import Fraction
from typing import Any, cast

from orchestrator.bridge.bus.traffic import BusTraffic
from orchestrator.bridge.mapping import coupled
from orchestrator.bridge.safety.watchdog import Watchdog
from orchestrator.can.database.database import Database
from orchestrator.can.live.backlog import Backlog
from orchestrator.can.live.bus import BusSettings
from orchestrator.can.live.line import SendingLine
from orchestrator.can.live.news import News
from orchestrator.can.live.receiver import Receiver
from orchestrator.scenario.can_block import CanBlock
from tests.support.can.coupling_samples import ScriptedBus, frame, sample_system

STEP, GUARDED, COMMAND = 0.001, 259, 257
ANY, TIMED = BusSettings("slcan", "adapter"), BusSettings("slcan", "adapter", 500_000)
THEIRS = frame(1, bytes(8))
BLOCK: dict[str, Any] = {
    "receive": {"rig.voltage": {"signal": "Command.voltage", "safe": 0}},
    "send": {"torque": {"source": "rig.torque", "safe": 0.125}},
    "most_late": 0.05,
    "silence": 0.2,
}


def on(bus: ScriptedBus, rig: Database, said: list[str], setting: BusSettings = ANY, **changes: Any) -> BusTraffic:
    block = CanBlock.model_validate({"database": rig.path} | BLOCK | changes)
    coupling = coupled(block, sample_system(), [rig], Fraction(1, 1000))
    watchdog = Watchdog(coupling.reception.messages, said.append)
    link, receiver = bus.linked(said.append)
    line = SendingLine(link, cast(Receiver, receiver), Backlog(setting), coupling.rules.most_late)
    return BusTraffic([line], coupling, watchdog, STEP, News(said.append))


def torques(bus: ScriptedBus) -> list[float]:
    return [struct.unpack_from("<h", message.data)[0] * 1e-3 for message in bus.identified(GUARDED)]


def run(traffic: BusTraffic, bus: ScriptedBus, first: int, last: int, lateness: float = 0.0, real: float = 0.0) -> None:
    """These steps; each takes `real` instead of a period where it is given [s]."""
    for number in range(first, last):
        now = number * STEP if not real else first * STEP + lateness + (number - first) * real
        bus.waiting.append(frame(COMMAND, struct.pack("<hH", number, 0)))
        traffic.receive(now)
        traffic.send(number, [0.25], now, lateness)
