"""A line of a log on its own: the frame that it holds, or in words why it holds none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmus.words import cut
from orchestrator.can.frames import CLASSIC, LENGTHS, LONGEST, Flag, Frames
from orchestrator.stamps import LATEST
from orchestrator.trace import BoolArray, Bytes, FloatArray

Numbers = NDArray[np.signedinteger[Any]]

EXTENDED_IDS, STANDARD_IDS = 1 << 29, 1 << 11
DIRECTIONS = ("rx", "tx")
DIGITS = {2: 8, 10: 3, 16: 2}
"""Base of numbers -> most digits of a data byte."""


class NoFrameError(Exception):
    """Why a line is no frame."""


@dataclass(frozen=True)
class LogRow:
    """The frame of a line; an event that is none where `frame` is not set.

    Attributes:
        time: as the line has it [s].
        length: data bytes; those that a remote frame asks for.
    """

    time: float
    id: int = 0
    flags: int = 0
    channel: int = 0
    length: int = 0
    data: bytes = b""
    frame: bool = True


class FoundRows(NamedTuple):
    """What many lines hold: frames (of any content where it is not `sound`)."""

    frames: Frames
    sound: BoolArray


def event(time: float = 0.0) -> LogRow:
    """What a line tells besides frames."""
    return LogRow(time, frame=False)


def data_row(time: float, identifier: int, flags: int, channel: int, told: int, data: bytes) -> LogRow:
    """A frame with data, of which the line tells the length.

    Raises:
        NoFrameError: there are not so many.
    """
    if len(data) != told:
        raise NoFrameError(f"says {told} data bytes and has {len(data)}")
    if told > CLASSIC and not flags & Flag.FD:
        raise NoFrameError(f"has {told} data bytes, and is not of CAN FD")
    if told not in LENGTHS:
        raise NoFrameError(f"has {told} data bytes, which no frame has")
    return checked(LogRow(time, identifier, flags, channel, told, data))


def checked(row: LogRow) -> LogRow:
    """The row.

    Raises:
        NoFrameError: a part of it is not that of a frame.
    """
    if not abs(row.time) <= LATEST:
        raise NoFrameError(f"its time stamp is {row.time:g}")
    if not 0 <= row.id < (EXTENDED_IDS if row.flags & Flag.EXTENDED else STANDARD_IDS):
        raise NoFrameError(f"its identifier is {row.id:#x}")
    if not 0 <= row.channel < 256:
        raise NoFrameError(f"its channel is {row.channel}")
    if row.length > LONGEST:
        raise NoFrameError(f"asks for {row.length} data bytes")
    return row


def word(words: list[str], number: int, what: str) -> str:
    """A word of the line.

    Raises:
        NoFrameError: it ends before.
    """
    if number >= len(words):
        raise NoFrameError(f"ends before its {what}")
    return words[number]


def stamp(text: str) -> float:
    """A time stamp [s, or whatever the unit is]."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < float("inf") or "_" in text or not text.isascii():
        raise NoFrameError(f"'{shown(text)}' is no time stamp")
    return value


def whole(text: str, base: int, what: str) -> int:
    """A whole number that is not negative."""
    try:
        value = int(text, base)
    except ValueError:
        value = -1
    if value < 0 or not text.isalnum() or not text.isascii():
        raise NoFrameError(f"'{shown(text)}' is no {what}")
    return value


def octets(words: list[str], base: int = 16) -> bytes:
    """Data bytes, a word each."""
    values = [whole(text, base, "data byte") for text in words]
    odd = next((text for text, value in zip(words, values, strict=True) if len(text) > DIGITS[base] or value > 255), "")
    if odd:
        raise NoFrameError(f"'{shown(odd)}' is no data byte")
    return bytes(values)


def hexadecimal(text: str) -> bytes:
    """Data bytes, two digits each."""
    digits = text.replace(" ", "")
    try:
        return bytes.fromhex(digits)
    except ValueError:
        raise NoFrameError(f"'{shown(text)}' are no data bytes") from None


def shown(text: str) -> str:
    """What is quoted of a line."""
    return cut(text, 24)


def nothing(count: int) -> FoundRows:
    """Of so many lines none is understood."""
    zero = np.zeros(count, np.uint8)
    frames = Frames(np.zeros(count), zero.astype(np.uint32), zero, zero, zero, np.zeros((count, CLASSIC), np.uint8))
    return FoundRows(frames, np.zeros(count, bool))


def found(
    time: tuple[FloatArray, BoolArray],
    identifier: Numbers,
    flags: Numbers,
    channel: Numbers,
    length: Numbers,
    data: tuple[Bytes, BoolArray],
    *sound: BoolArray,
) -> FoundRows:
    """The lines' frames; sound where each part is, and can be that of a frame."""
    most = np.where(flags & Flag.EXTENDED, EXTENDED_IDS, STANDARD_IDS)
    right = time[1] & data[1] & (np.abs(time[0]) <= LATEST) & (identifier < most) & (channel >= 0) & (channel < 256)
    right &= (length <= CLASSIC) | ((flags & Flag.FD != 0) & np.isin(length, LENGTHS))
    for part in sound:
        right &= part
    small = [np.where(right, column, 0).astype(np.uint8) for column in (flags, channel, length)]
    return FoundRows(Frames(time[0], identifier.astype(np.uint32), small[0], small[1], small[2], data[0]), right)


def with_rows(found: FoundRows, rows: dict[int, LogRow]) -> Frames:
    """All frames in the order of their lines, those that were read one by one in their places."""
    frames, taken = found.frames, found.sound.copy()
    width = max([frames.data.shape[1], *(LONGEST for row in rows.values() if len(row.data) > CLASSIC)])
    data = np.pad(frames.data, ((0, 0), (0, width - frames.data.shape[1])))
    time, identifier = frames.time.copy(), frames.id.copy()
    flags, channel, length = frames.flags.copy(), frames.channel.copy(), frames.length.copy()
    for place, row in rows.items():
        time[place], identifier[place], taken[place] = row.time, row.id, row.frame
        flags[place], channel[place], length[place] = row.flags, row.channel, row.length
        data[place] = np.frombuffer(row.data.ljust(width, b"\0"), np.uint8)
    return Frames(time, identifier, flags, channel, length, data)[taken]
