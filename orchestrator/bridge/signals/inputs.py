"""Received frames on their way to the inputs of components.

A frame that cannot be trusted (too short, a wrong checksum, a counter that stands still) changes nothing, nor does a
value that is not finite, or one outside its range where it is rejected. All are counted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import can

from orchestrator.can.codec.single_decoding import SingleDecoder
from orchestrator.can.database.database import Database
from orchestrator.can.database.message import MessageSpec
from orchestrator.can.statistics import FrameStatistics
from orchestrator.crossing import Crossing
from orchestrator.trace import FloatArray

Key = tuple[int, bool]  # identifier, and whether it is an extended one


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

    spec: MessageSpec
    signals: tuple[ReceivedSignal, ...]
    silence: float

    @property
    def key(self) -> Key:
        """What its frames are known by."""
        return self.spec.id, self.spec.extended


@dataclass(frozen=True)
class Taken:
    """What came of a frame: the signals that gave their inputs a good value, and those that did not -> why."""

    message: ReceivedMessage
    good: tuple[ReceivedSignal, ...]
    faults: dict[ReceivedSignal, str]


class Reception:
    """All messages that are received.

    Attributes:
        statistics: of all frames so far.
    """

    def __init__(self, database: Database, messages: Sequence[ReceivedMessage]) -> None:
        self.messages = tuple(messages)
        self._by_key = {message.key: message for message in messages}
        names = [signal.name for message in messages for signal in message.signals]
        self._decoder = SingleDecoder(_timeless(database), names)

    @property
    def statistics(self) -> FrameStatistics:
        return self._decoder.statistics

    def take(self, frame: can.Message, inputs: FloatArray) -> Taken | None:
        """Give a frame's good values to the inputs; None where it is of no message that is received."""
        values = self._decoder.decode(frame)
        message = self._by_key.get((frame.arbitration_id, frame.is_extended_id))
        if message is None or frame.is_error_frame or frame.is_remote_frame:
            return None
        if values is None or self._decoder.fault:
            return Taken(message, (), dict.fromkeys(message.signals, self._decoder.fault))
        good, faults = [], {}
        for signal in message.signals:
            if signal.name not in values:
                if signal.name in self._decoder.not_finite:
                    faults[signal] = "not finite"
                continue
            value = signal.crossing.conversion(values[signal.name])
            within = min(max(value, signal.low), signal.high)
            if signal.rejects and within != value:
                faults[signal] = f"{value:g} is out of range"
                continue
            inputs[signal.place] = within
            good.append(signal)
        return Taken(message, tuple(good), faults)


def _timeless(database: Database) -> Database:
    """Without cycle times: on a live bus frames bunch, and only counters tell of those that are missing."""
    return database.changed(replace(message, cycle=None) for message in database.messages)
