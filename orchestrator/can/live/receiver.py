"""Frames off a bus while something else is done: a thread that receives into a bounded queue."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from queue import Empty, SimpleQueue

import can

from orchestrator.can.frames import CALENDAR
from orchestrator.can.live.link import Link

_PATIENCE = 0.1  # with a bus on which nothing happens, before the thread looks whether to end [s]
_DRAINING = 1.0  # the longest time for what has arrived before the end [s]


class Receiver:
    """Receives from a bus from the start of the block to its end, in a thread.

    Frames keep the stamps of their interface. Those of a clock that does not know the date are moved to it, all by as
    much as the first; a frame without a stamp gets that of its reception.

    Args:
        arrived: called by that thread when there is something to take, or it has failed.

    Attributes:
        received: frames taken off the bus.
        dropped: of these, frames that came while the queue was full.
        failure: what ended the reception, None while the bus works.
        clock_offset: by how much stamps were moved to be dates [s]; None where they are.
    """

    def __init__(self, bus: can.BusABC | Link, limit: int, arrived: Callable[[], None] = lambda: None) -> None:
        self._bus, self._limit, self._arrived = bus, limit, arrived
        self._queue: SimpleQueue[can.Message] = SimpleQueue()
        self._ending = False
        self._thread = threading.Thread(target=self._run, name="CAN receiver", daemon=True)
        self.received = self.dropped = 0
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
            while not self._ending:
                self._receive(_PATIENCE)
            until = time.monotonic() + _DRAINING
            while self._receive(0.0) and time.monotonic() < until:
                pass
        except Exception as error:  # drivers raise anything
            self.failure = error
            self._arrived()

    def _receive(self, timeout: float) -> bool:
        """Put the next frame into the queue; whether there was one."""
        message = self._bus.recv(timeout)
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

    def _dated(self, stamp: float) -> float:
        if not stamp:
            return time.time()
        if self.clock_offset is None:
            self.clock_offset = time.time() - stamp
        return stamp + self.clock_offset
