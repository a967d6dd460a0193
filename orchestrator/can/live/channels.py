"""Several buses as one stream of frames in the order of their stamps, each frame with the number of its channel."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from heapq import merge
from operator import attrgetter

import can

from orchestrator.can.live.bus import BusSettings, opened
from orchestrator.can.live.receiver import Receiver
from orchestrator.can.slcan.adapter_clock import AdapterClock


@dataclass
class Channel:
    """A bus that is listened to.

    Attributes:
        frames: taken from it so far.
    """

    KEYS = (
        *(f"settings.{key}" for key in BusSettings.KEYS),
        *("settings.options", "frames", "receiver.dropped", "malformed_lines=malformed", "refused_lines=refused"),
        *("receiver.pauses", "receiver.pause_count", "receiver.clock_offset", "adapter_stamps", "failure"),
    )

    settings: BusSettings
    bus: can.BusABC
    receiver: Receiver
    frames: int = 0
    waiting: deque[can.Message] = field(default_factory=deque)

    @property
    def malformed(self) -> int:
        """Lines from the adapter that were no frames."""
        return int(getattr(self.bus, "malformed", 0))

    @property
    def clock(self) -> AdapterClock | None:
        """Of a serial adapter."""
        return getattr(self.bus, "clock", None)

    @property
    def adapter_stamps(self) -> int | None:
        """How many stamps were those of a serial adapter."""
        return self.clock.used if self.clock else None

    @property
    def failure(self) -> str | None:
        """What the bus has failed with."""
        return None if self.receiver.failure is None else str(self.receiver.failure)

    @property
    def refused(self) -> int:
        """Commands that the adapter refused."""
        return int(getattr(self.bus, "refused", 0))

    def remarks(self, among_others: bool) -> list[str]:
        """What somebody should know about it, a line each; `among_others` that have frames, also that it has none."""
        place, receiver = self.settings.place, self.receiver
        offset, clock = receiver.clock_offset or 0.0, self.clock
        pauses = sum(pause.seconds for pause in receiver.pauses)
        told = {
            f"{place}: no frame came": among_others and not self.frames,
            f"{place}: {self.malformed:,} lines from the adapter were no frames: noise, or another baud rate": (
                self.malformed
            ),
            f"{place}: could not be read {receiver.pause_count:,} times, for {pauses:.1f} s in all; frames of then have"
            " later stamps, or are lost": receiver.pause_count,
            f"{place}: stamps are the adapter's own, in ms": clock and clock.used and not clock.odd,
            f"{place}: the adapter's stamps are no ms of a minute, and left out": clock and clock.odd,
            f"{place}: the adapter refused {self.refused:,} commands": self.refused,
            f"{place}: stamps are those of the adapter's clock, moved by {offset:.6f} s to be dates": offset,
        }
        return [line for line, holds in told.items() if holds]

    def fetch(self, number: int) -> None:
        """Have what has been received wait."""
        for message in self.receiver.take():
            message.channel = number
            self.frames += 1
            self.waiting.append(message)

    def due(self, horizon: float) -> list[can.Message]:
        """What waits up to a stamp, in the order in which it came."""
        found = []
        while self.waiting and self.waiting[0].timestamp <= horizon:
            found.append(self.waiting.popleft())
        return found


class Channels:
    """Channels that are listened to together; they are numbered in their order, from 0.

    What one of several has received waits for one `take`, so that what the others have received by then goes before it.
    """

    def __init__(self, channels: Sequence[Channel]) -> None:
        self.all = tuple(channels)
        self._horizon = -math.inf

    def take(self, last: bool = False) -> list[can.Message]:
        """The next frames; the `last` time all there are."""
        horizon = math.inf if last or len(self.all) == 1 else self._horizon
        for number, channel in enumerate(self.all):
            channel.fetch(number)
        stamps = [message.timestamp for channel in self.all for message in channel.waiting]
        self._horizon = max(stamps, default=-math.inf)
        return list(merge(*(channel.due(horizon) for channel in self.all), key=attrgetter("timestamp")))

    def finish(self) -> None:
        """Receive no more."""
        for channel in self.all:
            channel.receiver.finish()

    @property
    def failed(self) -> list[Channel]:
        """Those whose bus has failed."""
        return [channel for channel in self.all if channel.failure is not None]

    @property
    def dropped(self) -> int:
        """Frames that came while the queue of their channel was full."""
        return sum(channel.receiver.dropped for channel in self.all)


@contextmanager
def listening(buses: Sequence[BusSettings], limit: int) -> Iterator[Channels]:
    """The open buses, received from until the end of the block; `limit` frames may wait on each.

    Raises:
        BusError: an adapter does not open.
    """
    with ExitStack() as stack:
        pairs = [(settings, stack.enter_context(opened(settings))) for settings in buses]
        yield Channels([Channel(settings, bus, stack.enter_context(Receiver(bus, limit))) for settings, bus in pairs])
