"""Which frames go from one bus to another, and under which identifier.

A message has one sender, on one side. One that comes from both sides is passed no more: there is a second sender, or
both buses are one wire, or a second gateway passes it, and frames would go round for ever.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import can

from fmus.errors import InputError
from orchestrator.can.database.bus import LogDatabase
from orchestrator.can.frames import from_messages
from orchestrator.can.sending.selection import MessageSelection, Selection, identifier
from orchestrator.can.slcan.flow import Key
from orchestrator.can.statistics import identifier_text

MOST = 1 << 14  # identifiers that are told apart; noise can hold half a billion
NOT_CHOSEN, AGAINST = "they are not chosen", "it is a one-way gateway"
RENAMED, BOTH = "its identifier is what another one gets", "it comes from both sides"
TOO_MANY = f"there are more than {MOST:,} identifiers"


@dataclass(frozen=True)
class Route:
    """What becomes of the frames with an identifier from one bus.

    Attributes:
        name: of the message as it is sent, or its identifier there.
        key: identifier on the other bus, None where they are not passed.
        why: they are not.
    """

    name: str
    key: Key | None
    why: str = ""


class Routes:
    """What goes from bus 0 to bus 1, and back.

    Args:
        chosen: messages by name or identifier, as they are on the bus from which they come.
        log: databases of the buses, for messages by name.
        channels: names of the buses.
        renamed: `OLD=NEW`, what is OLD on bus 0 and NEW on bus 1.
        one_way: whether nothing goes from bus 1 to bus 0.

    Raises:
        InputError: a name is that of no message and no identifier, or identifiers are renamed in two ways.
    """

    def __init__(
        self,
        chosen: MessageSelection,
        log: LogDatabase | None,
        channels: Mapping[int, str],
        renamed: Sequence[str] = (),
        one_way: bool = False,
    ) -> None:
        self._selection, self._one_way = Selection(chosen, log, channels), one_way
        self._log, self._channels = log, channels
        there = _renamed(renamed, log)
        self._renamed = there, {new: old for old, new in there.items()}
        self._known: dict[tuple[int, Key, bool], Route] = {}
        self._homes: dict[tuple[Key, bool], int] = {}  # identifier on bus 0, and whether of remote frames -> bus

    @property
    def missing(self) -> list[str]:
        """What is chosen by name and has not come."""
        return self._selection.missing

    def of(self, message: can.Message, bus: int) -> Route:
        """Where a frame of this bus, which is no error frame, goes."""
        known = bus, (message.arbitration_id, message.is_extended_id), message.is_remote_frame
        route = self._known.get(known)
        if route is None:
            if len(self._known) >= MOST:
                return Route("", None, TOO_MANY)
            route = self._known[known] = self._found(message, *known)
        return route

    def _found(self, message: can.Message, bus: int, key: Key, remote: bool) -> Route:
        there = self._renamed[bus].get(key, key)
        name = self._name(1 - bus, there)
        frames = from_messages([message])
        frames.channel[:] = bus
        if not len(self._selection.of(frames)):
            return Route(name, None, NOT_CHOSEN)
        if there == key and key in self._renamed[1 - bus]:
            return Route(name, None, RENAMED)
        if self._homes.setdefault((there if bus else key, remote), bus) == bus:
            return Route(name, None, AGAINST) if self._one_way and bus else Route(name, there)
        self._known[1 - bus, there, remote] = Route(self._name(bus, key), None, BOTH)
        return Route(name, None, BOTH)

    def _name(self, bus: int, key: Key) -> str:
        """Of the message with this identifier, where a database has it."""
        database = None if self._log is None else self._log.of(bus, self._channels[bus])
        messages = [] if database is None else database.messages
        found = (spec.name for spec in messages if (spec.id, spec.extended) == key)
        return next(found, identifier_text(*key))


def _renamed(texts: Sequence[str], log: LogDatabase | None) -> dict[Key, Key]:
    """Old -> new identifier."""
    found: dict[Key, Key] = {}
    for text in texts:
        place, (old, equals, new) = f"--map {text}", text.partition("=")
        if not (old and equals and new):
            raise InputError(place, "is not understood", "write OLD=NEW, as 0x100=0x200")
        before, after = _key(place, old, log), _key(place, new, log)
        if found.get(before, after) != after or (before not in found and after in found.values()):
            raise InputError(place, "renames to or from an identifier for the second time", "remove one of the two")
        found[before] = after
    return found


def _key(place: str, text: str, log: LogDatabase | None) -> Key:
    messages = [] if log is None else [spec for database in log.databases for spec in database.messages]
    named = next((spec for spec in messages if spec.name == text), None)
    if named is not None:
        return named.id, named.extended
    key = identifier(text)
    if key is None:
        problem = "names no identifier" + (", and there is no database" if log is None else " and no message")
        raise InputError(place, problem, "write 0x123, or 18FF0003, or the name of a message of --dbc")
    return key
