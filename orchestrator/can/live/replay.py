"""The frames of a log back onto a bus, each at its own time.

Deadlines are counted from the first frame, so lateness of one frame does not delay those after it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import Full, Queue
from typing import Any

import can

from fmus.errors import BusError, InputError
from orchestrator.can import logs
from orchestrator.can.frames import Frames
from orchestrator.can.live.bus import BusSettings, is_bus_off, opened, send
from orchestrator.can.live.receiver import Receiver
from orchestrator.progress import Progress, silent
from orchestrator.realtime.lateness import Lateness
from orchestrator.realtime.pacing import quiet
from orchestrator.realtime.stopping import Stop, stop_requests

_LEAD = 0.05  # from the start to the first frame [s]
_AHEAD = 2  # batches that are read before they are needed
_PERIOD = 0.25  # between two reports of progress, and two looks at what the adapter says [s]
_HEARD = 65536  # frames of others that are kept between two looks at most
_ECHO = 0.3  # after the last frame, until the adapter has sent what it keeps and has said what there is to say [s]


@dataclass
class Replayed:
    """What was sent, and how well in time.

    Attributes:
        sent: frames.
        skipped: error frames, which a bus makes and nobody sends.
        setbacks: stamps before the one of the frame before; such a frame follows at once, later ones keep their
            distance to it.
        lateness: of the frames.
        duration: from the first to the latest frame [s].
        stopped: whether it was told to end before the log did.
        errors: error frames that came from the bus meanwhile.
        damage: places of the log that could not be read.
    """

    sent: int = 0
    skipped: int = 0
    setbacks: int = 0
    errors: int = 0
    lateness: Lateness = field(default_factory=Lateness)
    duration: float = 0.0
    stopped: bool = False
    damage: list[str] = field(default_factory=list)

    def document(self) -> dict[str, Any]:
        """For --json."""
        return {
            "sent": self.sent,
            "skipped": self.skipped,
            "setbacks": self.setbacks,
            "error_frames": self.errors,
            "duration": self.duration,
            "stopped": self.stopped,
            "lateness": self.lateness.document(),
            "damage": self.damage,
        }

    def lines(self) -> list[str]:
        """For people."""
        late = self.lateness.document()
        told = {
            f"{self.skipped:,} error frames of the log were not sent": self.skipped,
            f"{self.errors:,} error frames came from the bus meanwhile": self.errors,
            f"the log's clock jumped backwards {self.setbacks:,} times; later frames follow on": self.setbacks,
        }
        return [
            f"{self.sent:,} frames in {self.duration:.3f} s; late by {1e3 * late['median']:.2f} ms (median), "
            f"{1e3 * late['p99']:.2f} ms (99 %), {1e3 * late['worst']:.2f} ms (most)",
            *(line for line, count in told.items() if count),
            *self.damage,
        ]


def replay(
    settings: BusSettings,
    log: Path,
    speed: float = 1.0,
    progress: Progress = silent,
) -> Replayed:
    """Send the frames of a log with their original timing; Ctrl-C or SIGTERM ends it.

    Args:
        speed: how many times faster than recorded.
        progress: told the share of the log that has been read, and how many frames have been sent.

    Raises:
        InputError: the speed is not possible, the log cannot be read, or holds CAN FD frames for a classic bus.
        BusError: the adapter does not open, fails, leaves the bus, or takes no frame for a second.
    """
    if not 0 < speed < float("inf"):
        raise InputError("--speed", f"is {speed:g}", "give a number over 0")
    share = 0.0

    def read(fraction: float, doing: str) -> None:
        nonlocal share
        share = fraction

    reader = logs.read(log, read)
    done = Replayed()
    with opened(settings) as bus, stop_requests() as stop, quiet(), _ahead(reader) as batches:
        told = 0.0
        with Receiver(bus, _HEARD) as receiver:
            for sent in _sent(bus, settings, batches, speed, stop, done):
                if sent - told >= _PERIOD:
                    progress(share, f"{done.sent:,} frames")
                    _check(receiver, settings, done)
                    told = sent
            time.sleep(_ECHO)
        _check(receiver, settings, done)
    done.stopped = stop.requested
    done.damage = [str(damage) for damage in reader.damage]
    return done


def _sent(
    bus: can.BusABC, settings: BusSettings, batches: Iterable[Frames], speed: float, stop: Stop, done: Replayed
) -> Iterator[float]:
    """Send frame by frame; when each was sent."""
    schedule: _Schedule | None = None
    for message in (message for batch in batches for message in batch.messages()):
        if message.is_error_frame:
            done.skipped += 1
            continue
        if message.is_fd and not settings.fd:
            raise InputError(
                settings.place, "is opened for classic frames, and the log holds CAN FD frames", "give --fd"
            )
        if schedule is None:
            schedule = _Schedule(message.timestamp, time.monotonic() + _LEAD, speed)
        deadline = schedule.deadline(message.timestamp)
        stop.sleep_until(deadline)
        if stop.requested:
            return
        _send(bus, settings, message, done.sent)
        now = time.monotonic()
        done.sent += 1
        done.setbacks = schedule.setbacks
        done.lateness.add(now - deadline)
        done.duration = now - schedule.begin
        yield now


def _send(bus: can.BusABC, settings: BusSettings, message: can.Message, sent: int) -> None:
    try:
        send(bus, message)
    except can.CanError as error:
        raise _failed(settings, sent, error) from error


def _check(receiver: Receiver, settings: BusSettings, done: Replayed) -> None:
    """See how the bus takes it; what else is received is of no interest.

    Raises:
        BusError: the adapter has left the bus, or is gone.
    """
    messages = receiver.take()
    done.errors += sum(message.is_error_frame for message in messages)
    if any(map(is_bus_off, messages)):
        raise BusError(
            settings.place,
            f"has left the bus (bus off) by {done.sent:,} frames",
            "see that the bit rate is that of the bus, and to the wiring",
        )
    if receiver.failure is not None:
        raise _failed(settings, done.sent, receiver.failure)


def _failed(settings: BusSettings, sent: int, error: Exception) -> BusError:
    return BusError(
        settings.place,
        f"failed after {sent:,} frames ({error})",
        "see that the adapter is plugged in, and that somebody listens",
    )


class _Schedule:
    """When the frame of a stamp is due, on the clock of `time.monotonic()`."""

    def __init__(self, first: float, begin: float, speed: float) -> None:
        self.begin, self._speed = begin, speed
        self._first, self._latest = first, first
        self.setbacks = 0

    def deadline(self, stamp: float) -> float:
        if stamp < self._latest:
            self.setbacks += 1
            self._first -= self._latest - stamp
        self._latest = stamp
        return self.begin + (stamp - self._first) / self._speed


@contextmanager
def _ahead(batches: Iterable[Frames]) -> Iterator[Iterator[Frames]]:
    """The same batches, read in a thread before they are needed.

    Raises (in the iteration):
        Exception: what the reading raised, in its place.
    """
    queue: Queue[Frames | Exception | None] = Queue(_AHEAD)
    over = threading.Event()

    def put(item: Frames | Exception | None) -> None:
        while not over.is_set():
            with suppress(Full):
                queue.put(item, timeout=0.1)
                return

    def read() -> None:
        try:
            for batch in batches:
                put(batch)
                if over.is_set():
                    return
            put(None)
        except Exception as error:
            put(error)

    def taken() -> Iterator[Frames]:
        while (item := queue.get()) is not None:
            if isinstance(item, Exception):
                raise item
            yield item

    thread = threading.Thread(target=read, name="log reader", daemon=True)
    thread.start()
    try:
        yield taken()
    finally:
        over.set()
        thread.join()
