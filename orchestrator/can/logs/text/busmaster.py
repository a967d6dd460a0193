"""BusMaster's .log: stamps are times of the day, or count from the start or from the line before."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.can.frames import CLASSIC, Flag
from orchestrator.can.logs.text.dates import moment
from orchestrator.can.logs.text.form import HeaderState, LogReading, TextFormat
from orchestrator.can.logs.text.lines import TextField, TextLines
from orchestrator.can.logs.text.rows import (
    DIRECTIONS,
    FoundRows,
    LogRow,
    NoFrameError,
    checked,
    data_row,
    found,
    octets,
    stamp,
    whole,
    word,
)
from orchestrator.trace import BoolArray, FloatArray

BEGUN = re.compile(r"\*+\s*START DATE AND TIME\s+(.*?)\s*\*+$", re.IGNORECASE)
MODE = re.compile(r"\*+\s*(HEX|DEC|SYSTEM MODE|ABSOLUTE MODE|RELATIVE MODE)\s*\*+$", re.IGNORECASE)
DAY = 86400.0


@dataclass(frozen=True)
class BusmasterState(HeaderState):
    """The base of its numbers, and whether stamps are times of the day."""

    base: int = 16
    day: bool = True

    @property
    def origin(self) -> float:
        return self.start - self.start % DAY if self.day else self.start


def _state(lines: Sequence[str], reading: LogReading) -> BusmasterState:
    return BusmasterState()


def _header(line: str, state: BusmasterState, reading: LogReading) -> BusmasterState | None:
    if begun := BEGUN.match(line):
        begin = moment(begun[1])
        if begin is None:
            raise NoFrameError("this date is not understood, the time of the beginning is not known")
        reading.findings.zoneless = True
        return replace(state, start=begin.time)
    mode = MODE.match(line)
    if mode is None:
        return state if line.startswith("*") else None
    name = mode[1].upper()
    if name in ("HEX", "DEC"):
        return replace(state, base=16 if name == "HEX" else 10)
    if name.startswith("RELATIVE"):
        reading.findings.note("stamps count from the line before and were added up")
    return replace(state, day=name.startswith("SYSTEM"), relative=name.startswith("RELATIVE"))


def _one(line: str, state: BusmasterState, reading: LogReading) -> LogRow | None:
    words = line.split()
    time = clock(words[0])
    direction, kind = word(words, 1, "direction").lower(), word(words, 4, "type").lower()
    if direction not in DIRECTIONS:
        raise NoFrameError(f"'{direction}' is neither Rx nor Tx")
    channel = whole(word(words, 2, "channel"), 10, "channel") - 1
    identifier = whole(word(words, 3, "identifier").lower().removeprefix("0x"), state.base, "identifier")
    flags = Flag.SENT * (direction == "tx") | Flag.EXTENDED * ("x" in kind)
    length = whole(word(words, 5, "length"), 10, "length")
    if "r" in kind:
        return checked(LogRow(time, identifier, flags | Flag.REMOTE, channel, length))
    if not re.fullmatch(r"[sx](-?fd)?", kind):
        raise NoFrameError(f"'{kind}' is neither s nor x, with r or fd")
    flags |= Flag.FD * ("fd" in kind or length > CLASSIC)
    return data_row(time, identifier, flags, channel, length, octets(words[6 : 6 + length], state.base))


def clock(text: str) -> float:
    """Seconds of `hours:minutes:seconds:fraction`."""
    parts = text.split(":")
    if len(parts) != 4:
        raise NoFrameError(f"'{text[:24]}' is no time stamp")
    hours, minutes, seconds = (whole(part, 10, "time stamp") for part in parts[:3])
    return 3600.0 * hours + 60.0 * minutes + stamp(f"{seconds}.{whole(parts[3], 10, 'time stamp'):0{len(parts[3])}d}")


def _many(lines: TextLines, state: BusmasterState, reading: LogReading) -> FoundRows:
    words = lines.words
    time, timed = _clocks(lines, words[0])
    sent, extended = lines.equal(words[1], "tx"), lines.equal(words[4], "x")
    channel, numbered = lines.whole_numbers(words[2], 10, 3)
    name = words[3]
    prefixed = lines.equal(TextField(name.begin, np.minimum(name.begin + 2, name.end)), "0x")
    identifier, named = lines.whole_numbers(name.without(2 * prefixed), state.base, 8 if state.base == 16 else 10)
    length, told = lines.whole_numbers(words[5], 10, 2)
    length = np.where(told, length, 255)
    data = lines.octet_words(6, length, state.base, CLASSIC)
    right = numbered & named & told & (sent | lines.equal(words[1], "rx")) & (extended | lines.equal(words[4], "s"))
    flags = extended * Flag.EXTENDED | sent * Flag.SENT
    return found((time, timed), identifier, flags, channel - 1, length, data, right)


def _clocks(lines: TextLines, field: TextField) -> tuple[FloatArray, BoolArray]:
    """Seconds of stamps as the tool writes them, in tenths of milliseconds."""
    colons = [lines.octets[field.end - place] == ord(":") for place in (5, 8, 11)]
    parts = [
        lines.whole_numbers(TextField(begin, end), 10, most)
        for begin, end, most in (
            (field.begin, field.end - 11, 4),
            (field.end - 10, field.end - 8, 2),
            (field.end - 7, field.end - 5, 2),
            (field.end - 4, field.end, 4),
        )
    ]
    hours, minutes, seconds, fractions = (value for value, _ in parts)
    sound = np.all([*colons, *(right for _, right in parts)], axis=0)
    return (((hours * 60 + minutes) * 60 + seconds) * 10_000 + fractions) / 1e4, sound


BUSMASTER = TextFormat(_state, b"0123456789", _header, _one, _many)
