"""Ending what runs for as long as it is left to: Ctrl-C, SIGHUP and SIGTERM become a wish that work looks at."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

from orchestrator.processes.interrupts import Wishes, endings, handling, requested

_NAP = 0.05  # the longest sleep that does not look whether to end [s]


@dataclass
class Stop:
    """Whether work is to end; plain flags, which a signal's handler can set whatever it interrupts.

    Attributes:
        interrupted: whether Ctrl-C, or the end of the terminal, asked for it.
    """

    requested: bool = False
    interrupted: bool = False

    def sleep_until(self, deadline: float) -> None:
        """Sleep until `time.monotonic()` is there, or work is to end."""
        while not self.requested and (left := deadline - time.monotonic()) > 0:
            time.sleep(min(left, _NAP))


@contextmanager
def stop_requests() -> Iterator[Stop]:
    """The wish to end; a second Ctrl-C, or one from before, is a KeyboardInterrupt. Former handlers come back then.

    Outside the main thread signals are somebody else's, and only the one who holds it can set the flag.
    """
    stop, wishes = Stop(), Wishes()

    def request(number: int, frame: FrameType | None) -> None:
        if not wishes.again():
            return
        if stop.requested and number != signal.SIGTERM:
            raise KeyboardInterrupt
        stop.requested, stop.interrupted = True, stop.interrupted or number != signal.SIGTERM

    with handling(request, endings()):
        if requested():  # a library has swallowed the interrupt
            raise KeyboardInterrupt
        yield stop
