"""Frames as columns: the one form in which raw CAN data flow, from logs and buses to signals and back.

Work on many frames at once goes through NumPy; single frames on a live bus stay python-can's `Message`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import IntFlag
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from orchestrator.trace import BoolArray, Bytes, FloatArray

if TYPE_CHECKING:
    import can

CLASSIC, LONGEST = 8, 64  # data bytes of a classic and of a CAN FD frame
MICRO = 6  # digits
CALENDAR = 1e8  # [s]; stamps from 1973 on are dates, smaller ones count from the start of a measurement
LENGTHS = np.array([*range(9), 12, 16, 20, 24, 32, 48, 64], dtype=np.uint8)  # data bytes by length code


class Flag(IntFlag):
    """What a frame is besides a data frame with a standard identifier."""

    EXTENDED = 1
    REMOTE = 2
    ERROR = 4
    FD = 8
    BITRATE_SWITCH = 16
    ERROR_STATE = 32
    SENT = 64


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames in the order of a log or a bus.

    Attributes:
        time: (K,) stamps as the log has them: POSIX time, or seconds from its start [s].
        id: (K,) identifiers, uint32.
        flags: (K,) of `Flag`, uint8.
        channel: (K,) number of the channel, from 0, uint8.
        length: (K,) data bytes, uint8.
        data: (K, 8) or (K, 64), uint8; what lies beyond a frame's length is 0.
    """

    time: FloatArray
    id: NDArray[np.uint32]
    flags: Bytes
    channel: Bytes
    length: Bytes
    data: Bytes

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, rows: slice | BoolArray | NDArray[np.intp]) -> Frames:
        """The frames of these rows."""
        return Frames(
            self.time[rows], self.id[rows], self.flags[rows], self.channel[rows], self.length[rows], self.data[rows]
        )

    def taken(self, rows: NDArray[np.intp]) -> Frames:
        """The frames of these rows; `take` moves whole rows of data, which is faster than indexing."""
        return Frames(
            self.time[rows],
            self.id[rows],
            self.flags[rows],
            self.channel[rows],
            self.length[rows],
            self.data.take(rows, axis=0),
        )

    def has(self, flag: Flag) -> BoolArray:
        """(K,) which frames carry the flag."""
        return np.asarray(self.flags & np.uint8(flag), np.bool_)

    def messages(self) -> Iterator[can.Message]:
        """The frames one by one, as python-can has them."""
        import can  # noqa: PLC0415 - brings along the readers of all its formats

        columns = (
            self.time.tolist(),
            self.id.tolist(),
            self.flags.tolist(),
            self.channel.tolist(),
            self.length.tolist(),
        )
        for row, (time, identifier, flags, channel, length) in enumerate(zip(*columns, strict=True)):
            remote = bool(flags & Flag.REMOTE)
            yield can.Message(
                timestamp=time,
                arbitration_id=identifier,
                is_extended_id=bool(flags & Flag.EXTENDED),
                is_remote_frame=remote,
                is_error_frame=bool(flags & Flag.ERROR),
                is_fd=bool(flags & Flag.FD),
                bitrate_switch=bool(flags & Flag.BITRATE_SWITCH),
                error_state_indicator=bool(flags & Flag.ERROR_STATE),
                is_rx=not flags & Flag.SENT,
                channel=channel,
                dlc=length,
                data=b"" if remote else self.data[row, :length].tobytes(),
            )


def stamps(start: float, offset: FloatArray) -> FloatArray:
    """(K,) POSIX times of what comes after a start [s].

    A double of today's date is good to a quarter of a microsecond. What is told in whole microseconds becomes the
    double next to these, so that `since` gives it back.
    """
    time = offset + start
    return np.round(time, MICRO) if _in_microseconds(offset, 1e-9) else time


def coarsened(start: float, offset: FloatArray, time: FloatArray) -> bool:
    """Whether `since` does not give back what stamps of a start were told after it, within a nanosecond."""
    return bool(np.any(np.abs(since(start, time) - offset) > 1e-9))


def since(start: float, time: FloatArray) -> FloatArray:
    """(K,) what stamps are after a start [s]: in whole microseconds where both are."""
    offset = time - start
    dated = abs(start) >= CALENDAR and start == round(start, MICRO)
    return np.round(offset, MICRO) if dated and bool(np.all(time == np.round(time, MICRO))) else offset


def _in_microseconds(offset: FloatArray, slack: float) -> bool:
    return bool(np.all(np.abs(offset - np.round(offset, MICRO)) < slack))


def empty() -> Frames:
    """No frames."""
    return from_messages(())


def concatenated(parts: Sequence[Frames]) -> Frames:
    """Parts in a row."""
    if not parts:
        return empty()
    width = max(part.data.shape[1] for part in parts)
    return Frames(
        np.concatenate([part.time for part in parts]),
        np.concatenate([part.id for part in parts]),
        np.concatenate([part.flags for part in parts]),
        np.concatenate([part.channel for part in parts]),
        np.concatenate([part.length for part in parts]),
        np.concatenate([np.pad(part.data, ((0, 0), (0, width - part.data.shape[1]))) for part in parts]),
    )


def from_messages(messages: Iterable[can.Message]) -> Frames:
    """The columns of python-can's messages; a channel that is no number counts as 0."""
    taken = list(messages)
    width = LONGEST if any(len(message.data) > CLASSIC for message in taken) else CLASSIC
    data = b"".join(bytes(message.data).ljust(width, b"\0") for message in taken)
    return Frames(
        np.array([message.timestamp for message in taken], dtype=np.float64),
        np.array([message.arbitration_id for message in taken], dtype=np.uint32),
        np.array([_flags(message) for message in taken], dtype=np.uint8),
        np.array([_channel(message) for message in taken], dtype=np.uint8),
        np.array([message.dlc if message.is_remote_frame else len(message.data) for message in taken], dtype=np.uint8),
        np.frombuffer(data, dtype=np.uint8).reshape(len(taken), width).copy(),
    )


def _flags(message: can.Message) -> int:
    return (
        Flag.EXTENDED * message.is_extended_id
        | Flag.REMOTE * message.is_remote_frame
        | Flag.ERROR * message.is_error_frame
        | Flag.FD * message.is_fd
        | Flag.BITRATE_SWITCH * message.bitrate_switch
        | Flag.ERROR_STATE * message.error_state_indicator
        | Flag.SENT * (not message.is_rx)
    )


def _channel(message: can.Message) -> int:
    return message.channel if isinstance(message.channel, int) and 0 <= message.channel < 256 else 0


def moment(stamp: float) -> str:
    """A stamp as date and time."""
    return datetime.fromtimestamp(stamp, UTC).isoformat()
