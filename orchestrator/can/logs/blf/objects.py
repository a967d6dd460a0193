"""The objects of a BLF log, decoded many at once: where they begin, which are frames, and the frames' columns.

Every object starts with the signature LOBJ and its size, so all candidates are found in one pass, the chain of sizes
is checked against them in a second, and the fields of each kind of object are gathered in a third.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orchestrator.can.frames import CLASSIC, LENGTHS, LONGEST, Flag, Frames
from orchestrator.trace import BoolArray, Bytes, FloatArray

SIGNATURE = b"LOBJ"
PADDING = 4  # bytes that may lie between two objects
SLACK = 256  # zero bytes behind the objects, so that the fields of one at the end can be gathered
MAX_OBJECT, MAX_FRAME = 1 << 25, 4096  # bytes; what claims more has a broken size

CAN_MESSAGE, CAN_ERROR, CAN_ERROR_EXT, CAN_MESSAGE2, CAN_FD_MESSAGE, CAN_FD_MESSAGE_64 = 1, 2, 73, 86, 100, 101
CAN_FD_ERROR_64 = 104
LOG_CONTAINER = 10
TEN_MICROSECONDS = 1  # the flag of a stamp's unit; any other value means nanoseconds

Positions = NDArray[np.int64]
Dated = Callable[[FloatArray], FloatArray]

HEADER = np.dtype([("signature", "<u4"), ("header", "<u2"), ("version", "<u2"), ("size", "<u4"), ("type", "<u4")])
STAMP = np.dtype([("flags", "<u4"), ("client", "<u2"), ("version", "<u2"), ("time", "<u8")])
MESSAGE = np.dtype([("channel", "<u2"), ("flags", "u1"), ("dlc", "u1"), ("id", "<u4"), ("data", "u1", CLASSIC)])
ERROR = np.dtype([("channel", "<u2"), ("length", "<u2")])
ERROR_EXT = np.dtype(
    [
        ("channel", "<u2"),
        ("length", "<u2"),
        ("flags", "<u4"),
        ("code", "u1"),
        ("position", "u1"),
        ("dlc", "u1"),
        ("_", "u1"),
        ("bits", "<u4"),
        ("id", "<u4"),
        ("more", "<u2"),
        ("_2", "<u2"),
        ("data", "u1", CLASSIC),
    ]
)
FD = np.dtype(
    [
        ("channel", "<u2"),
        ("flags", "u1"),
        ("dlc", "u1"),
        ("id", "<u4"),
        ("bits", "<u4"),
        ("count", "u1"),
        ("fd", "u1"),
        ("valid", "u1"),
        ("_", "u1", 5),
        ("data", "u1", LONGEST),
    ]
)
FD_64 = np.dtype(
    [
        ("channel", "u1"),
        ("dlc", "u1"),
        ("valid", "u1"),
        ("tries", "u1"),
        ("id", "<u4"),
        ("bits", "<u4"),
        ("flags", "<u4"),
        ("rates", "<u4", 2),
        ("offsets", "<u4", 2),
        ("count", "<u2"),
        ("sent", "u1"),
        ("more", "u1"),
        ("crc", "<u4"),
    ]
)
FD_ERROR_64 = np.dtype(
    [
        ("channel", "u1"),
        ("dlc", "u1"),
        ("valid", "u1"),
        ("code", "u1"),
        ("flags", "<u2"),
        ("codes", "<u2"),
        ("more_flags", "<u2"),
        ("more", "u1"),
        ("_", "u1"),
        ("id", "<u4"),
        ("bits", "<u4"),
        ("rates", "<u4", 2),
        ("offsets", "<u4", 2),
        ("crc", "<u4"),
        ("position", "<u2"),
        ("_2", "<u2"),
    ]
)
WORD = np.frombuffer(SIGNATURE, "<u4")[0]


@dataclass(frozen=True)
class ObjectChain:
    """The objects that lie one after the other in some bytes.

    Attributes:
        starts: (n,) where the complete ones begin.
        gaps: (first, behind the last) byte of what is no object.
        rest: where an object begins that is not complete, or what may be the beginning of one.
        needed: bytes from `rest` on that it takes to go on.
    """

    starts: Positions
    gaps: list[tuple[int, int]]
    rest: int
    needed: int


def chain(octets: Bytes, total: int) -> ObjectChain:
    """The objects in the first `total` bytes of `octets`, which has `SLACK` more."""
    starts = _signatures(octets[:total])
    if len(starts) == 0:
        return _finished([], [], 0, total, starts)
    heads = gather(octets, starts, HEADER)
    ends = starts + heads["size"]
    following = np.searchsorted(starts, ends)
    gap = starts[np.minimum(following, len(starts) - 1)] - ends
    whole = starts + HEADER.itemsize <= total
    broken = _broken(heads) & whole
    next_one = (following == np.arange(1, len(starts) + 1)) & (following < len(starts))
    smooth = next_one & (gap <= PADDING) & ~broken & whole
    breaks = np.flatnonzero(~smooth).tolist()
    runs: list[tuple[int, int]] = []
    gaps: list[tuple[int, int]] = []
    row, end = 0, 0
    while row < len(starts):
        if starts[row] - end > PADDING:
            gaps.append((end, int(starts[row])))
        last = breaks[bisect_left(breaks, row)]
        if broken[last]:
            runs.append((row, last))
            row, end = last + 1, int(starts[last])
        elif ends[last] > total or not whole[last]:
            needed = int(heads["size"][last]) if whole[last] else HEADER.itemsize
            return ObjectChain(_taken(starts, [*runs, (row, last)]), gaps, int(starts[last]), needed)
        else:
            runs.append((row, last + 1))
            row, end = int(following[last]), int(ends[last])
    return _finished(runs, gaps, end, total, starts)


def gather(octets: Bytes, positions: Positions, kind: np.dtype[Any]) -> NDArray[Any]:
    """(n,) the records of this kind that begin at the positions, wherever these lie."""
    count = len(octets) - kind.itemsize + 1
    everywhere = np.ndarray((count,), np.dtype((np.void, kind.itemsize)), octets, strides=(1,))
    return everywhere[positions].view(kind)


class DecodedObjects(NamedTuple):
    """What some objects are.

    Attributes:
        frames: those that could be read.
        skipped: how many objects are no CAN frames.
        short: positions of those that are too short for a frame.
        astray: frames whose channel is 0 or above 256, which count as channel 0.
        filled: frames that hold fewer data bytes than they say, and 0 for the others.
        unknown: version of an object's header that is not known -> positions of the frames that have it.
    """

    frames: Frames
    skipped: int
    short: Positions
    astray: int
    filled: int
    unknown: dict[int, Positions]


def decoded(octets: Bytes, starts: Positions, dated: Dated) -> DecodedObjects:
    """The frames among the objects.

    Args:
        dated: gives POSIX times for seconds since the beginning of the log.
    """
    heads = gather(octets, starts, HEADER)
    frame, known = np.isin(heads["type"], list(KINDS)), np.isin(heads["version"], (1, 2))
    skipped = len(starts) - int(np.count_nonzero(frame))
    strange = frame & ~known
    unknown = {
        int(version): starts[strange & (heads["version"] == version)] for version in set(heads["version"][strange])
    }
    if skipped or unknown:
        starts, heads = starts[frame & known], heads[frame & known]
    bodies = starts + np.where(heads["version"] == 1, 32, 40)
    short = heads["size"] < bodies - starts + _least(heads["type"])
    lost = starts[short]
    if len(lost):
        starts, heads, bodies = starts[~short], heads[~short], bodies[~short]
    frames, astray, filled = _frames(Objects(octets, starts, heads, bodies), dated)
    return DecodedObjects(frames, skipped, lost, astray, filled, unknown)


class Objects(NamedTuple):
    """Objects of frames: their bytes, where they and their bodies begin, and their heads."""

    octets: Bytes
    starts: Positions
    heads: NDArray[Any]
    bodies: Positions

    def of(self, rows: Positions) -> Objects:
        """Only these."""
        return Objects(self.octets, self.starts[rows], self.heads[rows], self.bodies[rows])


class FrameColumns(NamedTuple):
    """Columns of frames without their stamps; a channel counts from 1, `data` may go on beyond a frame's length.

    `filled` counts those whose object ends before their data do.
    """

    id: NDArray[np.uint32]
    flags: NDArray[Any]
    channel: NDArray[Any]
    length: NDArray[Any]
    data: Bytes
    filled: int = 0


def _signatures(octets: Bytes) -> Positions:
    found = []
    for shift in range(min(4, len(octets))):
        words = octets[shift : shift + (len(octets) - shift) // 4 * 4].view("<u4")
        found.append(np.flatnonzero(words == WORD) * 4 + shift)
    return np.sort(np.concatenate(found), kind="stable") if found else np.empty(0, np.int64)


def _broken(heads: NDArray[Any]) -> BoolArray:
    most = np.where(np.isin(heads["type"], list(KINDS)), MAX_FRAME, MAX_OBJECT)
    return (heads["size"] < HEADER.itemsize) | (heads["size"] > most)


def _taken(starts: Positions, runs: list[tuple[int, int]]) -> Positions:
    return np.concatenate([starts[first:behind] for first, behind in runs]) if runs else starts[:0]


def _finished(
    runs: list[tuple[int, int]], gaps: list[tuple[int, int]], end: int, total: int, starts: Positions
) -> ObjectChain:
    """The chain once there is no further signature; the last bytes may be the first of one."""
    rest = min(total, max(end, total - len(SIGNATURE) + 1))
    if rest - end > PADDING:
        gaps.append((end, rest))
    else:
        rest = min(end, total)
    return ObjectChain(_taken(starts, runs), gaps, rest, total - rest + 1)


def _least(types: NDArray[Any]) -> NDArray[np.int64]:
    least = np.zeros(256, np.int64)
    for number, (layout, _) in KINDS.items():
        least[number] = layout.itemsize
    return np.asarray(least[types])


def _frames(objects: Objects, dated: Dated) -> tuple[Frames, int, int]:
    count = len(objects.starts)
    told = gather(objects.octets, objects.starts + HEADER.itemsize, STAMP)
    time = dated(told["time"] / np.where(told["flags"] == TEN_MICROSECONDS, 1e5, 1e9))
    types = objects.heads["type"]
    parts = [
        (rows, KINDS[kind][1](objects.of(rows)))
        for kind in np.unique(types).tolist()
        for rows in [np.flatnonzero(types == kind)]
    ]
    wide = any(np.any(part.length[part.flags & Flag.REMOTE == 0] > CLASSIC) for _, part in parts)
    flags, channel, length = (np.zeros(count, np.uint8) for _ in range(3))
    data = np.zeros((count, LONGEST if wide else CLASSIC), np.uint8)
    found = Frames(time, np.zeros(count, np.uint32), flags, channel, length, data)
    astray = 0
    for rows, part in parts:
        found.id[rows] = part.id & 0x1FFFFFFF
        found.flags[rows] = part.flags | Flag.EXTENDED * (part.id >> 31)
        number = part.channel.astype(np.int64) - 1
        outside = (number < 0) | (number > 255)
        found.channel[rows] = np.where(outside, 0, number)
        astray += int(np.count_nonzero(outside))
        found.length[rows] = part.length
        width = min(part.data.shape[1], found.data.shape[1])
        bytes_there = np.where(part.flags & Flag.REMOTE, 0, part.length)
        found.data[rows, :width] = part.data[:, :width] * (np.arange(width) < bytes_there[:, None])
    return found, astray, sum(part.filled for _, part in parts)


def _message(objects: Objects) -> FrameColumns:
    raw = gather(objects.octets, objects.bodies, MESSAGE)
    flags = _where(raw["flags"] & 0x80, Flag.REMOTE) | _where(raw["flags"] & 1, Flag.SENT)
    length = np.where(flags & Flag.REMOTE, raw["dlc"], np.minimum(raw["dlc"], CLASSIC))
    return FrameColumns(raw["id"], flags, raw["channel"], length, raw["data"])


def _error(objects: Objects) -> FrameColumns:
    raw = gather(objects.octets, objects.bodies, ERROR)
    nothing = np.zeros(len(raw), np.uint8)
    return FrameColumns(
        nothing.astype(np.uint32),
        nothing + np.uint8(Flag.ERROR),
        raw["channel"],
        nothing,
        np.zeros((len(raw), CLASSIC), np.uint8),
    )


def _error_ext(objects: Objects) -> FrameColumns:
    raw = gather(objects.octets, objects.bodies, ERROR_EXT)
    flags = np.full(len(raw), Flag.ERROR, np.uint8)
    return FrameColumns(raw["id"], flags, raw["channel"], np.minimum(raw["dlc"], CLASSIC), raw["data"])


def _fd(objects: Objects) -> FrameColumns:
    raw = gather(objects.octets, objects.bodies, FD)
    fd = raw["fd"]
    flags = (
        _where(raw["flags"] & 0x80, Flag.REMOTE)
        | _where(raw["flags"] & 1, Flag.SENT)
        | _where(fd & 1, Flag.FD)
        | _where(fd & 2, Flag.BITRATE_SWITCH)
        | _where(fd & 4, Flag.ERROR_STATE)
    )
    valid = np.minimum(raw["valid"], LONGEST)
    length = np.where(flags & Flag.REMOTE, LENGTHS[np.minimum(raw["dlc"], 15)], valid)
    return FrameColumns(raw["id"], flags, raw["channel"], length, raw["data"])


def _fd_64(objects: Objects) -> FrameColumns:
    raw = gather(objects.octets, objects.bodies, FD_64)
    told = raw["flags"]
    flags = (
        _where(told & 0x10, Flag.REMOTE)
        | _where(raw["sent"], Flag.SENT)
        | _where(told & 0x1000, Flag.FD)
        | _where(told & 0x2000, Flag.BITRATE_SWITCH)
        | _where(told & 0x4000, Flag.ERROR_STATE)
    )
    valid = np.minimum(raw["valid"], LONGEST)
    behind = np.where(raw["more"], raw["more"], objects.heads["size"]).astype(np.int64)
    data, filled = _following(objects, FD_64, behind, np.where(flags & Flag.REMOTE, 0, valid))
    length = np.where(flags & Flag.REMOTE, LENGTHS[np.minimum(raw["dlc"], 15)], valid)
    return FrameColumns(raw["id"], flags, raw["channel"], length, data, filled)


def _fd_error_64(objects: Objects) -> FrameColumns:
    raw = gather(objects.octets, objects.bodies, FD_ERROR_64)
    flags = np.full(len(raw), Flag.ERROR, np.uint8)
    behind = np.where(raw["more"], raw["more"], objects.heads["size"]).astype(np.int64)
    length = np.minimum(raw["valid"], LONGEST)
    data, _ = _following(objects, FD_ERROR_64, behind, length)
    return FrameColumns(raw["id"], flags, raw["channel"], length, data)


def _following(objects: Objects, kind: np.dtype[Any], behind: Positions, valid: Bytes) -> tuple[Bytes, int]:
    """Data of what follows the records of a kind, as far as an object goes, and how many objects end before."""
    there = np.clip(behind - (objects.bodies - objects.starts) - kind.itemsize, 0, valid)
    data = gather(objects.octets, objects.bodies + kind.itemsize, np.dtype([("data", "u1", LONGEST)]))["data"]
    return data * (np.arange(LONGEST) < there[:, None]), int(np.count_nonzero(there < valid))


def _where(bits: NDArray[Any], flag: Flag) -> Bytes:
    return np.asarray((bits != 0) * np.uint8(flag))


KINDS: dict[int, tuple[np.dtype[Any], Callable[[Objects], FrameColumns]]] = {
    CAN_MESSAGE: (MESSAGE, _message),
    CAN_MESSAGE2: (MESSAGE, _message),
    CAN_ERROR: (ERROR, _error),
    CAN_ERROR_EXT: (ERROR_EXT, _error_ext),
    CAN_FD_MESSAGE: (FD, _fd),
    CAN_FD_MESSAGE_64: (FD_64, _fd_64),
    CAN_FD_ERROR_64: (FD_ERROR_64, _fd_error_64),
}
