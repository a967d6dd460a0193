"""Ending what runs for as long as it is left to: Ctrl-C and SIGTERM become a wish that work looks at."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_NAP = 0.05  # the longest sleep that does not look whether to end [s]


@dataclass
class Stop:
    """Whether work is to end; plain flags, which a signal's handler can set whatever it interrupts.

    Attributes:
        interrupted: whether Ctrl-C asked for it.
    """

    requested: bool = False
    interrupted: bool = False

    def sleep_until(self, deadline: float) -> None:
        """Sleep until `time.monotonic()` is there, or work is to end."""
        while not self.requested and (left := deadline - time.monotonic()) > 0:
            time.sleep(min(left, _NAP))


@contextmanager
def stop_requests() -> Iterator[Stop]:
    """The wish to end; a second Ctrl-C is a KeyboardInterrupt. Former handlers come back at the end.

    Outside the main thread signals are somebody else's, and only the one who holds it can set the flag.
    """
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return

    def request(number: int, frame: FrameType | None) -> None:
        if stop.requested and number == signal.SIGINT:
            raise KeyboardInterrupt
        stop.requested, stop.interrupted = True, stop.interrupted or number == signal.SIGINT

    former = {number: signal.signal(number, request) for number in _SIGNALS}
    try:
        yield stop
    finally:
        for number, handler in former.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
