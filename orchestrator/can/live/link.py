"""A bus that is kept while something runs on it: what gets out is counted, a loss is told, and mended where it may be.

One thread receives, another may send. It is the receiving one that opens the bus again.
"""

from __future__ import annotations

import contextlib
import errno
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import can

from fmus.errors import BusError
from fmus.words import complaint
from orchestrator.can.frames import moment
from orchestrator.can.live.bus import BusSettings, is_bus_off, occupied, open_bus
from orchestrator.can.slcan.flow import Key

BUS_OFF = "the adapter has left the bus (bus off)"
REFUSING = "the adapter refuses all frames"
_RETRY = 1.0  # between two tries to open a lost bus [s]
_NAP = 0.005  # while an adapter has no room [s]
_SAID = 50  # losses that are said; beyond it they are only counted
_KEPT = 1000  # losses that are kept
ECHOING = ("udp_multicast",)  # interfaces that give back what is sent to them, and do not say so
_ECHOED = 1.0  # for which an own frame may come back [s]
_FULL = (errno.ENOBUFS, errno.EAGAIN)
_FULL_WORDS = ("full", "overflow", "no buffer space", "timed out", "timeout")  # of drivers that give no number


@dataclass
class BusLoss:
    """A bus that was lost.

    Attributes:
        stamp: time of day at which it was noticed [s].
        seconds: until it was back, None where it never was.
    """

    KEYS = ("why", "stamp", "seconds", "at")

    why: str
    stamp: float
    seconds: float | None = None

    @property
    def at(self) -> str:
        """Date and time at which it was noticed."""
        return moment(self.stamp)


