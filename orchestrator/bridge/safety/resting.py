"""When an output with a safe value rests at it: a state machine of times and findings, without any bus.

             all that it depends on is good                       anything is not
    init ------------------------------------> running ---------------------------------> safe
      |                                           |  <-----------------------------------  |
      |                                           |    all good for `after` s, by frames   |
      v                                           v    of that time, unless it is latched  v
    ended <---------------------------------------+----------------------------------------+

It rests in every state but `running`. Nothing leaves `ended`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class OutputState(StrEnum):
    """What an output does: only while it is running is it sent as it is."""

    INIT = "init"
    RUNNING = "running"
    SAFE = "safe"
    ENDED = "ended"


def usual_lateness(step: float) -> float:
    """By how much a step of so long may be late where nobody says it [s]."""
    return max(0.05, 3 * step)


@dataclass(frozen=True)
class Rules:
    """When outputs rest and go on again.

    Attributes:
        latched: whether an output that has come to rest stays there; else `after` how long all must be good [s].
        ends: whether a received message that falls silent ends the coupling.
        reconnects: whether a lost bus is opened again.
        most_late: by how much a step may be late [s]; give_up: by how much until the coupling ends [s].
    """

    latched: bool = False
    after: float = 0.0
    ends: bool = False
    most_late: float = 0.05
    give_up: float = 2.0
    reconnects: bool = False


@dataclass(frozen=True)
class OutputStatus:
    """The state of an output, and since when all has been good [s], None while something is not."""

    state: OutputState = OutputState.INIT
    good_since: float | None = None

    @property
    def rests(self) -> bool:
        """Whether the safe value is sent."""
        return self.state is not OutputState.RUNNING

    def seen(self, now: float, good: bool, rules: Rules, proven: bool = True) -> OutputStatus:
        """The status after a look at all that the output depends on.

        Args:
            proven: whether good frames of what was silent have come for `after`: a single one is good for as long as
                silence may be.
        """
        if self.state is OutputState.ENDED:
            return self
        if not good:
            return OutputStatus(OutputState.SAFE if self.state is OutputState.RUNNING else self.state)
        since = now if self.good_since is None else self.good_since
        resumes = not rules.latched and now - since >= rules.after and proven
        runs = resumes or self.state is not OutputState.SAFE
        return OutputStatus(OutputState.RUNNING if runs else OutputState.SAFE, since)

    def ended(self) -> OutputStatus:
        """The status from the end on."""
        return OutputStatus(OutputState.ENDED, self.good_since)
