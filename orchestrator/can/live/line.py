"""A bus of a coupling: what comes from it, and whether what is given to it gets out.

A bus that others fill takes commands late. What has waited for too long is dropped, so that what is given next is the
first to go when the bus has room.
"""

from __future__ import annotations

import can

from orchestrator.can.live.backlog import Backlog
from orchestrator.can.live.link import Link
from orchestrator.can.live.receiver import Receiver


class SendingLine:
    """A bus that may be full.

    Attributes:
        name: what it is called.
        patience: how long what was given may wait [s].
        full: whether something has waited for longer, and not all has got out since.
        blocked: frames that did not get out, or were not given, as it was full.
    """

    def __init__(
        self, link: Link, receiver: Receiver, backlog: Backlog, patience: float, name: str = "the bus"
    ) -> None:
        self.link, self.receiver, self.name = link, receiver, name
        self._backlog, self.patience = backlog, patience
        self.full, self.blocked = False, 0
        self._failed = 0

    def take(self) -> list[can.Message]:
        """What has been received since the last call, in order."""
        frames = self.receiver.take()
        for frame in frames:
            self._backlog.heard(frame)
        return frames

    def fills(self, now: float) -> bool:
        """Whether it has just become full; what waits in the adapter is dropped then, where that can be [s]."""
        self._backlog.look(now)
        if self.full:
            self.full = not self._backlog.empty()
            return False
        self.full = self._backlog.age() > self.patience
        if self.full and self.link.clear(waiting := self._backlog.waiting()):
            self._backlog.clear()
            self.blocked += waiting.total()
        return self.full

    def give(self, frame: can.Message, now: float, patience: float = 0.0) -> bool:
        """Whether the adapter took a frame, waiting at most so long for room; it is `now`, as for `fills` [s]."""
        taken = self.link.send(frame, patience)
        if taken:
            self._backlog.sent(frame, now)
        return taken

    @property
    def waits(self) -> bool:
        """Whether something that was given is not on the bus."""
        return not self._backlog.empty()

    def quiet(self) -> bool:
        """Whether all that was given is on the bus, by the adapter's answers and the time that others leave."""
        return self._backlog.empty() and not self.link.owed

    def fails(self) -> bool:
        """Whether since the last call the adapter has refused a frame, or it is known that nobody knows of one; to be
        asked after `quiet`, which may find that out."""
        before, self._failed = self._failed, self.link.failed
        return self._failed != before
