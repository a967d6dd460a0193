"""BLF logs written many frames at once: records of each kind laid into place, then cut into compressed containers."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from orchestrator.can.frames import CLASSIC, LENGTHS, LONGEST, Flag, Frames, since
from orchestrator.can.logs.blf import objects

CONTAINER = 1 << 17  # bytes of objects in one, as Vector's tools make them
FIRST_CALENDAR = 631152000.0  # [s] 1990; stamps before it are no dates, and count from 0
FILE_HEADER = struct.Struct("<4sL8BQQLL8H8H72x")
CONTAINER_HEAD = struct.Struct("<4sHHLLHxxxxxxLxxxx")
APPLICATION, VERSION = (5, 0, 0, 0), (2, 6, 8, 1)  # as python-can says
NANOSECONDS, DEFLATED = 2, 2
LONGEST_SPAN = 9e9  # [s] from the first frame to the last, in nanoseconds
BODIES = {
    objects.CAN_MESSAGE: objects.MESSAGE,
    objects.CAN_ERROR_EXT: objects.ERROR_EXT,
    objects.CAN_FD_MESSAGE: objects.FD,
}
KINDS = {  # whole objects
    kind: np.dtype([("head", objects.HEADER), ("at", objects.STAMP), ("body", body)]) for kind, body in BODIES.items()
}
CODES = np.zeros(LONGEST + 1, np.uint8)  # length code of so many data bytes
CODES[LENGTHS] = np.arange(16)
CODES = np.maximum.accumulate(CODES)


def fill(file: BinaryIO, batches: Iterable[Frames]) -> int:
    """Number of frames that were written into the file."""
    file.write(_file_header(0, 0, 0, 0.0, 0.0))
    start, last, count, size, rest = None, 0.0, 0, FILE_HEADER.size, b""
    for batch in batches:
        if not len(batch):
            continue
        if start is None:
            start = _start(float(batch.time[0]))
        rest += _objects(batch, start)
        count, last = count + len(batch), float(batch.time[-1])
        whole = len(rest) // CONTAINER * CONTAINER
        size += sum(_write(file, rest[place : place + CONTAINER]) for place in range(0, whole, CONTAINER))
        rest = rest[whole:]
    if rest:
        size += _write(file, rest)
    end = file.tell()
    file.seek(0)
    file.write(_file_header(end, size, count, start or 0.0, last))
    file.seek(end)
    return count


def _start(first: float) -> float:
    """The beginning of the log, in whole milliseconds as the header has it [s]."""
    return int(first * 1000) / 1000 if first >= FIRST_CALENDAR else 0.0


def _objects(frames: Frames, start: float) -> bytes:
    """The frames' objects in a row."""
    if not np.all(np.abs(frames.time - start) < LONGEST_SPAN):
        raise ValueError("centuries apart")
    error, fd = frames.has(Flag.ERROR), frames.has(Flag.FD)
    kinds = np.where(error, objects.CAN_ERROR_EXT, np.where(fd, objects.CAN_FD_MESSAGE, objects.CAN_MESSAGE))
    sizes = np.zeros(len(frames), np.int64)
    for kind, layout in KINDS.items():
        sizes[kinds == kind] = layout.itemsize
    ends = np.cumsum(sizes)
    content = np.zeros(int(ends[-1]), np.uint8)
    for kind, layout in KINDS.items():
        rows = np.flatnonzero(kinds == kind)
        if len(rows):
            form = np.dtype((np.void, layout.itemsize))
            everywhere = np.ndarray((len(content) - layout.itemsize + 1,), form, content, strides=(1,))
            everywhere[(ends - sizes)[rows]] = _records(frames[rows], kind, layout, start).view(form)
    return content.tobytes()


def _records(frames: Frames, kind: int, layout: np.dtype[Any], start: float) -> NDArray[Any]:
    records = np.zeros(len(frames), layout)
    head, at, body = records["head"], records["at"], records["body"]
    head["signature"], head["header"], head["version"] = objects.WORD, 32, 1
    head["size"], head["type"] = layout.itemsize, kind
    at["flags"], at["time"] = NANOSECONDS, np.maximum(0.0, np.rint(since(start, frames.time) * 1e9))
    body["channel"] = frames.channel.astype(np.uint16) + 1
    body["id"] = frames.id | np.where(frames.has(Flag.EXTENDED), np.uint32(1 << 31), np.uint32(0))
    body["dlc"] = frames.length if kind != objects.CAN_FD_MESSAGE else CODES[np.minimum(frames.length, LONGEST)]
    width = min(frames.data.shape[1], CLASSIC if kind != objects.CAN_FD_MESSAGE else LONGEST)
    body["data"][:, :width] = frames.data[:, :width]
    if kind != objects.CAN_ERROR_EXT:
        body["flags"] = np.where(frames.has(Flag.REMOTE), 0x80, 0) | frames.has(Flag.SENT)
    if kind == objects.CAN_FD_MESSAGE:
        body["valid"] = np.where(frames.has(Flag.REMOTE), 0, frames.length)
        switched, state = frames.has(Flag.BITRATE_SWITCH), frames.has(Flag.ERROR_STATE)
        body["fd"] = 1 | np.where(switched, 2, 0) | np.where(state, 4, 0)
    return records


def _write(file: BinaryIO, content: bytes) -> int:
    """Write a container; its uncompressed size with its head."""
    packed = zlib.compress(content)
    size = CONTAINER_HEAD.size + len(packed)
    head = CONTAINER_HEAD.pack(objects.SIGNATURE, 16, 1, size, objects.LOG_CONTAINER, DEFLATED, len(content))
    file.write(head + packed + bytes(size % 4))
    return CONTAINER_HEAD.size + len(content)


def _file_header(end: int, size: int, count: int, first: float, last: float) -> bytes:
    return FILE_HEADER.pack(
        b"LOGG",
        FILE_HEADER.size,
        *APPLICATION,
        *VERSION,
        end,
        size,
        count,
        0,
        *_system_time(first),
        *_system_time(last),
    )


def _system_time(stamp: float) -> tuple[int, ...]:
    if stamp < FIRST_CALENDAR:
        return (0,) * 8
    time = datetime.fromtimestamp(round(stamp, 3), UTC)
    day = time.isoweekday() % 7
    return (time.year, time.month, day, time.day, time.hour, time.minute, time.second, time.microsecond // 1000)
