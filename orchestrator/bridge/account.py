"""What passed over a bus while a scenario was coupled to it, as its manifest has it."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from fmus.files import sha256
from orchestrator.bridge.bus.traffic_report import TrafficReport
from orchestrator.can.live.bus import BusSettings
from orchestrator.realtime.deadlines import Deadlines


@dataclass(frozen=True)
class BusAccount(TrafficReport):
    """Which bus it was, what passed over it, and how peers and deadlines were kept.

    Attributes:
        mode: "bridge" or "bench".
        buses: by their numbers.
        database: files of the bus' messages.
        notes: what is not as in the database, and what is sent without having been asked for, a line each.
        started: when it began; seconds: for how long it went on [s].
    """

    KEYS = (
        *(f"bus.{key}" for key in BusSettings.KEYS),
        *("mode", "others", "database=described", "received=_received", "sent=_sent", "losses", "loss_count"),
        *("malformed_lines=malformed", "refused_lines=refused", "trouble", "over", "unconfirmed"),
        *("pending=_is_pending", "not_finite=odd", "sent_by_others=foreign", "notes", "started", "seconds"),
        *("deadlines", "watchdog"),
    )

    mode: str
    buses: tuple[BusSettings, ...]
    database: tuple[Path, ...]
    notes: list[str]
    started: datetime
    seconds: float
    deadlines: Deadlines

    @property
    def counts(self) -> dict[str, int]:
        """What expectations may ask of it."""
        lost = self.dropped + self.late + self.no_room + self.unsent + self.skipped
        return {"frames lost": lost, "late steps": self.deadlines.late}

    @property
    def bus(self) -> BusSettings:
        """The first of them."""
        return self.buses[0]

    @property
    def others(self) -> tuple[BusSettings, ...]:
        """Those after it."""
        return self.buses[1:]

    @property
    def described(self) -> dict[str, str]:
        """Names and hashes of the files of the database."""
        names, hashes = (file.name for file in self.database), map(sha256, self.database)
        return {"file": ", ".join(names), "sha256": ", ".join(hashes)}

    @property
    def _received(self) -> dict[str, object]:
        return {**self.received.document(), "dropped": self.dropped, "late": self.late}

    @property
    def _sent(self) -> dict[str, object]:
        own = ("frames", "acknowledged", "no_room", "skipped")
        more = {"bus_full": self.blocked, "no_bus": self.unsent}
        return {**self.sent.document(), **{name: getattr(self, name) for name in own}, **more}

    @property
    def _is_pending(self) -> bool:
        return bool(self.pending)

    def remarks(self) -> list[str]:
        """What somebody should know about it, a line each; the deadlines first."""
        said = {
            f"{self.dropped:,} frames were dropped: they came faster than they could be taken": self.dropped,
            f"{self.late:,} frames were dropped: they came while this computer did not look": self.late,
            f"{self.no_room:,} frames were not sent: the adapter had no room": self.no_room,
            f"{self.malformed:,} lines from the adapter were no frames": self.malformed,
            f"{self.skipped:,} frames were left out: steps were so late that only newer ones were sent": self.skipped,
            f"{self.blocked:,} frames were dropped: the bus was full": self.blocked,
            f"the adapter refused {self.refused:,} commands": self.refused,
            f"{self.unsent:,} frames were not sent: the bus was lost": self.unsent,
            self._lost(): self.loss_count,
            "the interface does not say which frames got out: those count that it took": not self.acknowledged,
        }
        return [
            self.deadlines.sentence(),
            *self.received.lines(),
            *self.sent.lines(),
            *(peer.remark(name) for name, peer in self.watchdog.messages.items() if peer.silences),
            *(f"{name} was also sent by somebody else: {count:,} frames" for name, count in self.foreign.items()),
            *([self.doubt()] if self.unconfirmed else []),
            *(text for text, holds in said.items() if holds),
        ]

    def _lost(self) -> str:
        """How often and for how long there was no bus."""
        whys = ", ".join(dict.fromkeys(loss.why for loss in self.losses))
        seconds = sum(loss.seconds or 0.0 for loss in self.losses)
        times = "once" if self.loss_count == 1 else f"{self.loss_count:,} times"
        ends = "and did not come back" if self.trouble else f"and was away for {seconds:.1f} s"
        return f"the bus was lost {times} ({whys}) {ends}"

    def traffic(self) -> list[tuple[str, str, int, float]]:
        """(direction, message, frames, frames a second) of every message on the bus."""
        seconds = max(self.seconds, 1e-9)
        return [
            (direction, name, count, count / seconds)
            for direction, statistics in (("received", self.received), ("sent", self.sent))
            for name, count in sorted(statistics.messages.items())
        ]
