"""What a coupling does with an open bus in every step: frames in to inputs, outputs out to frames."""

from __future__ import annotations

import errno
from collections.abc import Sequence

import can

from orchestrator.bridge.mapping import Coupling
from orchestrator.bridge.watchdog import Watchdog
from orchestrator.can.live.bus import is_bus_off
from orchestrator.can.live.receiver import Receiver
from orchestrator.trace import FloatArray

_FULL = (errno.ENOBUFS, errno.EAGAIN)
_FULL_WORDS = ("full", "overflow", "no buffer space", "timed out", "timeout")  # of drivers that give no number
_LAST_PATIENCE = 0.2  # with an adapter that has no room for a safe value [s]
BUS_OFF = "the adapter has left the bus (bus off)"


class BusTraffic:
    """Takes from a bus and gives to it.

    Attributes:
        trouble: what is wrong with the bus, "" while nothing is; an adapter may come back from `BUS_OFF`.
        gone: whether the adapter is gone for good.
        sent: frames that the adapter took; refused: those for which it had no room.
    """

    def __init__(self, bus: can.BusABC, receiver: Receiver, coupling: Coupling, watchdog: Watchdog) -> None:
        self._bus, self._receiver, self._coupling, self._watchdog = bus, receiver, coupling, watchdog
        self.trouble, self.gone = "", False
        self.sent = self.refused = 0

    def receive(self, now: float, inputs: FloatArray) -> None:
        """Give the inputs what has come, and safe values where nothing came; it is `now` since the beginning [s]."""
        for frame in self._receiver.take():
            if is_bus_off(frame):
                self.trouble = BUS_OFF
                self._watchdog.lost(now, BUS_OFF, inputs)
            message = self._coupling.reception.take(frame, inputs)
            if message is not None:
                self._watchdog.heard(message, now)
        if self._receiver.failure is not None and not self.gone:
            self._lose(self._receiver.failure)
        if self.gone:
            self._watchdog.lost(now, self.trouble, inputs)
        self._watchdog.check(now, inputs)

    def send(self, step: int, outputs: Sequence[float]) -> None:
        """Send the messages that are due in this step."""
        for message in self._coupling.sent:
            if step % message.every == 0:
                self._send(message.frame(outputs), 0.0)

    def send_safe_values(self) -> None:
        """Send the safe values, so that nobody acts on the last ones for ever."""
        for message in self._coupling.sent:
            frame = message.safe_frame()
            if frame is not None:
                self._send(frame, _LAST_PATIENCE)

    def _send(self, frame: can.Message, patience: float) -> None:
        if self.gone:
            return
        try:
            self._bus.send(frame, timeout=patience)
        except Exception as error:  # drivers raise anything
            if _no_room(error):
                self.refused += 1
            else:
                self._lose(error)
        else:
            self.sent += 1

    def _lose(self, error: Exception) -> None:
        self.gone, self.trouble = True, " ".join(str(error).split()) or type(error).__name__


def _no_room(error: Exception) -> bool:
    """Whether the adapter only has more to send than it can."""
    if isinstance(error, can.CanTimeoutError) or getattr(error, "error_code", None) in _FULL:
        return True
    return any(word in str(error).lower() for word in _FULL_WORDS)
