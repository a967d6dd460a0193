"""Messages of more than 8 bytes that come in J1939's transport protocol, put together again from their frames.

SAE J1939-21, 5.10: a broadcast announcement (BAM) or a request to send (RTS) says how many packets follow and what
they are; each data frame brings 7 bytes. ISO 11783-3, 5.12: what is longer than 1785 bytes goes by the extended
protocol, whose sender says before each group of packets how many precede it (DPO).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from orchestrator.can.frames import Flag, Frames
from orchestrator.trace import BoolArray, Bytes

CONNECTION, DATA = 0xEC, 0xEB  # formats (PF) of the two kinds of frames
LONG_CONNECTION, LONG_DATA = 0xC8, 0xC7  # of the extended protocol
RTS, LONG_RTS, DPO, BAM, ABORT = 16, 20, 22, 32, 255
PATIENCE = 1.25  # [s] between two frames; T2 and T3 of the standard
MOST = 4096  # messages under way at once


@dataclass(frozen=True)
class Packet:
    """A message that came in parts: the stamp of its last [s], the identifier that it would have as one frame."""

    time: float
    channel: int
    identifier: int
    data: bytes


@dataclass
class _TransportSession:
    identifier: int
    size: int
    latest: float
    parts: dict[int, bytes] = field(default_factory=dict)
    offset: int = 0  # packets before those that come now

    @property
    def complete(self) -> bool:
        return 7 * len(self.parts) >= self.size


Key = tuple[int, int, int, bool]  # channel, source, destination, whether by the extended protocol


@dataclass
class Transport:
    """Puts messages together, batch after batch.

    Attributes:
        broken: messages of which a part is missing, that were given up, or whose announcement is none.
    """

    broken: int = 0
    _sessions: dict[Key, _TransportSession] = field(default_factory=dict)

    @property
    def unfinished(self) -> int:
        """Messages under way."""
        return len(self._sessions)

    def feed(self, frames: Frames) -> list[Packet]:
        """The messages that these frames complete; frames of other kinds are passed over."""
        return list(self._packets(frames[is_transport(frames)]))

    def _packets(self, frames: Frames) -> Iterator[Packet]:
        columns = (frames.time.tolist(), frames.channel.tolist(), frames.id.tolist(), frames.data)
        for time, channel, identifier, data in zip(*columns, strict=True):
            kind = identifier >> 16 & 0xFF
            key = channel, identifier & 0xFF, identifier >> 8 & 0xFF, kind in (LONG_CONNECTION, LONG_DATA)
            if kind in (CONNECTION, LONG_CONNECTION):
                self._connect(key, time, data[:8].tobytes())
            elif packet := self._take(key, time, data[:8].tobytes()):
                yield packet

    def _connect(self, key: Key, time: float, data: bytes) -> None:
        channel, source, destination, long = key
        if data[0] == ABORT:
            self._give_up(key)
            self._give_up((channel, destination, source, long))
        session = self._sessions.get(key)
        if long and data[0] == DPO and session is not None:
            session.offset, session.latest = int.from_bytes(data[2:5], "little"), time
        if data[0] not in ((LONG_RTS,) if long else (RTS, BAM)):
            return
        self._give_up(key)
        size, group = int.from_bytes(data[1 : 5 if long else 3], "little"), int.from_bytes(data[5:8], "little")
        wrong = not size if long else data[3] != -(-size // 7)
        if group >> 18 or wrong or len(self._sessions) >= MOST:
            self.broken += 1
            return
        to = destination if group >> 8 & 0xFF < 240 else 0
        self._sessions[key] = _TransportSession(6 << 26 | (group | to) << 8 | source, size, time)

    def _take(self, key: Key, time: float, data: bytes) -> Packet | None:
        session = self._sessions.get(key)
        if session is None:
            return None
        if abs(time - session.latest) > PATIENCE:
            self._give_up(key)
            return None
        session.latest = time
        if data[0] and (number := session.offset + data[0]) <= -(-session.size // 7):
            session.parts[number] = data[1:]
        if not session.complete:
            return None
        del self._sessions[key]
        whole = b"".join(part for _, part in sorted(session.parts.items()))
        return Packet(time, key[0], session.identifier, whole[: session.size])

    def _give_up(self, key: Key) -> None:
        self.broken += self._sessions.pop(key, None) is not None


def is_transport(frames: Frames) -> BoolArray:
    """(K,) which frames are of the transport protocol."""
    kind = frames.id >> np.uint32(16) & np.uint32(0x3FF)  # on data page 0
    of_kind = np.isin(kind, (CONNECTION, DATA, LONG_CONNECTION, LONG_DATA))
    return np.asarray(frames.has(Flag.EXTENDED) & of_kind & (frames.length == 8), np.bool_)


def frames_of(packets: list[Packet], length: NDArray[np.int64], data: Bytes) -> Frames:
    """The messages as if they had come as one frame each, of these lengths (K,) with data (K, n)."""
    return Frames(
        np.array([packet.time for packet in packets], np.float64),
        np.array([packet.identifier for packet in packets], np.uint32),
        np.full(len(packets), Flag.EXTENDED, np.uint8),
        np.array([packet.channel for packet in packets], np.uint8),
        length,  # type: ignore[arg-type]  # more than a byte holds
        data,
    )
