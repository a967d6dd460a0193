"""A database and a system that fit each other, for tests of what couples them; and peers that answer at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, cast

import can

from fmus.errors import BusError
from orchestrator.assembly.wiring import wire
from orchestrator.can.database import database
from orchestrator.can.database.database import Database
from orchestrator.can.live.bus import BusSettings
from orchestrator.can.live.link import Link
from orchestrator.fmi.interface import Interface, Port
from orchestrator.system import Part, System

DBC = """VERSION ""
BU_: RIG LAW
BO_ 256 State: 8 RIG
 SG_ angle : 0|32@1- (0.0001,0) [-100|100] "rad" LAW
 SG_ speed : 32|16@1- (0.1,0) [-3000|3000] "rpm" LAW
 SG_ spare : 48|8@1+ (0.5,-10) [-10|50] "" LAW
BO_ 257 Command: 4 LAW
 SG_ voltage : 0|16@1- (1,0) [-24000|24000] "mV" RIG
 SG_ enable : 16|1@1+ (1,0) [0|1] "" RIG
 SG_ gear : 17|3@1+ (1,0) [0|7] "" RIG
BO_ 258 Exact: 8 LAW
 SG_ target : 0|64@1- (1,0) [0|0] "deg" RIG
BO_ 259 Guarded: 4 LAW
 SG_ torque : 0|16@1- (0.001,0) [0|0] "N.m" RIG
 SG_ count : 16|4@1+ (1,0) [0|15] "" RIG
 SG_ check : 24|8@1+ (1,0) [0|255] "" RIG
BO_ 260 Paged: 8 LAW
 SG_ page M : 0|8@1+ (1,0) [0|255] "" RIG
 SG_ first m0 : 8|16@1+ (1,0) [0|0] "" RIG
 SG_ second m1 : 8|16@1+ (1,0) [0|0] "" RIG
BO_ 261 Rare: 2 RIG
 SG_ slow : 0|16@1- (0.1,0) [0|0] "V" LAW
BO_ 262 Other: 1 RIG
 SG_ enable : 0|1@1+ (1,0) [0|1] "" LAW
BO_ 263 Wide: 10 RIG
 SG_ wide : 64|16@1- (0.001,0) [0|0] "rad" LAW
SIG_VALTYPE_ 258 target : 2;
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "CounterSignal" STRING;
BA_DEF_ BO_ "ChecksumSignal" STRING;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "CounterSignal" "";
BA_DEF_DEF_ "ChecksumSignal" "";
BA_ "GenMsgCycleTime" BO_ 256 1;
BA_ "GenMsgCycleTime" BO_ 257 10;
BA_ "GenMsgCycleTime" BO_ 259 10;
BA_ "CounterSignal" BO_ 259 "count";
BA_ "ChecksumSignal" BO_ 259 "check";
"""
BUS = BusSettings("virtual", "coupling")


def sample_database(folder: Path) -> Database:
    """Messages for a motor, with all that can be special about messages."""
    path = folder / "rig.dbc"
    path.write_text(DBC)
    return database.load(path)


def sample_system() -> System:
    """A rig whose inputs are driven from outside."""
    inputs = [
        ("voltage", "Real", "V", -30.0, 30.0),
        ("target", "Real", "rad", None, None),
        ("enable", "Boolean", None, None, None),
        ("gear", "Integer", None, 0.0, 5.0),
        ("label", "String", None, None, None),
        ("page", "Real", None, None, None),
    ]
    outputs = [
        ("angle", "Real", "rad"),
        ("speed", "Real", "rad/s"),
        ("torque", "Real", "N.m"),
        ("text", "String", None),
    ]
    ports = [Port(name, 0, kind, "input", unit, "0", low, high) for name, kind, unit, low, high in inputs]
    ports += [Port(name, 0, kind, "output", unit) for name, kind, unit in outputs]
    interface = Interface("rig", "2.0", {port.name: port for port in ports}, {name: None for name, _, _ in outputs})
    return wire({"rig": Part(interface)}, [], [f"rig.{name}" for name, *_ in inputs])


def frame(identifier: int, data: bytes) -> can.Message:
    return can.Message(arbitration_id=identifier, is_extended_id=False, data=data)


class ScriptedBus:
    """A bus on which a peer answers at once, in the very call that sends to it.

    Args:
        answer: what the peer sends when it receives a frame.

    Attributes:
        sent: all frames that were sent to the bus, in order.
        waiting: frames that are received next.
        failure: raised by the receiver as soon as it is set.
        refusing: raised by `send`.
        missing: how often it does not open.
        forgotten: how many frames had been sent each time that the adapter was told to forget them.
        stays: whether the adapter stays on the bus when it is left.
    """

    def __init__(self, answer: Callable[[can.Message], Sequence[can.Message]] = lambda frame: ()) -> None:
        self._answer = answer
        self.sent: list[can.Message] = []
        self.waiting: list[can.Message] = []
        self.failure: Exception | None = None
        self.refusing: Exception | None = None
        self.dropped = self.missing = 0
        self.forgotten: list[int] = []
        self.stays = False

    def send(self, frame: can.Message, timeout: float | None = None) -> None:
        if self.refusing is not None:
            raise self.refusing
        self.sent.append(frame)
        self.waiting += self._answer(frame)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if not self.waiting and self.failure is not None:
            raise self.failure
        return self.waiting.pop(0) if self.waiting else None

    def flush_tx_buffer(self) -> None:
        self.forgotten.append(len(self.sent))

    def shutdown(self) -> None:
        pass

    def identified(self, identifier: int) -> list[can.Message]:
        """The frames that were sent with this identifier."""
        return [frame for frame in self.sent if frame.arbitration_id == identifier]

    def linked(self, say: Callable[[str], None]) -> tuple[Link, _AtOnce]:
        """The bus as it is kept, and what receives from it."""
        link = Link(cast(can.BusABC, self), BUS, 0.1, say)
        return link, _AtOnce(link, self.dropped)

    def plug_in(self, monkeypatch: Any, punctual: bool = True) -> ScriptedBus:
        """Be the bus that is opened, and what receives from it; `punctual` steps begin at their deadlines at once."""
        if punctual:
            monkeypatch.setattr("orchestrator.realtime.pacing.Pace.wait", lambda pace, deadline, stop: deadline)
        monkeypatch.setattr("orchestrator.can.live.link.open_bus", self._opened)
        monkeypatch.setattr("orchestrator.bridge.bus.traffic.Receiver", self._receiver)
        return self

    def _opened(self, settings: BusSettings) -> ScriptedBus:
        if self.missing:
            self.missing -= 1
            raise BusError(settings.place, "does not open")
        return self

    @contextmanager
    def _receiver(self, link: Link, *_: object) -> Iterator[_AtOnce]:
        yield _AtOnce(link, self.dropped)


class _AtOnce:
    """Receives when it is asked, without a thread."""

    def __init__(self, link: Link, dropped: int) -> None:
        self._link, self.dropped, self.late = link, dropped, 0

    def take(self) -> list[can.Message]:
        taken = []
        with suppress(can.CanError):
            while (message := self._link.recv(0.0)) is not None:
                taken.append(message)
        return taken
