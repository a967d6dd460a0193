"""Which frames of a log go onto a bus: all, those of some messages, or all but those."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fmus.errors import DatabaseError, InputError
from orchestrator.can.codec.routing import Router
from orchestrator.can.database.bus import LogDatabase
from orchestrator.can.frames import Flag, Frames
from orchestrator.trace import BoolArray

_IDENTIFIER = re.compile(r"0[xX]([0-9A-Fa-f]{1,8})|([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})")
_LARGEST, _STANDARD = (1 << 29) - 1, (1 << 11) - 1


@dataclass(frozen=True)
class MessageSelection:
    """What is chosen by name.

    Attributes:
        only: messages by name, or identifiers as `123`, `0x123` or `18FF0003`; of none all.
        without: the same, of what is left out.
    """

    only: Sequence[str] = ()
    without: Sequence[str] = ()


EVERYTHING = MessageSelection()


@dataclass
class Selection:
    """Takes the chosen frames; error frames are left to the caller.

    Attributes:
        left_out: frames so far that are not chosen; taken: those that are.
        met: names of which there was a frame.

    Raises:
        InputError: a name is that of no message, and no identifier.
    """

    chosen: MessageSelection
    log: LogDatabase | None
    channels: Mapping[int, str]
    left_out: int = 0
    taken: int = 0
    met: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self._router = None if self.log is None else Router(self.log, self.channels)
        names = [*self.chosen.only, *self.chosen.without]
        self._messages = {name: self._numbers(name) for name in names}
        keys = {name: identifier(name) for name in names if not self._messages[name]}
        self._identifiers = {name: key for name, key in keys.items() if key is not None}

    @property
    def missing(self) -> list[str]:
        """Names of which there was no frame."""
        return [name for name in self._messages if name not in self.met]

    def of(self, frames: Frames) -> Frames:
        """Those of the frames that are chosen."""
        if not self._messages:
            return frames
        numbers = None if self._router is None else self._router.numbers(frames)
        rows = np.full(len(frames), not self.chosen.only)
        for name in self.chosen.only:
            rows |= self._rows(name, frames, numbers)
        for name in self.chosen.without:
            rows &= ~self._rows(name, frames, numbers)
        rows &= ~frames.has(Flag.ERROR)
        self.taken += int(np.count_nonzero(rows))
        rows |= frames.has(Flag.ERROR)
        self.left_out += int(np.count_nonzero(~rows))
        return frames[rows]

    def _rows(self, name: str, frames: Frames, numbers: object) -> BoolArray:
        if name in self._identifiers:
            number, extended = self._identifiers[name]
            rows = (frames.id == number) & (frames.has(Flag.EXTENDED) == extended)
        else:
            rows = np.isin(np.asarray(numbers), self._messages[name])
        rows &= ~frames.has(Flag.ERROR)
        self.met |= {name} if rows.any() else set()
        return np.asarray(rows, np.bool_)

    def _numbers(self, name: str) -> list[int]:
        """The router's numbers of the messages of that name."""
        messages = [] if self._router is None else self._router.messages
        found = [number for number, message in enumerate(messages) if message.name == name]
        if not found and _IDENTIFIER.fullmatch(name) is None:
            if self.log is None:
                raise InputError(name, "is no identifier, and there is no database", "give --dbc, or 0x123")
            self.log.message(name)  # says what there is
            raise DatabaseError(name, "is no message that is used", "see the notes of the database")
        return found


def identifier(name: str) -> tuple[int, bool] | None:
    """The identifier, and whether it is an extended one: of more than three digits, or too large for a standard one;
    None where it is a name.

    Raises:
        InputError: it is larger than any.
    """
    match = _IDENTIFIER.fullmatch(name)
    if match is None:
        return None
    value, digits = int(match[1] or match[2], 16), len(match[1] or match[2])
    if value > _LARGEST:
        raise InputError(name, "is larger than an identifier can be", "give at most 1FFFFFFF")
    return value, digits > 3 or value > _STANDARD
