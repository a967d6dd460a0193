"""Frames and databases to try log files with."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import can
import numpy as np
from hypothesis import strategies as st

from orchestrator.can.codec.merging import Series
from orchestrator.can.codec.streams import FrameStream
from orchestrator.can.frames import Flag, Frames, concatenated

LENGTHS = [*range(9), 12, 16, 20, 24, 32, 48, 64]
START = 1_700_000_000.25  # POSIX time of the first frame
TEXT_LOGS = (".asc", ".log", ".trc", ".csv")

DBC = """VERSION ""
NS_ :
BS_:
BU_: rig
BO_ 256 State: 8 rig
 SG_ angle : 0|32@1- (1e-6,0) [-2000|2000] "rad" rig
 SG_ speed : 32|32@1- (1e-5,0) [-2000|2000] "rad/s" rig
BO_ 257 Command: 2 rig
 SG_ voltage : 0|16@1- (0.001,0) [-32|32] "V" rig
"""


def any_frames(count: int, seed: int = 0, fd: bool = True) -> Frames:
    """Frames of all kinds, about a millisecond apart."""
    rng = np.random.default_rng(seed)
    kind = rng.random(count)
    long = (kind > 0.7) & fd
    flags = np.where(rng.random(count) < 0.3, Flag.EXTENDED, 0) | np.where(rng.random(count) < 0.5, Flag.SENT, 0)
    flags |= np.where(kind < 0.05, Flag.REMOTE, np.where(kind < 0.1, Flag.ERROR, np.where(long, Flag.FD, 0)))
    flags |= np.where(long & (rng.random(count) < 0.5), Flag.BITRATE_SWITCH, 0)
    flags |= np.where(long & (rng.random(count) < 0.5), Flag.ERROR_STATE, 0)
    length = np.where(long, np.array(LENGTHS)[rng.integers(0, 16, count)], rng.integers(0, 9, count))
    data = rng.integers(0, 256, (count, 64 if fd else 8))
    data *= np.arange(data.shape[1]) < np.where(flags & Flag.REMOTE, 0, length)[:, None]
    identifier = np.where(flags & Flag.EXTENDED, rng.integers(0, 1 << 29, count), rng.integers(0, 1 << 11, count))
    time = START + np.round(np.cumsum(rng.uniform(1e-4, 2e-3, count)), 6) - 1e-3
    channel = rng.integers(0, 3, count)
    octets = (column.astype(np.uint8) for column in (flags, channel, length, data))
    return Frames(time.astype(np.float64), identifier.astype(np.uint32), *octets)


def rig_frames(count: int, start: float = START) -> Frames:
    """`count` times State (1 ms apart) and Command (0.2 ms later) as `DBC` has them."""
    angle, speed = np.sin(np.arange(count) * 1e-2), np.cos(np.arange(count) * 1e-2)
    data = np.zeros((2 * count, 8), np.uint8)
    data[0::2, :4] = np.round(angle / 1e-6).astype("<i4").view(np.uint8).reshape(count, 4)
    data[0::2, 4:] = np.round(speed / 1e-5).astype("<i4").view(np.uint8).reshape(count, 4)
    data[1::2, :2] = np.round(10 * angle / 1e-3).astype("<i2").view(np.uint8).reshape(count, 2)
    time = np.repeat(start + np.arange(count) * 1e-3, 2) + np.tile([0.0, 2e-4], count)
    nothing = np.zeros(2 * count, np.uint8)
    return Frames(
        time,
        np.tile([256, 257], count).astype(np.uint32),
        nothing,
        nothing,
        np.tile([8, 2], count).astype(np.uint8),
        data,
    )


def database(folder: Path) -> Path:
    """The file of `DBC`."""
    path = folder / "rig.dbc"
    path.write_text(DBC)
    return path


def messages() -> st.SearchStrategy[can.Message]:
    """Messages of all kinds as python-can has them."""

    @st.composite
    def one(draw: st.DrawFn) -> can.Message:
        kind = draw(st.sampled_from(["data", "data", "data", "remote", "error", "fd"]))
        extended = draw(st.booleans())
        length = draw(st.sampled_from(LENGTHS if kind == "fd" else LENGTHS[:9]))
        return can.Message(
            timestamp=START + draw(st.integers(0, 10**9)) * 1e-6,
            arbitration_id=draw(st.integers(0, (1 << 29 if extended else 1 << 11) - 1)),
            is_extended_id=extended,
            is_remote_frame=kind == "remote",
            is_error_frame=kind == "error",
            is_fd=kind == "fd",
            is_rx=draw(st.booleans()),
            bitrate_switch=kind == "fd" and draw(st.booleans()),
            error_state_indicator=kind == "fd" and draw(st.booleans()),
            channel=draw(st.integers(0, 5)),
            dlc=length,
            data=b"" if kind == "remote" else draw(st.binary(min_size=length, max_size=length)),
        )

    return one()


def all_of(batches: object) -> Frames:
    """The batches in a row."""
    return concatenated(list(batches))  # type: ignore[call-overload]


def different(one: Frames, other: Frames, columns: str = "id flags channel length data") -> list[str]:
    """The columns in which two sets of frames differ; data may be wider in one."""
    if len(one) != len(other):
        return [f"{len(one)} frames and {len(other)}"]
    found = []
    for name in columns.split():
        mine, theirs = getattr(one, name), getattr(other, name)
        if name == "data":
            width = max(mine.shape[1], theirs.shape[1])
            mine, theirs = (np.pad(data, ((0, 0), (0, width - data.shape[1]))) for data in (mine, theirs))
        if not np.array_equal(mine, theirs):
            found.append(name)
    return found


def latest_difference(one: Frames, other: Frames) -> float:
    """The largest difference of the stamps [s]."""
    return float(np.abs(one.time - other.time).max()) if len(one) else math.nan


def by_message(series: Mapping[FrameStream, Series]) -> dict[str, Series]:
    """Message -> its series, where each has one."""
    assert len({stream.message for stream in series}) == len(series)
    return {stream.message: own for stream, own in series.items()}
