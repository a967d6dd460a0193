"""What an instance exchanges with a bus: variables that go out and come in with ticks of its clocks."""

from __future__ import annotations

from collections import deque
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from orchestrator.fmi.interface import Value

Variables = Sequence[str]


class Post(NamedTuple):
    """What went out when a clock ticked; the time in seconds."""

    time: float
    clock: str
    values: Sequence[Value]


@dataclass
class Mail:
    """What goes out of an instance and comes in.

    Attributes:
        outgoing, incoming: clock -> the variables that go with its ticks.
        sent: what has gone out and nobody has fetched.
        waiting: ticks, and values to come with them, that are to come at the next event, each in an event of its own
            where they are of one clock.
    """

    outgoing: Mapping[str, Variables] = field(default_factory=dict)
    incoming: Mapping[str, Variables] = field(default_factory=dict)
    sent: list[Post] = field(default_factory=list)
    waiting: deque[tuple[str, Sequence[Value]]] = field(default_factory=deque)

    def clear(self) -> None:
        """Nothing is on its way."""
        self.sent.clear()
        self.waiting.clear()

    def fetched(self, clocks: Container[str]) -> list[Post]:
        """What has gone out with these clocks since it was last fetched, in order."""
        found = [post for post in self.sent if post.clock in clocks]
        self.sent = [post for post in self.sent if post.clock not in clocks] if len(found) < len(self.sent) else []
        return found

    def arriving(self) -> dict[str, Sequence[Value]]:
        """Clock -> values, of what comes at the present event."""
        found: dict[str, Sequence[Value]] = {}
        while self.waiting and self.waiting[0][0] not in found:
            clock, values = self.waiting.popleft()
            found[clock] = values
        return found

    def copy(self) -> Mail:
        """A copy of where it is."""
        return Mail(self.outgoing, self.incoming, [*self.sent], deque(self.waiting))
