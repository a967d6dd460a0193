"""What goes out last, however a replay ends: messages with safe values in some signals, and whole frames."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import can
import cantools

from fmus.errors import DatabaseError, InputError
from orchestrator.can.codec.fields import check_sendable, outside
from orchestrator.can.codec.multiplexing import pages
from orchestrator.can.database.bus import LogDatabase
from orchestrator.can.database.message import MessageSpec, SignalSpec
from orchestrator.can.live.single_encoding import SingleEncoder
from orchestrator.can.statistics import FrameStatistics, identifier_text

_FRAME = re.compile(r"([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#((?:[0-9A-Fa-f]{2}){0,8})")
_VALUE = re.compile(r"([^=]*[^=\s])\s*=\s*(\S+)")


@dataclass(frozen=True)
class Last:
    """What is to go out last.

    Attributes:
        values: as `Command.torque=0`, in the signal's unit.
        frames: as `123#00FF`.
    """

    values: Sequence[str] = ()
    frames: Sequence[str] = ()


NOTHING = Last()


class SafeEnd:
    """The last frames: those of messages follow the ones that were sent of them, counters and other signals alike.

    Raises:
        InputError: something is not understood, or a value does not fit its signal.
        DatabaseError: there is no such signal, or its message cannot be sent.
    """

    def __init__(self, last: Last, log: LogDatabase | None) -> None:
        self._frames = [_frame(text) for text in last.frames]
        self._values: dict[MessageSpec, list[tuple[SignalSpec, float]]] = {}
        for text in last.values:
            message, signal, value = _value(text, log)
            self._values.setdefault(message, []).append((signal, value))
        self._by_key = {(message.id, message.extended): message for message in self._values}
        self._latest: dict[MessageSpec, tuple[int, bytes, bool]] = {}

    def note(self, message: can.Message, bus: int) -> None:
        """A frame has been sent on the bus of this number."""
        spec = self._by_key.get((message.arbitration_id, message.is_extended_id))
        if spec is not None and not message.is_remote_frame and len(message.data) >= spec.length:
            self._latest[spec] = bus, bytes(message.data), message.bitrate_switch

    def frames(self, buses: int) -> list[tuple[int, can.Message]]:
        """Number of the bus, frame: messages where they were sent, or on the first bus; whole frames on all of them."""
        found = [sent for spec in self._values for sent in self._safe(spec)]
        return found + [(bus, frame) for frame in self._frames for bus in range(buses)]

    def _safe(self, spec: MessageSpec) -> list[tuple[int, can.Message]]:
        bus, data, switched = self._latest.get(spec, (0, b"", False))
        encoder, values = SingleEncoder(spec, FrameStatistics(), switched), self._values[spec]
        if data:
            with suppress(cantools.database.DecodeError):  # of a page that there is not
                encoder.resume(data)
        for signal, value in values:
            encoder.set(signal, value)
        frames = []
        for page in pages(spec, [signal.name for signal, _ in values]):
            encoder.turn_to(page)
            frames.append(encoder.frame())
        return [(bus, frame) for frame in frames if frame is not None]


def frame_text(message: can.Message) -> str:
    """A frame as it can be given to go out last, `123#00FF`."""
    return f"{identifier_text(message.arbitration_id, message.is_extended_id)}#{message.data.hex().upper()}"


def _frame(text: str) -> can.Message:
    match = _FRAME.fullmatch(text)
    if match is None or int(match[1], 16) >= 1 << (11 if len(match[1]) == 3 else 29):
        raise InputError(f"--end-with {text}", "is no frame", "write it as 123#00FF or 18FF0003#00FF")
    extended = len(match[1]) == 8
    return can.Message(arbitration_id=int(match[1], 16), is_extended_id=extended, data=bytes.fromhex(match[2]))


def _value(text: str, log: LogDatabase | None) -> tuple[MessageSpec, SignalSpec, float]:
    place, match = f"--safe {text}", _VALUE.fullmatch(text.strip())
    try:
        value = float(match[2]) if match else math.nan
    except ValueError:
        value = math.nan
    if match is None or math.isnan(value):
        raise InputError(place, "is not understood", "write SIGNAL=NUMBER")
    if log is None:
        raise InputError(place, "is of a signal, and there is no database", "give --dbc")
    message, signal = _signal(match[1], log)
    check_sendable(message)
    if message.of_any_sender:
        raise InputError(place, f"no frame has the identifier of {message.name}: it lacks the sender", "use --end-with")
    if limits := outside(signal, value):
        raise InputError(place, f"does not fit: {limits}", "choose a value inside")
    return message, signal, value


def _signal(name: str, log: LogDatabase) -> tuple[MessageSpec, SignalSpec]:
    problem: DatabaseError | None = None
    for database in log.databases:
        try:
            return database.signal(name)
        except DatabaseError as error:
            problem = problem or error
    assert problem is not None
    raise problem
