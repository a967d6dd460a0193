"""What passed over the buses of a coupling, as far as their adapters tell."""

from __future__ import annotations

from dataclasses import dataclass

from orchestrator.bridge.mapping import Coupling
from orchestrator.bridge.safety.watchdog import WatchdogReport
from orchestrator.can.live.link import BusLoss
from orchestrator.can.statistics import FrameStatistics


@dataclass(frozen=True)
class TrafficReport:
    """What passed over a bus, as far as its adapter tells.

    Attributes:
        dropped: received frames that came faster than they could be taken; late: those that came in a pause of the
            process that has the bus, as old as nobody knows.
        frames: that got out; acknowledged: whether the adapter has said so of each, or only took them.
        no_room: frames that the adapter did not take; unsent: those for which there was no bus.
        skipped: frames in whose place only later ones were sent.
        blocked: frames that were dropped as the bus was full.
        losses: the first times that the bus was lost; loss_count counts all.
        malformed, refused: lines from the adapter that were no frames, and commands that it refused.
        trouble: why the bus was lost at the end, "" where it was not.
        over: why the bus ended the coupling, "" where it did not; stopped: whether by the stop signal.
        unconfirmed: messages whose safe values may not have got out; pending: why the adapter still has these to
            send, "" where it has not, or does not stay on the bus.
        odd: outputs that were not finite -> how often; foreign: messages of ours from somebody else -> how many.
    """

    received: FrameStatistics
    dropped: int
    late: int
    sent: FrameStatistics
    frames: int
    acknowledged: bool
    no_room: int
    unsent: int
    skipped: int
    blocked: int
    losses: tuple[BusLoss, ...]
    loss_count: int
    malformed: int
    refused: int
    trouble: str
    over: str
    stopped: bool
    unconfirmed: tuple[str, ...]
    pending: str
    odd: dict[str, int]
    foreign: dict[str, int]
    watchdog: WatchdogReport

    def doubt(self) -> str:
        """What is said where safe values may not have got out."""
        still = f": {self.pending}" if self.pending else ""
        return f"the safe values of {', '.join(self.unconfirmed)} may not have got out{still}"

    @classmethod
    def of_nobody(cls, coupling: Coupling) -> TrafficReport:
        """What is known where whoever had the bus is gone."""
        none, names = FrameStatistics(), tuple(message.spec.name for message in coupling.sent if message.guarded)
        why = "the process that has the bus is gone"
        return cls(
            none,
            0,
            0,
            none,
            0,
            False,
            0,
            0,
            0,
            0,
            (),
            0,
            0,
            0,
            why,
            "",
            False,
            names,
            "",
            {},
            {},
            WatchdogReport({}, 0, []),
        )
