"""PEAK's .trc of all versions: each is a list of columns, which the later ones tell themselves."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from orchestrator.can.frames import CLASSIC, LENGTHS, LONGEST, Flag
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

COLUMNS = {"1.0": "N,O,I,L,D", "1.1": "N,O,d,I,L,D", "1.2": "N,O,B,d,I,L,D", "1.3": "N,O,B,d,I,R,L,D"}
NEWER = {"2.0": "N,O,T,I,d,l,D", "2.1": "N,O,T,B,I,d,R,l,D"}
START = re.compile(r";\s*start time:\s*(\S.*)", re.IGNORECASE)  # for people, and all that 1.0 has
EITHER_FIRST = re.compile(r"(0?[1-9]|1[0-2])/(0?[1-9]|1[0-2])/")  # of day and month
EPOCH = 25569  # days from 1899-12-30 to 1970
KINDS = {"dt": 0, "fd": Flag.FD, "fb": Flag.FD | Flag.BITRATE_SWITCH, "rr": Flag.REMOTE}
KINDS |= {"fe": Flag.FD | Flag.BITRATE_SWITCH | Flag.ERROR_STATE, "bi": Flag.FD | Flag.ERROR_STATE}
ERRORS = ("er", "error", "errfr")
EVENTS = ("st", "ec", "ev", "warng", "status", "event")
BUS_INFO = "ffffffff"


def _columns(text: str) -> dict[str, int]:
    return {name: number for number, name in enumerate(text.split(","))}


@dataclass(frozen=True)
class TrcState(HeaderState):
    """The columns by their letters besides."""

    columns: dict[str, int] = field(default_factory=lambda: _columns(COLUMNS["1.0"]))


def _state(lines: Sequence[str], reading: LogReading) -> TrcState:
    return TrcState()


def _header(line: str, state: TrcState, reading: LogReading) -> TrcState | None:
    if (said := START.match(line)) and not state.start:
        begin = None if EITHER_FIRST.match(said[1]) else moment(said[1])
        if begin is None:
            raise NoFrameError("this date is not understood, the time of the beginning is not known")
        reading.findings.zoneless |= not begin.zone
        return replace(state, start=begin.time)
    name, _, value = line.partition("=")
    if name == ";$FILEVERSION":
        known = {**COLUMNS, **NEWER}
        if value.strip() not in known:
            raise NoFrameError(f"the version {value.strip()} of the format is not known, it is read as 1.0")
        return replace(state, columns=_columns(known[value.strip()]))
    if name == ";$STARTTIME":
        reading.findings.zoneless = True
        return replace(state, start=round((stamp(value) - EPOCH) * 86400, 6))
    if name == ";$COLUMNS":
        columns = _columns(value.strip())
        if not {"O", "I", "D"} <= columns.keys() or not {"l", "L"} & columns.keys():
            raise NoFrameError("these are not the columns of frames")
        return replace(state, columns=columns)
    return None


def _one(line: str, state: TrcState, reading: LogReading) -> LogRow | None:
    if line.startswith(";"):
        return None
    words, columns = line.split(), state.columns

    def cell(name: str, what: str) -> str:
        return word(words, columns[name], what) if name in columns else ""

    time = stamp(cell("O", "time stamp")) / 1e3
    kind, direction, name = cell("T", "type").lower(), cell("d", "direction").lower(), cell("I", "identifier")
    if kind in EVENTS or direction in EVENTS:
        return event(time)
    channel = whole(bus, 10, "bus") - 1 if (bus := cell("B", "bus")) not in ("", "-") else 0
    if kind in ERRORS or direction in ERRORS:
        return checked(LogRow(time, 0, Flag.ERROR | Flag.EXTENDED, channel))
    if name.lower() == BUS_INFO:
        return event(time)
    if (kind and kind not in KINDS) or (direction and direction not in DIRECTIONS):
        raise NoFrameError(f"'{kind} {direction}' is no type of a frame".replace("' ", "'"))
    flags = KINDS.get(kind, 0) | Flag.EXTENDED * (len(name) > 4) | Flag.SENT * (direction == "tx")
    there = words[columns["D"] :]
    length = whole(cell("l" if "l" in columns else "L", "length"), 10, "length")
    if "l" not in columns and length > CLASSIC:
        length = int(LENGTHS[length]) if flags & Flag.FD and length < len(LENGTHS) else CLASSIC
    identifier = whole(name, 16, "identifier")
    if flags & Flag.REMOTE or there[:1] == ["RTR"]:
        return checked(LogRow(time, identifier, flags | Flag.REMOTE, channel, length))
    return data_row(time, identifier, flags, channel, length, octets(there[:length]))


def _many(lines: TextLines, state: TrcState, reading: LogReading) -> FoundRows:
    words, columns, nothing = lines.words, state.columns, np.zeros(len(lines), np.int64)
    every = np.ones(len(lines), bool)

    def cells(name: str) -> TextField:
        return words[columns[name]]

    time, right = lines.decimals(cells("O"))
    identifier, named = lines.whole_numbers(cells("I"), 16, 8)
    channel, numbered = lines.whole_numbers(cells("B"), 10, 2) if "B" in columns else (nothing + 1, every)
    length, told = lines.whole_numbers(cells("l" if "l" in columns else "L"), 10, 2)
    flags, known = (cells("I").length > 4) * Flag.EXTENDED, every
    if "T" in columns:
        kinds = {kind: lines.equal(cells("T"), kind) for kind, bits in KINDS.items() if not bits & Flag.REMOTE}
        flags = flags | sum(is_kind * KINDS[kind] for kind, is_kind in kinds.items())
        known = np.any([*kinds.values()], axis=0)
    if "d" in columns:
        sent = lines.equal(cells("d"), "tx")
        flags, known = flags | sent * Flag.SENT, known & (sent | lines.equal(cells("d"), "rx"))
    fd = flags & Flag.FD != 0
    if "l" not in columns:
        length = np.where(fd, LENGTHS[np.minimum(length, 15)], np.minimum(length, CLASSIC))
    length = np.where(told, length, 255)
    known = known & ~lines.equal(cells("D"), "rtr") & (lines.starts(words[0]) != ord(";"))
    data = lines.octet_words(columns["D"], length, 16, LONGEST if fd.any() else CLASSIC)
    return found((time / 1e3, right), identifier, flags, channel - 1, length, data, named & numbered & told & known)


TRC = TextFormat(_state, b"0123456789", _header, _one, _many)
