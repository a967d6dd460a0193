"""Which message of a log's databases a frame is, many at once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orchestrator.can.codec.streams import channel_name
from orchestrator.can.database.addressing import ANY
from orchestrator.can.database.bus import LogDatabase
from orchestrator.can.database.database import Database
from orchestrator.can.database.message import MessageSpec
from orchestrator.can.frames import Flag, Frames

STANDARD = 1 << 11  # standard identifiers
EVERY = 0xFFFFFFFF  # bit of an identifier

Numbers = NDArray[np.signedinteger[Any]]


@dataclass(frozen=True, eq=False)
class Sorted:
    """Numbers of messages by the masked bits of extended identifiers, ascending and ended by a guard."""

    mask: int
    identifiers: NDArray[np.uint32]
    numbers: Numbers

    def of(self, identifiers: NDArray[np.uint32]) -> Numbers:
        """(K,) the number of each message; -1 for none."""
        bits = identifiers & np.uint32(self.mask)
        places = np.searchsorted(self.identifiers, bits)
        return np.where(self.identifiers[places] == bits, self.numbers[places], -1).astype(self.numbers.dtype)


@dataclass(frozen=True, eq=False)
class RoutingTable:
    """Numbers of messages by identifier: of standard ones, and of extended ones, the most exact first."""

    standard: Numbers
    extended: tuple[Sorted, ...]

    def numbers(self, frames: Frames) -> Numbers:
        """(K,) the number of each frame's message; -1 for none."""
        extended = frames.has(Flag.EXTENDED)
        numbers = self.standard[np.minimum(frames.id, STANDARD)]
        if extended.any():
            identifiers = frames.id[extended]
            found = self.extended[0].of(identifiers)
            for less_exact in self.extended[1:]:
                found = np.where(found < 0, less_exact.of(identifiers), found)
            numbers[extended] = found
        return numbers


class Router:
    """Finds the message of each frame by its identifier and channel.

    Attributes:
        messages: of all databases, by their number.
        owners: the databases that they are of.
        met: channels with a database of their own of which there were frames.
    """

    def __init__(self, log: LogDatabase, channels: Mapping[int, str]) -> None:
        self._log, self._channels = log, channels
        self.messages: list[MessageSpec] = []
        self.owners: list[Database] = []
        self.met: set[str] = set()
        count = sum(len(database.messages) for database in log.databases)
        # NumPy sorts short ones faster.
        self._kind: type[np.signedinteger[Any]] = np.int16 if count < np.iinfo(np.int16).max else np.int32
        self._tables: dict[int, RoutingTable] = {}
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
            name = channel_name(channel, self._channels)
            database = self._log.of(channel, name)
            self.met |= {name, str(channel)}
            numbers[rows] = self._of_channel(frames[rows], database)
        return numbers

    def _of_channel(self, frames: Frames, database: Database | None) -> Numbers:
        if database is None:
            return np.full(len(frames), -1, dtype=self._kind)
        return self._tables[id(database)].numbers(frames)

    def _table(self, messages: Sequence[MessageSpec]) -> RoutingTable:
        numbered = list(enumerate(messages, len(self.messages)))
        standard: Numbers = np.full(STANDARD + 1, -1, dtype=self._kind)
        for number, message in numbered:
            if not message.extended and message.addressing:
                standard[message.id : message.id + message.addressing.sender + 1] = number
        for number, message in numbered:
            if not message.extended:
                standard[message.id] = number
        extended = [(number, message) for number, message in numbered if message.extended]
        return RoutingTable(standard, tuple(self._sorted(mask, found) for mask, found in _matches(extended).items()))

    def _sorted(self, mask: int, found: Mapping[int, int]) -> Sorted:
        identifiers, numbers = zip(*sorted(found.items()), (np.iinfo(np.uint32).max, -1), strict=True)
        return Sorted(mask, np.array(identifiers, dtype=np.uint32), np.array(numbers, dtype=self._kind))


def _matches(messages: Sequence[tuple[int, MessageSpec]]) -> dict[int, dict[int, int]]:
    """Mask, the most exact first -> masked identifier -> number of the message.

    A message that comes from any sender, or is the only one of its group, is found by its group alone.
    """
    found: dict[int, dict[int, int]] = {EVERY: {message.id: number for number, message in messages}}
    groups: dict[tuple[int, int], dict[int, int]] = {}  # mask and group -> sender -> number
    for number, message in messages:
        if (addressing := message.addressing) is not None:
            exact = addressing.mask | addressing.sender
            found.setdefault(exact, {}).setdefault(message.id & exact, number)
            senders = groups.setdefault((addressing.mask, message.id & addressing.mask), {})
            senders.setdefault(message.id & addressing.sender, number)
    for (mask, group), senders in groups.items():
        number = senders.get(ANY, next(iter(senders.values())) if len(senders) == 1 else -1)
        found.setdefault(mask, {})[group] = number
    return found


class Group(NamedTuple):
    """Frames of one message from one sender over one channel: number of the message, and which of the frames."""

    number: int
    channel: int
    sender: int
    rows: slice | NDArray[np.intp]


def groups(frames: Frames, begins: Sequence[int], messages: Sequence[MessageSpec]) -> Iterator[Group]:
    """The frames, which are in the order of their messages' numbers, by origin.

    Args:
        begins: where the frames of each message begin, and where the last end.
    """
    for number, (begin, end) in enumerate(pairwise(begins)):
        if begin == end:
            continue
        addressing = messages[number].addressing
        mask = 0 if addressing is None else addressing.sender
        origin: NDArray[Any] = frames.channel[begin:end]
        if mask:
            origin = origin.astype(np.int64) | (frames.id[begin:end] & np.int64(mask)) << 8
        if origin.min() == origin.max():
            yield Group(number, int(origin[0]) & 0xFF, int(origin[0]) >> 8, slice(begin, end))
            continue
        for own in np.unique(origin).tolist():
            yield Group(number, own & 0xFF, own >> 8, np.flatnonzero(origin == own) + begin)
