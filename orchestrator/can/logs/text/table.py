"""Tables of frames (.csv): python-can's, SavvyCAN's, CANedge's, Vector's and others', told apart by their columns."""

from __future__ import annotations

import re
from base64 import b64decode
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orchestrator.can.frames import CLASSIC, LENGTHS, LONGEST, Flag
from orchestrator.can.logs.text.busmaster import clock
from orchestrator.can.logs.text.dates import moment
from orchestrator.can.logs.text.form import HeaderState, LogReading, TextFormat
from orchestrator.can.logs.text.lines import BLANK, Positions, TextField, TextLines, TextPieces
from orchestrator.can.logs.text.rows import (
    STANDARD_IDS,
    FoundRows,
    LogRow,
    NoFrameError,
    checked,
    data_row,
    event,
    found,
    hexadecimal,
    nothing,
    octets,
    shown,
    stamp,
    whole,
)
from orchestrator.can.table_head import TableHead, table_head
from orchestrator.trace import BoolArray, Bytes

YES, NO = ("1", "true", "yes", "x", "fd"), ("0", "false", "no", "", "-", "s", "std")
SENT, RECEIVED = ("tx", "1", "t", "true"), ("rx", "0", "r", "false", "", "-")
ROLES = {
    "remote": Flag.REMOTE,
    "error": Flag.ERROR,
    "fd": Flag.FD,
    "switch": Flag.BITRATE_SWITCH,
    "state": Flag.ERROR_STATE,
}
LOOKED_AT = 200  # lines
BASE64 = np.full(256, 255, np.uint8)
BASE64[np.frombuffer(b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/", np.uint8)] = np.arange(64)
BASE64[ord("=")] = 0


@dataclass(frozen=True)
class TableState(HeaderState):
    """The columns, the unit of stamps as `10^-shift` s, and the number of the first channel besides."""

    head: TableHead | None = None
    shift: int = 0
    first_channel: int = 0


def _state(lines: Sequence[str], reading: LogReading) -> TableState:
    for number, line in enumerate(lines):
        head = table_head(line)
        if head is not None:
            return _with(head, lines[number + 1 : number + 1 + LOOKED_AT], reading)
    return TableState()


def _with(head: TableHead, lines: Sequence[str], reading: LogReading) -> TableState:
    """The state with what the first rows tell and the names of the columns do not."""
    rows = [_cells(line, head) for line in lines if line.strip()]
    shift, stamps = head.shift, [row[head.columns["time"]] for row in rows if len(row) > head.columns["time"]]
    if shift is None:
        shift = 6 if stamps and not head.base64 and all(text.isdigit() for text in stamps) else 0
        if shift:
            reading.findings.note("stamps are whole numbers and count as microseconds")
    names = [row[head.columns["id"]] for row in rows if len(row) > head.columns["id"]]
    if names and all(name.isdecimal() and name[0] != "0" for name in names):
        reading.findings.note("identifiers are taken for hexadecimal numbers")
    first = 0
    if "channel" in head.columns:
        channels = {_bare(row[head.columns["channel"]]) for row in rows if len(row) > head.columns["channel"]}
        first = 0 if "0" in channels else 1
        if not first:
            reading.findings.note("channels are counted from 0 in this file")
    return TableState(head=head, shift=shift, first_channel=first)


def _header(line: str, state: TableState, reading: LogReading) -> TableState | None:
    head = table_head(line)
    if head is None or head == state.head:
        return state if head else None
    return replace(state, head=head, shift=head.shift or 0)


def _cells(line: str, head: TableHead) -> list[str]:
    return [cell.strip(' "') for cell in line.split(head.separator)]


def _one(line: str, state: TableState, reading: LogReading) -> LogRow | None:
    head = state.head
    if head is None:
        raise NoFrameError("there are no names of columns before it")
    cells = _cells(line, head)

    def cell(role: str) -> str:
        place = head.columns.get(role, len(cells))
        return cells[place].lower() if place < len(cells) else ""

    if not cell("id") and cell("time"):
        return event()
    digits = cell("id").removeprefix("0x").rstrip("xh")
    identifier = whole(digits, 16, "identifier")
    extended = _yes(cell("extended")) if "extended" in head.columns else _looks_extended(cell("id"), digits, identifier)
    flags = Flag.EXTENDED * extended | Flag.SENT * (cell("direction") in SENT)
    for role, flag in ROLES.items():
        flags |= flag * _yes(cell(role))
    channel = _channel(cell("bus"), cell("channel"), state, reading)
    time = _time(cell("time"), state)
    told = whole(cell("length") or cell("code") or "0", 10, "length")
    if flags & Flag.REMOTE and not flags & Flag.ERROR:
        return checked(LogRow(time, identifier, flags, channel, told))
    data = _data(cells, head, told)
    if (
        len(data) == LENGTHS[min(told, 15)]
        or told > CLASSIC == len(data)
        or not {"length", "code"} & head.columns.keys()
    ):
        told = len(data)  # what was told is the length code, maybe one above 8 of a classic frame
    return data_row(time, identifier, flags | Flag.FD * (len(data) > CLASSIC), channel, told, data)


def _yes(text: str) -> bool:
    if text not in YES and text not in NO:
        raise NoFrameError(f"'{shown(text)}' is neither yes nor no")
    return text in YES


def _looks_extended(name: str, digits: str, identifier: int) -> bool:
    return name.endswith("x") or len(digits) > 4 or identifier >= STANDARD_IDS


def _channel(bus: str, channel: str, state: TableState, reading: LogReading) -> int:
    name, first = (bus, 0) if bus else (_bare(channel), state.first_channel)
    if not name:
        return 0
    return int(name) - first if name.isdecimal() and name.isascii() and len(name) < 4 else reading.channels.of(name)


def _bare(channel: str) -> str:
    """The number of a channel as Vector's tables name it, `CAN 1`."""
    return re.sub(r"^can +(?=\d+$)", "", channel, flags=re.IGNORECASE)


def _time(text: str, state: TableState) -> float:
    if text.count(":") == 3:
        return clock(text)
    if "-" in text[1:] and "e" not in text and (date := moment(text)):
        return date.time
    return stamp(text) / float(10**state.shift)


def _data(cells: list[str], head: TableHead, told: int) -> bytes:
    if head.octets:
        there = [
            cells[place].lower().removeprefix("0x") for place in head.octets if place < len(cells) and cells[place]
        ]
        return octets(there[: told if told <= CLASSIC else None])
    place = head.columns["data"]
    text = (
        head.separator.join(cells[place:]) if place == max(head.columns.values()) else "".join(cells[place : place + 1])
    )
    text = text.rstrip(head.separator)
    if not head.base64:
        return hexadecimal(text.replace(head.separator, " ").replace("0x", ""))
    try:
        return b64decode(text, validate=True)
    except ValueError:
        raise NoFrameError(f"'{shown(text)}' are no data in base 64") from None


def _many(lines: TextLines, state: TableState, reading: LogReading) -> FoundRows:
    head, count = state.head, len(lines)
    if head is None:
        return nothing(count)
    fields, none = lines.fields(head.separator), np.zeros(count, np.int64)

    def cells(role: str) -> TextField:
        return fields[head.columns[role]]

    time, timed = lines.decimals(cells("time"))
    name = cells("id")
    digits = name.without(2 * lines.equal(TextField(name.begin, np.minimum(name.begin + 2, name.end)), "0x"))
    identifier, right = lines.whole_numbers(digits, 16, 8)
    flags = ((digits.length > 4) | (identifier >= STANDARD_IDS)) * int(Flag.EXTENDED)
    if "extended" in head.columns:
        yes, sure = _answers(lines, cells("extended"))
        flags, right = yes * int(Flag.EXTENDED), right & sure
    for role, flag in ROLES.items():
        if role in head.columns:
            yes, sure = _answers(lines, cells(role))
            flags, right = flags | yes * int(flag), right & sure
    if "direction" in head.columns:
        sent = lines.equal(cells("direction"), *filter(None, SENT))
        flags, right = (
            flags | sent * int(Flag.SENT),
            right & (sent | lines.equal(cells("direction"), *filter(None, RECEIVED))),
        )
    channel = none
    for role, first in (("channel", state.first_channel), ("bus", 0)):
        if role in head.columns:
            number, sure = lines.whole_numbers(cells(role), 10, 3)
            channel, right = number - first, right & sure
    length, data = _octets(lines, fields, head)
    told_by = next((role for role in ("length", "code") if role in head.columns), None)
    if told_by is not None:
        told, sure = lines.whole_numbers(cells(told_by), 10, 2)
        right &= sure & (told == length)
    flags = flags | (length > CLASSIC) * int(Flag.FD)
    last = max([*head.columns.values(), *head.octets])
    right = right & (fields[last + 1].length == 0)
    return found(
        (time / float(10**state.shift), timed),
        identifier,
        flags,
        channel,
        length,
        data,
        right & (flags & Flag.REMOTE == 0),
    )


def _answers(lines: TextLines, field: TextField) -> tuple[BoolArray, BoolArray]:
    """Which say yes, and which say yes or no in the usual words."""
    yes = lines.equal(field, "1", "true")
    return yes, yes | lines.equal(field, "0", "false")


def _octets(lines: TextLines, fields: TextPieces, head: TableHead) -> tuple[Positions, tuple[Bytes, BoolArray]]:
    """Numbers of data bytes, these, and which are sound."""
    if head.octets:
        return _octet_fields(lines, fields, head.octets)
    field = fields[head.columns["data"]]
    if head.base64:
        return _decoded(lines, field)
    spaced = bool(np.any((field.length > 2) & (lines.octets[field.begin + 2] <= BLANK)))
    length, over = np.divmod(field.length + spaced, 2 + spaced)
    width = CLASSIC if length.max(initial=0) <= CLASSIC else LONGEST
    data, sound = lines.octet_digits(field.begin, length, 2 + spaced, width, head.separator)
    return length, (data, sound & (over == 0))


def _octet_fields(
    lines: TextLines, fields: TextPieces, places: tuple[int, ...]
) -> tuple[Positions, tuple[Bytes, BoolArray]]:
    width = CLASSIC if len(places) <= CLASSIC else LONGEST
    data, sound = np.zeros((len(lines), width), np.uint8), np.ones(len(lines), bool)
    length = np.zeros(len(lines), np.int64)
    for number, place in enumerate(places[:width]):
        field = fields[place]
        value, right = lines.whole_numbers(field, 16, 2)
        there = field.length > 0
        sound &= ~there | (right & (length == number))
        data[:, number] = np.where(there, value, 0)
        length += there
    return length, (data, sound)


def _decoded(lines: TextLines, field: TextField) -> tuple[Positions, tuple[Bytes, BoolArray]]:
    """Data bytes in base 64, up to twelve letters."""
    near = lines.near(field.begin, 12)
    there = np.arange(12) < field.length[:, None]
    padded = (near == ord("=")) & there
    padding = padded.sum(axis=1)
    last = np.arange(12) >= field.length[:, None] - 2
    sound = (field.length % 4 == 0) & (field.length <= 12) & ((BASE64[near] < 64) | ~there).all(axis=1)
    sound &= ~(padded & ~last).any(axis=1) & ((padding == 0) | (lines.octets[field.end - 1] == ord("=")))
    letters = np.where(there, BASE64[near], 0).astype(np.uint32)
    groups = letters.reshape(-1, 3, 4) @ np.array([1 << 18, 1 << 12, 1 << 6, 1], np.uint32)
    octets_there = (groups[:, :, None] >> np.array([16, 8, 0], np.uint32) & 255).reshape(-1, 9)
    length = field.length // 4 * 3 - padding
    data = np.where(np.arange(CLASSIC) < length[:, None], octets_there[:, :CLASSIC], 0)
    return length, (data.astype(np.uint8), sound & (length <= CLASSIC))


TABLE = TextFormat(_state, b"0123456789-.", _header, _one, _many)
