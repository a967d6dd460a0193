"""Received frames on their way to the inputs of components.

A frame that cannot be trusted (too short, a wrong checksum, a counter that stands still) changes nothing, nor does a
value that is not finite, or one outside its range where it is rejected. All are counted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import can

from orchestrator.bridge.signals.location import MessageLocation
from orchestrator.can.codec.single_decoding import SingleDecoder
from orchestrator.can.database.database import Database
from orchestrator.can.database.message import MessageSpec
from orchestrator.can.statistics import FrameStatistics, joined
from orchestrator.crossing import Crossing
from orchestrator.trace import FloatArray

Key = tuple[int, int, bool]  # number of the bus, identifier, and whether it is an extended one


@dataclass(frozen=True, eq=False)
class ReceivedSignal:
    """How an input takes a signal.

    Attributes:
        name: its public name.
        input: component.input.
        place: its number among the inputs.
        crossing: from the signal's unit to the input's.
        safe: value while no good one comes [unit of the input].
        low, high: its range; `rejects` values outside, or else limits them [unit of the input].
    """

    name: str
    input: str
    place: int
    crossing: Crossing
    safe: float
    low: float = -math.inf
    high: float = math.inf
    rejects: bool = False


@dataclass(frozen=True)
class ReceivedMessage:
    """A message that is received.

    Attributes:
        silence: how long no good value may come [s].
    """

    place: MessageLocation
    signals: tuple[ReceivedSignal, ...]
    silence: float

    @property
    def spec(self) -> MessageSpec:
        """What it is in its database."""
        return self.place.message

    @property
    def name(self) -> str:
        """What it is called."""
        return self.place.name

    @property
    def key(self) -> Key:
        """What its frames are known by."""
        return self.place.number, self.spec.id, self.spec.extended


@dataclass(frozen=True)
class TakenFrame:
    """What came of a frame: the signals that gave their inputs a good value, and those that did not -> why."""

    message: ReceivedMessage
    good: tuple[ReceivedSignal, ...]
    faults: dict[ReceivedSignal, str]


class Reception:
    """All messages that are received.

    Args:
        databases: of each bus.
    """

    def __init__(self, databases: Sequence[Database], messages: Sequence[ReceivedMessage]) -> None:
        self.messages = tuple(messages)
        self._by_key = {message.key: message for message in messages}
        self._decoders = [
            SingleDecoder(_timeless(database), _names(messages, number)) for number, database in enumerate(databases)
        ]

    @property
    def statistics(self) -> FrameStatistics:
        """Of all frames so far; names have those of their channels where there are several."""
        found = [decoder.statistics for decoder in self._decoders]
        return found[0] if len(found) == 1 else joined({f"can{n}.": own for n, own in enumerate(found)})

    def take(self, frame: can.Message, inputs: FloatArray, bus: int = 0) -> TakenFrame | None:
        """Give the good values of a bus' frame to the inputs; None where it is of no message that is received."""
        decoder = self._decoders[bus]
        values = decoder.decode(frame)
        message = self._by_key.get((bus, frame.arbitration_id, frame.is_extended_id))
        if message is None or frame.is_error_frame or frame.is_remote_frame:
            return None
        if values is None or decoder.fault:
            return TakenFrame(message, (), dict.fromkeys(message.signals, decoder.fault))
        good, faults = [], {}
        for signal in message.signals:
            if signal.name not in values:
                if signal.name in decoder.not_finite:
                    faults[signal] = "not finite"
                continue
            value = signal.crossing.conversion(values[signal.name])
            within = min(max(value, signal.low), signal.high)
            if signal.rejects and within != value:
                faults[signal] = f"{value:g} is out of range"
                continue
            inputs[signal.place] = within
            good.append(signal)
        return TakenFrame(message, tuple(good), faults)


def _names(messages: Sequence[ReceivedMessage], bus: int) -> list[str]:
    return [signal.name for message in messages if message.place.number == bus for signal in message.signals]


def _timeless(database: Database) -> Database:
    """Without cycle times: on a live bus frames bunch, and only counters tell of those that are missing."""
    return database.changed(replace(message, cycle=None) for message in database.messages)
