"""candump's logs (-l, -L) and what it prints on a terminal, with any of its kinds of stamps or none."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.can.frames import CLASSIC, LONGEST, Flag
from orchestrator.can.log_suffixes import LINES
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
    hexadecimal,
    octets,
    stamp,
    whole,
    word,
)

ERROR_BIT, IDENTIFIER = 0x20000000, 0x1FFFFFFF
STAMP = re.compile(r"\(([^)]*)\)\s*")
LENGTH = re.compile(r"\[\d+\]$|\{[0-9a-f]\}$", re.IGNORECASE)
BITS = 8  # digits of a byte that is printed binary
LEAST = 5  # stamps that tell differences from times
CALENDAR = 1e6  # [s]


@dataclass(frozen=True)
class CandumpState(HeaderState):
    """What stands for the stamp of a line that has none [s]."""

    step: float = 0.0


def _state(lines: Sequence[str], reading: LogReading) -> CandumpState:
    told_by = [told["interface"] for line in lines if (told := LINES["candump"].match(line))]
    reading.channels.add(told_by)
    stamps = [told[1] for line in lines if (told := STAMP.match(line.strip()))]
    if not stamps:
        reading.findings.note(
            "the log has no time stamps: its frames are taken as one a second; record with `candump -l`"
        )
        return CandumpState(relative=True, step=1.0)
    times = [float(told) for told in stamps[:1000] if re.fullmatch(r"\d+\.\d+", told)]
    steps = np.diff(times[1:])
    relative = len(times) >= LEAST and times[0] == 0.0 and bool((steps < 0).any() or (steps == 0).mean() > 0.5)
    if relative:
        reading.findings.note("stamps fall or repeat from 0 on: taken as time since the frame before, and added up")
    return CandumpState(relative=relative)


def _header(line: str, state: CandumpState, reading: LogReading) -> None:
    return None


def _one(line: str, state: CandumpState, reading: LogReading) -> LogRow | None:
    told = STAMP.match(line)
    time = _time(told[1], reading) if told else state.step
    words = line[told.end() if told else 0 :].split()
    interface, frame = word(words, 0, "interface"), word(words, 1, "frame")
    if "#" in frame:
        if told is None:
            raise NoFrameError("has no time stamp")
        row = _logged(time, frame, words[2:])
    else:
        row = _printed(time, words)
    return replace(row, channel=reading.channels.of(interface))


def _time(text: str, reading: LogReading) -> float:
    if "-" not in text:
        return stamp(text)
    date = moment(text)
    if date is None:
        raise NoFrameError(f"'{text}' is no time stamp")
    reading.findings.zoneless |= not date.zone
    return date.time


def _logged(time: float, frame: str, behind: list[str]) -> LogRow:
    """`123#0011`, `123#R4`, `12345678##3AABB`, with `_C` for a length code above 8."""
    name, _, content = frame.partition("#")
    identifier, flags = _identifier(name)
    flags |= Flag.SENT * (bool(behind) and behind[0].lower() == "t")
    content, _, _ = content.partition("_")
    if content[:1].lower() == "r":
        return checked(LogRow(time, identifier, flags | Flag.REMOTE, 0, whole(content[1:] or "0", 16, "length")))
    if content[:1] == "#":
        bits = whole(content[1:2], 16, "flags")
        flags |= Flag.FD | Flag.BITRATE_SWITCH * bool(bits & 1) | Flag.ERROR_STATE * bool(bits & 2)
        content = content[2:]
    data = hexadecimal(content.replace(".", ""))
    return _row(time, identifier, flags, len(data), data)


def _printed(time: float, words: list[str]) -> LogRow:
    """`can0  123   [8]  00 11`; with -x direction and two flags before that, with -8 the length code in braces."""
    lengths = [place for place, text in enumerate(words[:7]) if LENGTH.match(text)]
    if lengths[:1] not in ([2], [5]) or (lengths[0] == 5 and words[1].lower() not in DIRECTIONS):
        raise NoFrameError("is neither of candump's log nor of its terminal")
    place = lengths[0]
    bracket, told = words[place], words[place + 1 :]
    identifier, flags = _identifier(words[place - 1])
    if place == 5:
        flags |= Flag.SENT * (words[1].lower() == "tx")
        flags |= Flag.BITRATE_SWITCH * (words[2] == "B") | Flag.ERROR_STATE * (words[3] == "E")
    length = int(bracket[1:-1], 16 if bracket[0] == "{" else 10)
    if len(bracket) == 4 and bracket[0] == "[":  # two digits: CAN FD
        flags |= Flag.FD
    if told[:1] == ["remote"]:
        return checked(LogRow(time, identifier, flags | Flag.REMOTE, 0, length))
    if bracket[0] == "{":
        length = min(length, CLASSIC)
    return _row(time, identifier, flags, length, _data(told, length))


def _data(words: list[str], length: int) -> bytes:
    """Data bytes: hexadecimal or, with -i, binary; with -S the last one first and back quotes between them."""
    there = words[0].split("`")[::-1] if words and "`" in words[0] else words[:length]
    return octets(there, 2 if there and len(there[0]) == BITS else 16)


def _row(time: float, identifier: int, flags: int, length: int, data: bytes) -> LogRow:
    if flags & Flag.ERROR:
        identifier, flags = 0, Flag.ERROR | Flag.EXTENDED
    return data_row(time, identifier, flags, 0, length, data)


def _identifier(name: str) -> tuple[int, int]:
    """The number, and flags: extended with more than three digits, or an error frame."""
    number = whole(name, 16, "identifier")
    flags = Flag.EXTENDED * (len(name) > 3) | Flag.ERROR * bool(number & ERROR_BIT)
    return (number & IDENTIFIER if flags & Flag.EXTENDED else number), flags


def _many(lines: TextLines, state: CandumpState, reading: LogReading) -> FoundRows:
    words = lines.words
    stamped = words[0]
    time, timed = lines.decimals(stamped.without(1, 1))
    bracketed = (lines.starts(stamped) == ord("(")) & (lines.octets[stamped.end - 1] == ord(")"))
    frame = words[2]
    standard = lines.octets[frame.begin + 3] == ord("#")
    logged = bracketed & timed & (standard | (lines.octets[frame.begin + 8] == ord("#")))
    if not logged.any():
        return _many_printed(lines, state, reading)
    digits = np.where(standard, 3, 8)
    identifier, named = lines.whole_numbers(TextField(frame.begin, frame.begin + digits), 16, 8)
    content = frame.begin + digits + 1
    fd = lines.octets[content] == ord("#")
    bits, flagged = lines.whole_numbers(TextField(content + 1, content + 2), 16, 1)
    begin = np.where(fd, content + 2, content)
    count, odd = np.divmod(frame.end - begin, 2)
    data = lines.octet_digits(begin, np.where(logged, count, -1), 2, LONGEST if fd.any() else CLASSIC)
    flags = (
        ~standard * Flag.EXTENDED
        | fd * Flag.FD
        | (fd & (bits & 1 != 0)) * Flag.BITRATE_SWITCH
        | (fd & (bits & 2 != 0)) * Flag.ERROR_STATE
        | lines.equal(words[3], "t") * Flag.SENT
    )
    right = logged & named & (odd == 0) & (flagged | ~fd) & (identifier <= IDENTIFIER) & (fd | (count <= CLASSIC))
    channel = reading.channels.many(lines, words[1], right & data[1])
    return found((time, timed), identifier, flags, channel, count, data, right)


def _many_printed(lines: TextLines, state: CandumpState, reading: LogReading) -> FoundRows:
    """As the terminal shows them with a stamp that is a number, or without one."""
    words = lines.words
    stamped = (lines.starts(words[0]) == ord("(")) & (lines.octets[words[0].end - 1] == ord(")"))
    time, timed = lines.decimals(words[0].without(stamped * 1, stamped * 1))
    first = stamped * 1
    extra = lines.starts(words[first + 5]) == ord("[")
    place = np.where(extra, first + 5, first + 2)
    bracket, name = words[place], words[place - 1]
    identifier, named = lines.whole_numbers(name, 16, 8)
    length, told = lines.whole_numbers(bracket.without(1, 1), 10, 2)
    length = np.where(told, length, 255)
    fd = bracket.length == 4
    data = lines.octet_words(place + 1, length, 16, LONGEST if fd.any() else CLASSIC)
    flags = (
        (name.length > 3) * Flag.EXTENDED
        | (extra & lines.equal(words[first + 1], "tx")) * Flag.SENT
        | fd * Flag.FD
        | (extra & lines.equal(words[first + 2], "b")) * Flag.BITRATE_SWITCH
        | (extra & lines.equal(words[first + 3], "e")) * Flag.ERROR_STATE
    )
    right = named & told & (identifier <= IDENTIFIER) & (fd | (length <= CLASSIC))
    right &= (lines.starts(bracket) == ord("[")) & (lines.octets[bracket.end - 1] == ord("]"))
    right &= ~lines.equal(words[place + 1 + length], "remote") & (lines.starts(words[first]) != ord("("))
    right &= ~extra | lines.equal(words[first + 1], *DIRECTIONS)
    right &= data[1] & ((name.length == 3) | (name.length == 8)) & (timed | ~stamped)
    channel = reading.channels.many(lines, words[first], right)
    return found((np.where(stamped, time, state.step), right), identifier, flags, channel, length, data, right)


CANDUMP = TextFormat(_state, bytes(range(33, 256)), _header, _one, _many)
