"""Serial adapters and the bus between them, without ports: what a stand-in for hardware does with lines and time.

A bus of adapters carries one frame after the other, the one of highest priority first, each for as long as its bits
take. An adapter that is set to another bit rate hears errors instead of frames, and what it sends is lost.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from orchestrator.can import frame_time
from orchestrator.can.slcan import protocol

QUEUE = 256  # frames that an adapter keeps until the bus is free; it reads no more then
BACKLOG = 65536  # bytes that an adapter keeps until its port takes them; frames are lost then
_WARNING, _PASSIVE, _BUS_OFF = 96, 128, 256  # error counters at which an adapter changes its state
_FILLER = b"t0008FFFFFFFFFFFFFFFF"  # the frame of highest priority
_FLAGS = {"e": 0x80, "o": 0x08, "p": 0x20, "w": 0x04}  # what F tells: bus error, overrun, passive, warning


class Queued(NamedTuple):
    """A frame that waits for the bus: its line with its end, since when, for how long it takes the bus."""

    line: bytes
    priority: int
    arrived: float
    duration: float
    fd: bool


@dataclass
class BitRates:
    """Bit rates of a bus or of an adapter; None: not set [bit/s]."""

    nominal: int | None
    data: int | None = None


class SerialAdapter:
    """What a LAWICEL adapter does with commands from its port and frames from the bus.

    Attributes:
        outgoing: what it has to say and the port has not taken yet.
        filler: the frame that is sent again whenever the bus is free, None where there is none.
        lost: frames from the bus that the port was too slow for.
        ignored: commands and frames that were answered with BEL.
    """

    def __init__(self, bus: BitRates, paced: bool = True) -> None:
        self._bus, self._paced = bus, paced
        self.rates = BitRates(bus.nominal)
        self.open = self.listens_only = self.off = False
        self.queue: deque[Queued] = deque()
        self.filler: Queued | None = None
        self.outgoing = bytearray()
        self.sent = self.heard = self.lost = self.ignored = 0
        self._partial = b""
        self._sending_errors = self._receiving_errors = 0
        self._state, self._flags, self._overrun = "a", 0, False

    @property
    def full(self) -> bool:
        """Whether it takes no more from its port for now."""
        return len(self.queue) >= QUEUE

    @property
    def matches(self) -> bool:
        """Whether it is at the bit rate of the bus."""
        return self.rates.nominal == self._bus.nominal and self.rates.data in (None, self._bus.data)

    def take(self, data: bytes, now: float) -> bool:
        """Act on bytes from the port; whether the application has just closed or opened the bus."""
        lines = (self._partial + data).split(protocol.END)
        self._partial = lines.pop()[-protocol.LONGEST :]
        changed = False
        for line in lines:
            was = self.open
            answer = self._answer(line, now)
            if len(self.outgoing) <= BACKLOG:
                self.outgoing += answer
            changed |= was is not self.open
        return changed

    def _answer(self, line: bytes, now: float) -> bytes:
        frame = protocol.parse(line)
        if frame is not None:
            return self._enqueue(line, frame, now)
        answer = self._command(line.decode("ascii", "replace"))
        self.ignored += answer == protocol.BELL
        return answer

    def _enqueue(self, line: bytes, frame: protocol.FrameLine, now: float) -> bytes:
        if not self.open or self.listens_only or self.off or (frame.fd and self.rates.data is None):
            self.ignored += 1
            return protocol.BELL
        duration = 0.0
        if self._paced:
            data_rate = self._bus.data if frame.switched else None
            duration = frame_time.seconds(
                frame.length, frame.extended, frame.remote, frame.fd, self._bus.nominal or 1, data_rate
            )
        order = frame_time.priority(frame.identifier, frame.extended, frame.remote)
        self.queue.append(Queued(line + protocol.END, order, now, duration, frame.fd))
        return b"Z\r" if frame.extended else b"z\r"

    def _command(self, text: str) -> bytes:
        if text == "C":
            self._close()
        elif text in ("O", "L") and not self.open:
            self.open, self.listens_only = True, text == "L"
        elif text in protocol.BITRATES and not self.open:
            self.rates = BitRates(protocol.BITRATES[text])
        elif text in protocol.DATA_BITRATES and not self.open:
            self.rates.data = protocol.DATA_BITRATES[text]
        elif text == "F" and self.open:
            flags, self._flags = self._flags, 0
            return b"F%02X\r" % flags
        elif text in ("V", "N"):
            return {"V": b"V1013\r", "N": b"NSTWN\r"}[text]
        elif text[:1] not in ("", "Z", "X", "M", "m", "W", "U", "Q"):  # time stamps, filters: taken and left alone
            return protocol.BELL
        return protocol.END

    def _close(self) -> None:
        self.open = self.off = False
        self.queue.clear()
        self.outgoing.clear()
        self._sending_errors = self._receiving_errors = 0
        self._state, self._flags, self._overrun = "a", 0, False

    def hear(self, frame: Queued) -> None:
        """A frame of somebody else has passed on the bus."""
        if not self.open or self.off:
            return
        if not self.matches or (frame.fd and self.rates.data is None):
            self._receiving_errors = min(self._receiving_errors + 1, _PASSIVE + 7)
            self._fail("s")
        elif len(self.outgoing) > BACKLOG:
            self.lost += 1
            self._overrun = True
            self._flags |= _FLAGS["o"]
        else:
            if self._overrun:
                self._overrun = False
                self.outgoing += b"e1o\r"
            self.heard += 1
            self.outgoing += frame.line

    def drop(self, frame: Queued) -> None:
        """Its own frame could not be sent: it is at another bit rate than the others."""
        self._sending_errors += 8
        self._fail("b")

    def fill(self, now: float) -> None:
        """Be open, and leave no time on the bus to others until `spare`, however seldom somebody looks."""
        self._close()
        self.rates, self.open, self.listens_only = BitRates(self._bus.nominal), True, False
        self.take(_FILLER + protocol.END, now)
        self.filler = self.queue[0]

    def spare(self) -> None:
        """Leave the bus to others again."""
        self.filler = None
        self.queue.clear()

    def go_off(self) -> None:
        """Leave the bus as after too many errors; only closing and opening it again helps."""
        self._sending_errors = _BUS_OFF
        self._enter_state()

    def _fail(self, letter: str) -> None:
        self._flags |= _FLAGS["e"]
        self._say(f"e1{letter}")
        self._enter_state()

    def _enter_state(self) -> None:
        worst = max(self._sending_errors, self._receiving_errors)
        reached = ((_BUS_OFF, "b"), (_PASSIVE, "p"), (_WARNING, "w"), (0, "a"))
        state = next(letter for limit, letter in reached if worst >= limit)
        if state == self._state:
            return
        self._state = state
        self._flags |= _FLAGS.get(state, 0)
        self._say(f"s{state}{self._receiving_errors:03d}{self._sending_errors:03d}")
        if state == "b":
            self.off = True
            self.queue.clear()

    def _say(self, text: str) -> None:
        if len(self.outgoing) <= BACKLOG:
            self.outgoing += text.encode() + protocol.END


class AdapterBus:
    """Carries the frames of its adapters, one after the other.

    Attributes:
        busy: how long frames have kept the bus busy [s].
        frames: how many have passed.
    """

    def __init__(self, adapters: Sequence[SerialAdapter]) -> None:
        self.adapters = list(adapters)
        self.busy, self.frames = 0.0, 0
        self._free = 0.0  # when the latest frame ended
        self._now: tuple[float, SerialAdapter, Queued] | None = None  # the frame on the bus and when it ends

    def advance(self, now: float) -> float | None:
        """Let pass what ends by now; when the next frame ends, None where none is on the bus."""
        while True:
            if self._now is None and not self._start():
                return None
            assert self._now is not None
            end, sender, frame = self._now
            if end > now:
                return end
            self._free, self._now = end, None
            self._finish(sender, frame)

    def _start(self) -> bool:
        """Put the frame on the bus that goes first among those which wait when it is free."""
        first = [adapter.queue[0] for adapter in self.adapters if adapter.queue]
        if not first:
            return False
        begin = max(self._free, min(frame.arrived for frame in first))
        waiting = [adapter for adapter in self.adapters if adapter.queue and adapter.queue[0].arrived <= begin]
        sender = min(waiting, key=lambda adapter: adapter.queue[0].priority)
        frame = sender.queue.popleft()
        if sender.filler is not None:
            sender.queue.append(sender.filler._replace(arrived=begin))
        self._now = begin + frame.duration, sender, frame
        return True

    def _finish(self, sender: SerialAdapter, frame: Queued) -> None:
        if not sender.open:
            return
        if not sender.matches:
            sender.drop(frame)
            return
        self.frames += 1
        self.busy += frame.duration
        sender.sent += 1
        for adapter in self.adapters:
            if adapter is not sender:
                adapter.hear(frame)
