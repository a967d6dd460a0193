"""BLF, Vector's binary log: a header, then containers of compressed objects that may go on in the next container.

What is broken costs its own bytes only: reading goes on at the next object's signature.
"""

from __future__ import annotations

import struct
import zlib
from bisect import bisect_right
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from orchestrator.can.frames import Frames
from orchestrator.can.logs.blf.objects import LOG_CONTAINER, PADDING, SIGNATURE, SLACK, chain, decoded
from orchestrator.can.logs.findings import Findings

FILE_HEADER = struct.Struct("<4sL8xQ16x8H8H")  # signature, sizes of header and file, first and last time
OBJECT = struct.Struct("<4sHHLL")  # signature, size of the header, its version, size, type
CONTAINER = struct.Struct("<H6xL4x")  # compression, size of the content
STORED, DEFLATED = 0, 2
MAX_CONTAINER = 1 << 25  # bytes of a container's content, compressed or not
GATHERED = 1 << 21  # bytes of objects that are decoded at once
STEP = 256  # bytes in which a broken container is taken apart
BLOCK = 1 << 20  # bytes that are searched at once


class ContainerContent(NamedTuple):
    """What a container holds; `broken` says that it is not all of it."""

    offset: int
    data: bytes
    broken: bool


def frames(path: Path, findings: Findings) -> Iterator[tuple[Frames, float]]:
    """The frames in batches of any size, in the order of the file, and the share of it that is read by then."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = _header(file, findings)
        stream = ObjectStream(head.origin, findings)
        for content in _contents(file, head.size, size, findings):
            for batch in stream.feed(content):
                yield batch, min(1.0, file.tell() / size)
        for batch in stream.end():
            yield batch, 1.0
    if head.file_size > size and not findings.damaged:
        findings.add(size, f"the file ends here, its header says after {head.file_size} bytes")


class ObjectStream:
    """Objects across containers: bytes go in, frames come out as soon as there are enough."""

    def __init__(self, origin: float, findings: Findings) -> None:
        self.origin, self.findings = origin, findings
        self._parts: list[bytes] = []
        self._places: list[int] = []  # offset in the file of each part's container
        self._held, self._needed = 0, GATHERED
        self._after_damage = False

    def feed(self, content: ContainerContent) -> Iterator[Frames]:
        """The frames that are complete with this content."""
        self._parts.append(content.data)
        self._places.append(content.offset)
        self._held += len(content.data)
        if content.broken:
            yield from self._flush()
            self._parts, self._places, self._held, self._after_damage = [], [], 0, True
        elif self._held >= self._needed:
            yield from self._flush()

    def end(self) -> Iterator[Frames]:
        """The last frames."""
        yield from self._flush()
        if self._held > PADDING:
            self.findings.add(self._places[0], f"an object is cut off after {self._held} bytes")

    def _flush(self) -> Iterator[Frames]:
        if not self._held:
            return
        octets = np.frombuffer(b"".join([*self._parts, bytes(SLACK)]), np.uint8)
        found = chain(octets, self._held)
        place = self._locator()
        for first, behind in found.gaps:
            if first or not self._after_damage:  # what follows damage is the rest of an object that was in it
                self.findings.add(place(first), f"{behind - first} bytes of this container's content are no objects")
        self._after_damage = False
        taken, skipped, short, astray, filled, unknown = decoded(
            octets, found.starts, partial(self.findings.dated, self.origin)
        )
        self.findings.skipped += skipped
        if astray:
            self.findings.note("frames name channel 0 or one above 256, and count as channel 0 like those of the first")
        if filled:
            self.findings.note("frames hold fewer data bytes than they say, and 0 for the others")
        for position in short.tolist():
            self.findings.add(place(position), "a frame of this container is too short for its kind")
        for version, positions in unknown.items():
            problem = f"{len(positions)} CAN frames have an object header of version {version}, which is not known"
            self.findings.add(place(int(positions[0])), problem)
        rest = octets[found.rest : self._held].tobytes()
        self._parts, self._places, self._held = [rest], [place(found.rest)], len(rest)
        self._needed = max(GATHERED, found.needed)
        if len(taken):
            yield taken

    def _locator(self) -> Callable[[int], int]:
        """From positions in what is held to the offsets of their containers."""
        begins = np.cumsum([0, *map(len, self._parts[:-1])]).tolist()
        places = self._places
        return lambda position: places[bisect_right(begins, position) - 1]


class Header(NamedTuple):
    """Bytes of the header and of the whole file, and the POSIX time of the beginning (0 where it is not known)."""

    size: int
    file_size: int
    origin: float


def _header(file: BinaryIO, findings: Findings) -> Header:
    raw = file.read(FILE_HEADER.size)
    if len(raw) < FILE_HEADER.size or not raw.startswith(b"LOGG"):
        findings.add(0, "this is no header of a BLF file, the time of the beginning is not known")
        return Header(0, 0, 0.0)
    _, size, file_size, *times = FILE_HEADER.unpack(raw)
    if not FILE_HEADER.size <= size <= MAX_CONTAINER:
        findings.add(4, f"the header claims {size} bytes")
        size = FILE_HEADER.size
    origin = _posix(times[:8])
    findings.zoneless = origin != 0
    return Header(size, file_size, origin)


def _posix(time: list[int]) -> float:
    year, month, _, day, hour, minute, second, millisecond = time
    try:
        return datetime(year, month, day, hour, minute, second, millisecond * 1000, UTC).timestamp()
    except ValueError:
        return 0.0


def _contents(file: BinaryIO, begin: int, size: int, findings: Findings) -> Iterator[ContainerContent]:
    """What the containers hold, in a row; objects outside of containers as they are.

    Args:
        size: of the file; what a recorder has added since is not looked at.
    """
    place = begin
    while place < size:
        start = _next_signature(file, place, size)
        if (size if start is None else start) - place > PADDING:
            findings.add(place, f"{(size if start is None else start) - place} bytes are no objects")
        if start is None:
            return
        file.seek(start)
        head = file.read(OBJECT.size)
        if len(head) < OBJECT.size or start + OBJECT.size > size:
            findings.add(start, "the file ends inside an object")
            return
        _, _, _, length, kind = OBJECT.unpack(head)
        if not OBJECT.size <= length <= MAX_CONTAINER:
            findings.add(start, f"an object claims {length} bytes")
            yield ContainerContent(start, b"", True)
            place = start + OBJECT.size
            continue
        place = start + length
        cut = place > size
        if cut:
            follower = _next_signature(file, start + OBJECT.size, size)
            place = size if follower is None else follower
            findings.add(
                start,
                "the file ends inside this object"
                if follower is None
                else f"an object claims {length} bytes, the next begins after {place - start}",
            )
        file.seek(start + OBJECT.size)
        body = file.read(place - start - OBJECT.size)
        if kind == LOG_CONTAINER:
            yield _opened(start, body, cut, findings)
        else:
            yield ContainerContent(start, head + body, cut)


def _opened(offset: int, body: bytes, cut: bool, findings: Findings) -> ContainerContent:
    if len(body) < CONTAINER.size:
        if not cut:
            findings.add(offset, "a container has no room for its header")
        return ContainerContent(offset, b"", True)
    method, announced = CONTAINER.unpack_from(body)
    packed = body[CONTAINER.size :]
    if method == STORED:
        return ContainerContent(offset, packed, cut)
    if method != DEFLATED:
        findings.add(offset, f"a container is compressed in an unknown way ({method})")
        return ContainerContent(offset, b"", True)
    data, problem = _inflated(packed)
    if problem and not cut:
        findings.add(offset, f"a container {problem}; {len(data)} of its {announced} bytes could be had")
    return ContainerContent(offset, data, cut or bool(problem))


def _inflated(packed: bytes) -> tuple[bytes, str]:
    """What the compressed bytes hold, and what is wrong with them."""
    inflater = zlib.decompressobj()
    try:
        data = inflater.decompress(packed, MAX_CONTAINER)
    except zlib.error:
        return _salvaged(packed), "is damaged"
    if inflater.unconsumed_tail:
        return data, "holds far more than a container does"
    return data, "" if inflater.eof else "is cut off"


def _salvaged(packed: bytes) -> bytes:
    """What can be decompressed before the damage."""
    inflater, parts, held = zlib.decompressobj(), [], 0
    try:
        for place in range(0, len(packed), STEP):
            parts.append(inflater.decompress(packed[place : place + STEP], MAX_CONTAINER - held))
            held += len(parts[-1])
            if held >= MAX_CONTAINER:
                break
    except zlib.error:
        pass
    return b"".join(parts)


def _next_signature(file: BinaryIO, place: int, size: int) -> int | None:
    """Where the next object begins at or after a place, its signature before `size`."""
    length = len(SIGNATURE) + PADDING  # in a sound file it is here
    while True:
        file.seek(place)
        read = file.read(length)
        found = read.find(SIGNATURE)
        if found >= 0:
            return place + found if place + found + len(SIGNATURE) <= size else None
        if len(read) < length:
            return None
        place, length = place + length - len(SIGNATURE) + 1, min(BLOCK, 8 * length)
