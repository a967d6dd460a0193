"""The text log of Kvaser's CanKing: a line a frame as its output window shows it, stamps from the start.

CanKing shows numbers hexadecimal or decimal, as it is set, and does not say which: hexadecimal ones are padded with
zeros, to eight digits of an identifier and two of a byte. Only these are read.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orchestrator.can.frames import CLASSIC, Flag
from orchestrator.can.logs.text.form import HeaderState, LogReading, TextFormat
from orchestrator.can.logs.text.lines import TextLines
from orchestrator.can.logs.text.rows import (
    FoundRows,
    LogRow,
    NoFrameError,
    checked,
    data_row,
    found,
    octets,
    shown,
    stamp,
    whole,
    word,
)

HEAD = "chn"  # the first word of the line with the names of the columns
LETTERS = {"x": Flag.EXTENDED, "r": Flag.REMOTE, "f": Flag.FD, "b": Flag.BITRATE_SWITCH, "e": Flag.ERROR_STATE}
DIRECTIONS = {"r": 0, "t": Flag.SENT}
PADDED, STRIDE = 8, 4  # digits of an identifier; octets from one byte to the next


def _state(lines: Sequence[str], reading: LogReading) -> HeaderState:
    return HeaderState()


def _header(line: str, state: HeaderState, reading: LogReading) -> HeaderState | None:
    return state if line.lower().startswith(HEAD) else None


def _one(line: str, state: HeaderState, reading: LogReading) -> LogRow | None:
    words = line.split()
    if len(words) < 4:
        raise NoFrameError("ends before its direction")
    time, direction = stamp(words[-2]), words[-1].lower()
    if direction not in DIRECTIONS:
        raise NoFrameError(f"'{shown(words[-1])}' is neither R nor T")
    channel, name = whole(words[0], 10, "channel"), words[1]
    if name.lower() == "errorframe":
        return checked(LogRow(time, 0, Flag.ERROR | Flag.EXTENDED | DIRECTIONS[direction], channel))
    flags, rest = DIRECTIONS[direction], words[2:-2]
    if rest and rest[0].isalpha():
        flags |= _flags(rest.pop(0))
    length, data = whole(word(rest, 0, "length"), 10, "length"), rest[1:]
    if len(name) != PADDED or any(len(text) != 2 for text in data):
        raise NoFrameError("its numbers are not padded as hexadecimal ones are; set CanKing to these and log again")
    identifier = whole(name, 16, "identifier")
    if flags & Flag.REMOTE:
        return checked(LogRow(time, identifier, flags, channel, length))
    return data_row(time, identifier, flags, channel, length, octets(data))


def _flags(letters: str) -> int:
    unknown = next((letter for letter in letters.lower() if letter not in LETTERS), "")
    if unknown:
        raise NoFrameError(f"'{shown(letters)}' are no flags that are known")
    return int(sum({letter: LETTERS[letter] for letter in letters.lower()}.values()))


def _many(lines: TextLines, state: HeaderState, reading: LogReading) -> FoundRows:
    words = lines.words
    channel, numbered = lines.whole_numbers(words[0], 10, 3)
    identifier, named = lines.whole_numbers(words[1], 16, PADDED)
    extended = lines.equal(words[2], "x")
    length_word = np.where(extended, 3, 2)
    length, told = lines.whole_numbers(words[length_word], 10, 2)
    length = np.where(told, length, 255)
    data = lines.octet_digits(words[length_word + 1].begin, length, STRIDE, CLASSIC)
    behind = length_word + 1 + length
    time, timed = lines.decimals(words[behind])
    sent = lines.equal(words[behind + 1], "t")
    right = numbered & named & told & (words[1].length == PADDED) & (words.count == behind + 2)
    right &= sent | lines.equal(words[behind + 1], "r")
    flags = extended * Flag.EXTENDED | sent * Flag.SENT
    return found((time, timed), identifier, flags, channel, length, data, right)


KVASER = TextFormat(_state, b"0123456789", _header, _one, _many)
