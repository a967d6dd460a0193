"""Which message of a log's databases a frame is, many at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.can.codec.streams import channel_name
from orchestrator.can.database.bus import LogDatabase
from orchestrator.can.database.database import Database
from orchestrator.can.database.message import MessageSpec
from orchestrator.can.frames import Flag, Frames

STANDARD = 1 << 11  # standard identifiers

Numbers = NDArray[np.signedinteger[Any]]


@dataclass(frozen=True, eq=False)
class Table:
    """Numbers of messages by identifier: of standard ones, and of extended ones, ascending and ended by a guard."""

    standard: Numbers
    extended: NDArray[np.uint32]
    extended_numbers: Numbers

    def numbers(self, frames: Frames) -> Numbers:
        """(K,) the number of each frame's message; -1 for none."""
        extended = frames.has(Flag.EXTENDED)
        numbers = self.standard[np.minimum(frames.id, STANDARD)]
        if extended.any():
            identifiers = frames.id[extended]
            places = np.searchsorted(self.extended, identifiers)
            found = self.extended[places] == identifiers
            numbers[extended] = np.where(found, self.extended_numbers[places], -1)
        return numbers


class Router:
    """Finds the message of each frame by its identifier and channel.

    Attributes:
        messages: of all databases, by their number.
        owners: the databases that they are of.
    """

    def __init__(self, log: LogDatabase, channels: Mapping[int, str]) -> None:
        self._log, self._channels = log, channels
        self.messages: list[MessageSpec] = []
        self.owners: list[Database] = []
        count = sum(len(database.messages) for database in log.databases)
        # NumPy sorts short ones faster.
        self._kind: type[np.signedinteger[Any]] = np.int16 if count < np.iinfo(np.int16).max else np.int32
        self._tables: dict[int, Table] = {}
        for database in log.databases:
            self._tables[id(database)] = self._table(database.messages)
            self.messages += database.messages
            self.owners += [database] * len(database.messages)

    def numbers(self, frames: Frames) -> Numbers:
        """(K,) the number of each frame's message; -1 for none."""
        if not self._log.own:
            return self._of_channel(frames, self._log.everywhere)
        numbers: Numbers = np.full(len(frames), -1, dtype=self._kind)
        for channel in np.flatnonzero(np.bincount(frames.channel)).tolist():
            rows = frames.channel == channel
            database = self._log.of(channel, channel_name(channel, self._channels))
            numbers[rows] = self._of_channel(frames[rows], database)
        return numbers

    def _of_channel(self, frames: Frames, database: Database | None) -> Numbers:
        if database is None:
            return np.full(len(frames), -1, dtype=self._kind)
        return self._tables[id(database)].numbers(frames)

    def _table(self, messages: Sequence[MessageSpec]) -> Table:
        standard: Numbers = np.full(STANDARD + 1, -1, dtype=self._kind)
        pairs = []
        for number, message in enumerate(messages, len(self.messages)):
            if message.extended:
                pairs.append((message.id, number))
            else:
                standard[message.id] = number
        identifiers, numbers = zip(*sorted(pairs), (np.iinfo(np.uint32).max, -1), strict=True)
        return Table(standard, np.array(identifiers, dtype=np.uint32), np.array(numbers, dtype=self._kind))
