"""Frames off a bus while something else is done: a thread that receives into a bounded queue."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from queue import Empty, SimpleQueue

import can

from orchestrator.can.frames import CALENDAR, moment
from orchestrator.can.live.link import Link

_PAUSE = 0.1  # for which it may be kept from receiving without that being a pause [s]
_PAUSES = 1000  # that are kept; beyond it they are only counted
_PATIENCE = 0.05  # with a bus on which nothing happens, before the thread looks whether to end [s]
_DRAINING = 1.0  # the longest time for what has arrived before the end [s]


@dataclass(frozen=True)
class Pause:
    """A time in which nothing could be received: the process was stopped, or had no processor.

    Attributes:
        stamp: time of day at its end [s].
        seconds: at least.
    """

    KEYS = ("until", "seconds")

    stamp: float
    seconds: float

    @property
    def until(self) -> str:
        """Date and time of its end."""
        return moment(self.stamp)


class Receiver:
    """Receives from a bus from the start of the block to its end, in a thread.

    Frames keep the stamps of their interface. Those of a clock that does not know the date are moved to it, all by as
    much as the first; a frame without a stamp gets that of its reception.

    Args:
        arrived: called by that thread when there is something to take, or it has failed.
        most_late: for how long it may be kept from receiving; what has come in a longer pause is as old as nobody
            knows, and dropped [s].

    Attributes:
        received: frames taken off the bus.
        dropped: of these, frames that came while the queue was full; late: those that came in a pause.
        pauses: the first of them; pause_count counts all.
        failure: what ended the reception, None while the bus works.
        clock_offset: by how much stamps were moved to be dates [s]; None where they are.
    """

    def __init__(
        self,
        bus: can.BusABC | Link,
        limit: int,
        arrived: Callable[[], None] = lambda: None,
        most_late: float = math.inf,
    ) -> None:
        self._bus, self._limit, self._arrived, self._most_late = bus, limit, arrived, most_late
        self._patience = min(_PATIENCE, most_late / 5)  # what is held up for less cannot be told from a quiet bus
        self._queue: SimpleQueue[can.Message] = SimpleQueue()
        self._ending = False
        self._thread = threading.Thread(target=self._run, name="CAN receiver", daemon=True)
        self.received = self.dropped = self.late = self.pause_count = 0
        self.pauses: list[Pause] = []
        self.failure: Exception | None = None
        self.clock_offset: float | None = None

    def __enter__(self) -> Receiver:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.finish()

    def take(self) -> list[can.Message]:
        """What has been received since the last call, in order."""
        taken = []
        try:
            for _ in range(self._queue.qsize()):
                taken.append(self._queue.get_nowait())
        except Empty:
            pass
        return taken

    def finish(self) -> None:
        """Take what has arrived, and receive no more."""
        self._ending = True
        self._thread.join()

    def _run(self) -> None:
        try:
            looked = _now()
            while not self._ending:
                message = self._bus.recv(self._patience)
                looked, before = _now(), looked
                pause = looked - before - self._patience
                if pause > _PAUSE:
                    self._note_pause(pause)
                while pause > self._most_late and message is not None:
                    self._leave(message)
                    message = self._bus.recv(0.0)
                self._keep(message)
            until = time.monotonic() + _DRAINING
            while self._keep(self._bus.recv(0.0)) and time.monotonic() < until:
                pass
        except Exception as error:  # drivers raise anything
            self.failure = error
            self._arrived()

    def _leave(self, message: can.Message) -> None:
        """Drop a frame that came in a pause, but for what an adapter says about errors."""
        if message.is_error_frame:
            self._keep(message)
        else:
            self.received += 1
            self.late += 1

    def _keep(self, message: can.Message | None) -> bool:
        """Put a frame into the queue; whether there is one."""
        if message is None:
            return False
        self.received += 1
        if message.timestamp < CALENDAR:
            message.timestamp = self._dated(message.timestamp)
        if self._queue.qsize() < self._limit:
            self._queue.put(message)
            self._arrived()
        else:
            self.dropped += 1
        return True

    def _note_pause(self, seconds: float) -> None:
        self.pause_count += 1
        if len(self.pauses) < _PAUSES:
            self.pauses.append(Pause(time.time(), round(seconds, 3)))

    def _dated(self, stamp: float) -> float:
        if not stamp:
            return time.time()
        if self.clock_offset is None:
            self.clock_offset = time.time() - stamp
        return stamp + self.clock_offset


def _now() -> float:
    """A clock that goes on while the computer sleeps, where there is one [s]."""
    if sys.platform == "linux":
        return time.clock_gettime(time.CLOCK_BOOTTIME)
    return time.monotonic()
