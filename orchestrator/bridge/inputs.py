"""Received frames on their way to the inputs of components.

A frame that cannot be trusted (too short, a wrong checksum) changes nothing, a value that is not finite leaves the
last one; both are counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import can

from orchestrator.can.census import Census
from orchestrator.can.codec.single_decoding import SingleDecoder
from orchestrator.can.database.database import Database, MessageSpec
from orchestrator.trace import FloatArray

Key = tuple[int, bool]  # identifier, and whether it is an extended one


@dataclass(frozen=True)
class Intake:
    """How an input takes a signal.

    Attributes:
        signal: its public name.
        input: component.input.
        place: its number among the inputs.
        factor: from the signal's unit to the input's.
        safe: value while no frame comes [unit of the input].
    """

    signal: str
    input: str
    place: int
    factor: float
    safe: float


@dataclass(frozen=True)
class Inlet:
    """A message that is received.

    Attributes:
        silence: how long no frame may come [s].
    """

    message: MessageSpec
    intakes: tuple[Intake, ...]
    silence: float

    @property
    def key(self) -> Key:
        """What its frames are known by."""
        return self.message.id, self.message.extended

    def rest(self, given: FloatArray) -> None:
        """Give the inputs their safe values."""
        for each in self.intakes:
            given[each.place] = each.safe


class Inward:
    """What is received.

    Attributes:
        census: what was found in all frames so far.
    """

    def __init__(self, database: Database, inlets: Sequence[Inlet]) -> None:
        self.inlets = tuple(inlets)
        self._by_key = {each.key: each for each in inlets}
        self._decoder = SingleDecoder(
            _timeless(database), [intake.signal for each in inlets for intake in each.intakes]
        )

    @property
    def census(self) -> Census:
        return self._decoder.census

    def take(self, frame: can.Message, given: FloatArray) -> Inlet | None:
        """Give a frame's values to the inputs; its message, None where no input got any."""
        inlet = self._by_key.get((frame.arbitration_id, frame.is_extended_id))
        wrong = None if inlet is None else self.census.checksums[inlet.message.name]
        values = self._decoder.decode(frame)
        if inlet is None or not values or self.census.checksums[inlet.message.name] != wrong:
            return None
        for each in inlet.intakes:
            value = values.get(each.signal)
            if value is not None:
                given[each.place] = each.factor * value
        return inlet


def _timeless(database: Database) -> Database:
    """Without cycle times: on a live bus frames bunch, and only counters tell of those that are missing."""
    return Database(database.path, [replace(each, cycle=None) for each in database.messages])