class Link:
    """A bus, and the one that takes its place when it is lost.

    Args:
        patience: for which an adapter may refuse all frames [s].
        say: takes lines for people.

    Attributes:
        reopens: whether a lost bus is opened again, every second.
        persists: whether frames are also given to an adapter that has refused all of them for too long.
        trouble: why the bus is lost, "" while it is not.
        no_room: frames that the adapter did not take; unsent: frames for which there was no bus.
        losses: the first of them; loss_count counts all.
        busy: for how long received and given frames have taken the bus; 0 where its bit rate is not known [s].
    """

    def __init__(self, bus: can.BusABC, settings: BusSettings, patience: float, say: Callable[[str], None]) -> None:
        self._bus, self._settings, self._patience, self._say = bus, settings, patience, say
        self.reopens = settings.reopens
        self.persists = False
        self.trouble = ""
        self.no_room = self.unsent = self.loss_count = 0
        self.losses: list[BusLoss] = []
        self._loss = BusLoss("", 0.0)
        self._lost = self._tried = 0.0
        self._given: Counter[Key] = Counter()  # to the bus of now
        self._out: Counter[Key] = Counter()  # of those before
        self._forgotten: Counter[Key] = Counter()  # by adapters that were told to
        self._malformed = self._refused = 0
        self._told = True
        self.busy = 0.0
        self._echoes: deque[tuple[float, Key, bytes]] | None = deque() if settings.interface in ECHOING else None

    @property
    def out(self) -> Counter[Key]:
        """Identifier -> frames that got out: those that the adapter acknowledged, or took where it does not say so."""
        flow = getattr(self._bus, "flow", None)
        return self._out + (self._given if flow is None or not flow.answers else flow.taken) - self._forgotten

    @property
    def acknowledges(self) -> bool:
        """Whether adapters have told of all frames if they took them."""
        flow = getattr(self._bus, "flow", None)
        return self._told and (not self._given or bool(flow is not None and flow.answers))

    @property
    def owed(self) -> int:
        """Frames to which the adapter has not answered yet, where it does."""
        return getattr(self._bus, "owed", 0)

    @property
    def unanswered(self) -> int:
        """Frames of which the adapter never said whether it took them."""
        return getattr(getattr(self._bus, "flow", None), "lost", 0)

    @property
    def gone(self) -> bool:
        """Whether nothing can be given to it."""
        return bool(self.trouble) and not (self.persists and self.trouble == REFUSING)

    @property
    def failed(self) -> int:
        """Frames that the adapter of now has refused, and those of which it never said whether it took them."""
        return getattr(getattr(self._bus, "flow", None), "failed", 0)

    @property
    def refusing(self) -> bool:
        """Whether the adapter has refused its latest frame."""
        return getattr(getattr(self._bus, "flow", None), "refusing", None) is not None

    @property
    def malformed(self) -> int:
        """Lines from adapters that were no frames."""
        return self._malformed + getattr(self._bus, "malformed", 0)

    @property
    def refused(self) -> int:
        """Commands and frames that adapters have refused."""
        return self._refused + getattr(self._bus, "refused", 0)

    def recv(self, timeout: float) -> can.Message | None:
        """The next frame of somebody else; None when none came, also while the bus is lost.

        Raises:
            Exception: the bus is lost, and not opened again; drivers raise anything.
        """
        if self.trouble and self.reopens:
            self._come_back(timeout)
            return None
        bus = self._bus
        try:
            while (message := bus.recv(timeout)) is not None and self._is_own(message):
                timeout = 0.0
        except Exception as error:
            self._lose(bus, complaint(error))
            if not self.reopens:
                raise
            return None
        if message is not None:
            self.busy += occupied(message, self._settings)
            if is_bus_off(message):
                self._lose(bus, BUS_OFF)
        self._check(bus)
        return message

    def send(self, frame: can.Message, patience: float = 0.0) -> bool:
        """Whether the adapter took a frame, waiting at most so long for room [s]."""
        bus = self._bus
        if self.gone:
            self.unsent += 1
            return False
        key = frame.arbitration_id, frame.is_extended_id
        if self._echoes is not None:
            self._echoes.append((time.monotonic(), key, bytes(frame.data)))
        try:
            _send(bus, frame, patience)
        except Exception as error:  # drivers raise anything
            if _no_room(error):
                self.no_room += 1
            else:
                self.unsent += 1
                self._lose(bus, complaint(error))
            self._check(bus)
            return False
        self._given[key] += 1
        self.busy += occupied(frame, self._settings)
        self._check(bus)
        return True

    def clear(self, waiting: Counter[Key]) -> bool:
        """Have the adapter forget what it was given and has not sent; whether it can.

        Args:
            waiting: identifier -> frames that it was given and that have not got out.
        """
        bus = self._bus
        try:
            bus.flush_tx_buffer()
        except (NotImplementedError, can.CanTimeoutError):
            return False
        except Exception as error:  # drivers raise anything
            self._lose(bus, complaint(error))
            return False
        self._forgotten += waiting
        return True

    def stay(self) -> bool:
        """Have the adapter stay on the bus when it is left, and send what it has still to send; whether it can."""
        can_stay = hasattr(self._bus, "stays") and not self.trouble
        if can_stay:
            self._bus.stays = True  # type: ignore[attr-defined]
        return can_stay

    def insist(self, frame: can.Message) -> bool:
        """Leave a frame with an adapter that has stopped to answer, behind all that it has; whether it may go out."""
        if not self.owed or not self.stay():
            return False
        self._bus.insists = True  # type: ignore[attr-defined]
        return self.send(frame)

    def shutdown(self) -> None:
        """Leave the bus; an adapter that fails while it closes is gone anyway."""
        with contextlib.suppress(Exception):
            self._bus.shutdown()

    def _check(self, bus: can.BusABC) -> None:
        """See whether the adapter has refused everything for too long."""
        flow = getattr(bus, "flow", None)
        since = None if flow is None else flow.refusing
        if since is not None and not self.persists and time.monotonic() - since > self._patience:
            self._lose(bus, REFUSING)

    def _lose(self, bus: can.BusABC, why: str) -> None:
        if self.trouble or bus is not self._bus:
            return
        self._lost = self._tried = time.monotonic()
        self._loss = BusLoss(why, time.time())
        self.trouble = why
        self.loss_count += 1
        if len(self.losses) < _KEPT:
            self.losses.append(self._loss)
        self._tell(f"bus lost: {why}")

    def _come_back(self, timeout: float) -> None:
        """Open the bus again, when it is time to try."""
        wait = self._tried + _RETRY - time.monotonic()
        if wait > 0:
            time.sleep(min(wait, timeout))
            return
        self.shutdown()
        try:
            bus = open_bus(self._settings)
        except BusError:
            self._tried = time.monotonic()
            return
        self._out, self._malformed, self._refused = self.out, self.malformed, self.refused
        self._told = self.acknowledges
        self._given, self._forgotten = Counter(), Counter()
        self._bus = bus
        self._loss.seconds = round(time.monotonic() - self._lost, 3)
        self.trouble = ""
        self._tell(f"bus back after {self._loss.seconds:.1f} s")

    def _tell(self, line: str) -> None:
        if self.loss_count <= _SAID:
            self._say(f"{self._settings.place}: {line}")

    def _is_own(self, message: can.Message) -> bool:
        """Whether it is a frame that was sent here, which some interfaces give back."""
        if not message.is_rx:
            return True
        if not self._echoes:
            return False
        now, wanted = time.monotonic(), ((message.arbitration_id, message.is_extended_id), bytes(message.data))
        while self._echoes and now - self._echoes[0][0] > _ECHOED:
            self._echoes.popleft()
        for place, (_, *echo) in enumerate(list(self._echoes)):
            if tuple(echo) == wanted:
                del self._echoes[place]
                return True
        return False


@contextlib.contextmanager
def linked(settings: BusSettings, patience: float, say: Callable[[str], None]) -> Iterator[Link]:
    """The open bus, closed at the end whatever happened.

    Raises:
        BusError: the adapter does not open.
    """
    link = Link(open_bus(settings), settings, patience, say)
    try:
        yield link
    finally:
        link.shutdown()


def _send(bus: can.BusABC, frame: can.Message, patience: float) -> None:
    """Send it; wait for room also where the driver does not."""
    until = time.monotonic() + patience
    while True:
        try:
            return bus.send(frame, timeout=patience)
        except Exception as error:  # drivers raise anything
            if not _no_room(error) or time.monotonic() >= until:
                raise
        time.sleep(_NAP)


def _no_room(error: Exception) -> bool:
    """Whether the adapter only has more to send than it can."""
    if isinstance(error, can.CanTimeoutError) or getattr(error, "error_code", None) in _FULL:
        return True
    return any(word in str(error).lower() for word in _FULL_WORDS)
