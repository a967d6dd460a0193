"""Vector's .asc: stamps count from a date or from the line before, numbers are hexadecimal or decimal."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.can.frames import CLASSIC, LENGTHS, Flag
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
    event,
    found,
    octets,
    stamp,
    whole,
    word,
)

BASE = re.compile(r"base\s+(hex|dec)\b(?:.*\btimestamps\s+(absolute|relative))?", re.IGNORECASE)
TIMED = re.compile(r"date\s+(.+)|begin\s+triggerblock\b\s*(.*)", re.IGNORECASE)
NOTHING = re.compile(
    r"//|((no\s+)?internal\s+events|begin\s+triggerblock|end\s+triggerblock|previous\s+log\s+file|date|base)\b",
    re.IGNORECASE,
)
BEGUN = re.compile(r"-?\d+\.\d+\s+start\s+of\s+measurement", re.IGNORECASE)
IDENTIFIER = re.compile(r"[0-9a-f]+x?$", re.IGNORECASE)
LONG = 0x1000  # among the flags of a CANFD line


@dataclass(frozen=True)
class AscState(HeaderState):
    """The base of its numbers besides."""

    base: int = 16


def _header(line: str, state: AscState, reading: LogReading) -> AscState | None:
    if base := BASE.match(line):
        relative = state.relative if base[2] is None else base[2].lower() == "relative"
        if relative:
            reading.findings.note("stamps count from the line before and were added up")
        return replace(state, base=16 if base[1].lower() == "hex" else 10, relative=relative)
    timed = TIMED.match(line)
    if timed is None or not (told := timed[1] or timed[2]):
        return None
    begin = moment(told)
    if begin is None:
        raise NoFrameError("this date is not understood, the time of the beginning is not known")
    reading.findings.zoneless |= not begin.zone
    return replace(state, start=begin.time)


def _one(line: str, state: AscState, reading: LogReading) -> LogRow | None:
    if NOTHING.match(line) or BEGUN.match(line):
        return None
    words = line.split()
    time = stamp(words[0])
    kind = word(words, 1, "kind")
    if kind.upper() == "CANFD":
        return _fd(words, time, state)
    if not (kind.isdecimal() and kind.isascii()):
        return event(time)
    name, channel = word(words, 2, "identifier"), int(kind) - 1
    if name.lower() == "errorframe":
        return checked(LogRow(time, 0, Flag.ERROR | Flag.EXTENDED, channel))
    direction = words[3].lower() if len(words) > 3 else ""
    if direction == "txrq" or (direction not in DIRECTIONS and not IDENTIFIER.match(name)):
        return event(time)
    identifier, flags = _identifier(name, state.base), _sent(direction)
    return _classic(words, time, identifier, flags | _extended(name), channel, state.base)


def _classic(words: list[str], time: float, identifier: int, flags: int, channel: int, base: int) -> LogRow:
    kind = word(words, 4, "type").lower()
    if kind == "r":
        told = whole(words[5], base, "length") if len(words) > 5 and words[5][0] in "0123456789" else 0
        return checked(LogRow(time, identifier, flags | Flag.REMOTE, channel, told))
    if kind != "d":
        raise NoFrameError(f"'{kind}' is neither data nor a remote frame")
    code = whole(word(words, 5, "length"), base, "length")
    there = _data_words(words[6:], base)
    told = len(there)
    if code <= CLASSIC and told <= CLASSIC:
        told = code
    elif told not in (code, int(words[5]) if words[5].isdecimal() else code, LENGTHS[min(code, 15)]) and (
        told != CLASSIC or code < CLASSIC
    ):
        raise NoFrameError(f"says {code} data bytes and has {told}")
    flags |= Flag.FD * (told > CLASSIC)
    return data_row(time, identifier, flags, channel, told, octets(there[:told], base))


def _fd(words: list[str], time: float, state: AscState) -> LogRow:
    channel = whole(word(words, 2, "channel"), 10, "channel") - 1
    direction, name = word(words, 3, "direction").lower(), word(words, 4, "identifier")
    if direction == "txrq":
        return event(time)
    if name.lower() == "errorframe":
        return checked(LogRow(time, 0, Flag.ERROR | Flag.EXTENDED | Flag.FD | _sent(direction), channel))
    flags = Flag.FD | _sent(direction) | _extended(name)
    rest = words[5:] if word(words, 5, "bit rate switch") in ("0", "1") else words[6:]  # behind a symbolic name
    flags |= Flag.BITRATE_SWITCH * (word(rest, 0, "bit rate switch") == "1")
    flags |= Flag.ERROR_STATE * (word(rest, 1, "error state") == "1")
    code, told = (
        whole(word(rest, 2, "length code"), state.base, "length code"),
        whole(word(rest, 3, "length"), 10, "length"),
    )
    identifier, bits = _identifier(name, state.base), _bits(rest[told + 6 : told + 7])
    if told == 0 and not bits & LONG:
        return checked(LogRow(time, identifier, flags | Flag.REMOTE, channel, code))
    if bits and not bits & LONG and told <= CLASSIC:  # a classic frame on a channel of CAN FD
        flags &= ~Flag.FD
    return data_row(time, identifier, flags, channel, told, octets(rest[4 : 4 + told], state.base))


def _bits(words: list[str]) -> int:
    """Flags where there are any."""
    return int(words[0], 16) if words and re.fullmatch("[0-9a-fA-F]{1,8}", words[0]) else 0


def _data_words(words: list[str], base: int) -> list[str]:
    """Those at the beginning that are bytes."""
    for place, text in enumerate(words):
        if not (
            len(text) <= 3 and all(letter in "0123456789abcdefABCDEF"[: 10 if base == 10 else None] for letter in text)
        ):
            return words[:place]
    return words


def _identifier(name: str, base: int) -> int:
    return whole(name.rstrip("xX"), base, "identifier")


def _extended(name: str) -> int:
    return Flag.EXTENDED * name.lower().endswith("x")


def _sent(direction: str) -> int:
    if direction not in DIRECTIONS:
        raise NoFrameError(f"'{direction}' is neither Rx nor Tx")
    return Flag.SENT * (direction == "tx")


def _many(lines: TextLines, state: AscState, reading: LogReading) -> FoundRows:
    words = lines.words
    fd = lines.equal(words[1], "canfd")
    time, right = lines.decimals(words[0])
    channel, numbered = lines.whole_numbers(words[np.where(fd, 2, 1)], 10, 3)
    direction = words[3]
    name = words[np.where(fd, 4, 2)]
    extended = lines.equal(TextField(np.maximum(name.end - 1, name.begin), name.end), "x")
    identifier, named = lines.whole_numbers(name.without(0, extended), state.base, 8 if state.base == 16 else 10)
    sent, received = lines.equal(direction, "tx"), lines.equal(direction, "rx")
    switch = np.where(lines.equal(words[5], "0", "1"), 5, 6)
    length_word = np.where(fd, switch + 3, 5)
    length, told = lines.whole_numbers(words[length_word], 10, 2)
    length = np.where(told, length, 255)
    data = lines.octet_words(length_word + 1, length, state.base, int(CLASSIC if not fd.any() else 64))
    switched, stated = words[switch], words[switch + 1]
    bits, read = lines.whole_numbers(words[length_word + 3 + length], 16, 8)
    long = fd & (~read | (bits == 0) | (bits & LONG != 0) | (length > CLASSIC))
    flags = (
        extended * Flag.EXTENDED
        | sent * Flag.SENT
        | long * Flag.FD
        | (fd & lines.equal(switched, "1")) * Flag.BITRATE_SWITCH
        | (fd & lines.equal(stated, "1")) * Flag.ERROR_STATE
    )
    _, coded = lines.whole_numbers(words[switch + 2], state.base, 2)
    whole_fd = coded & lines.equal(switched, "0", "1") & lines.equal(stated, "0", "1") & (length > 0)
    _, more = lines.whole_numbers(words[length_word + 1 + length], state.base, 2)
    classic = lines.equal(words[4], "d") & (length <= CLASSIC) & ~more
    return found(
        (time, right),
        identifier,
        flags,
        channel - 1,
        length,
        data,
        told & numbered & named & (sent | received) & np.where(fd, whole_fd, classic),
    )


def _state(lines: Sequence[str], reading: LogReading) -> AscState:
    return AscState()


ASC = TextFormat(_state, b"0123456789-", _header, _one, _many)
