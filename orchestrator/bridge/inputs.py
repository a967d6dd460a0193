"""Received frames on their way to the inputs of components.

A frame that cannot be trusted (too short, a wrong checksum) changes nothing, a value that is not finite leaves the
last one; both are counted.
"""

from __future__ import annotations

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


@dataclass(frozen=True)
class ReceivedSignal:
    """How an input takes a signal.

    Attributes:
        name: its public name.
        input: component.input.
        place: its number among the inputs.
        crossing: from the signal's unit to the input's.
        safe: value while no frame comes [unit of the input].
    """

    name: str
    input: str
    place: int
    crossing: Crossing
    safe: float


@dataclass(frozen=True)
class ReceivedMessage:
    """A message that is received.

    Attributes:
        silence: how long no frame may come [s].
    """

    spec: MessageSpec
    signals: tuple[ReceivedSignal, ...]
    silence: float

    @property
    def key(self) -> Key:
        """What its frames are known by."""
        return self.spec.id, self.spec.extended

    def give_safe_values(self, inputs: FloatArray) -> None:
        """Give the inputs their safe values."""
        for signal in self.signals:
            inputs[signal.place] = signal.safe


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

    def take(self, frame: can.Message, inputs: FloatArray) -> ReceivedMessage | None:
        """Give a frame's values to the inputs; its message, None where no input got any."""
        message = self._by_key.get((frame.arbitration_id, frame.is_extended_id))
        wrong = None if message is None else self.statistics.checksums[message.spec.name]
        values = self._decoder.decode(frame)
        if message is None or not values or self.statistics.checksums[message.spec.name] != wrong:
            return None
        for signal in message.signals:
            value = values.get(signal.name)
            if value is not None:
                inputs[signal.place] = signal.crossing.conversion(value)
        return message


def _timeless(database: Database) -> Database:
    """Without cycle times: on a live bus frames bunch, and only counters tell of those that are missing."""
    return database.changed(replace(message, cycle=None) for message in database.messages)
