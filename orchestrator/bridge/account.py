"""What passed over a bus while a scenario was coupled to it, as its manifest has it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import TypedDict

from fmus.files import sha256
from orchestrator.bridge.bus.traffic_report import TrafficReport
from orchestrator.can.frames import moment
from orchestrator.can.live.bus import BusSettings
from orchestrator.can.statistics import StatisticsDocument
from orchestrator.realtime.deadlines import DeadlineFigures, Deadlines


class DescribedBus(TypedDict):
    """Which bus it was; rates in bit/s."""

    interface: str
    channel: str
    bitrate: int | None
    fd: bool
    data_bitrate: int | None


class BusAccountDocument(DescribedBus):
    """What passed over a bus, or over it and `others`, and how deadlines were kept."""

    mode: str
    others: list[DescribedBus]
    database: dict[str, str]
    received: StatisticsDocument
    sent: StatisticsDocument
    losses: list[dict[str, str | float | None]]
    loss_count: int
    malformed_lines: int
    refused_lines: int
    trouble: str
    over: str
    unconfirmed: list[str]
    pending: bool
    not_finite: dict[str, int]
    sent_by_others: dict[str, int]
    notes: list[str]
    started: str
    seconds: float
    deadlines: DeadlineFigures
    watchdog: Mapping[str, object]


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

    def document(self) -> BusAccountDocument:
        """For the manifest."""
        bus, *others = map(_described, self.buses)
        return {
            **bus,
            "mode": self.mode,
            "others": others,
            "database": {
                "file": ", ".join(file.name for file in self.database),
                "sha256": ", ".join(map(sha256, self.database)),
            },
            "received": self.received.document() | {"dropped": self.dropped, "late": self.late},
            "sent": self.sent.document()
            | {
                "frames": self.frames,
                "acknowledged": self.acknowledged,
                "no_room": self.no_room,
                "skipped": self.skipped,
                "bus_full": self.blocked,
                "no_bus": self.unsent,
            },
            "losses": [asdict(loss) | {"at": moment(loss.stamp)} for loss in self.losses],
            "loss_count": self.loss_count,
            "malformed_lines": self.malformed,
            "refused_lines": self.refused,
            "trouble": self.trouble,
            "over": self.over,
            "unconfirmed": list(self.unconfirmed),
            "pending": bool(self.pending),
            "not_finite": self.odd,
            "sent_by_others": self.foreign,
            "notes": self.notes,
            "started": self.started.isoformat(),
            "seconds": self.seconds,
            "deadlines": self.deadlines.document(),
            "watchdog": asdict(self.watchdog),
        }

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


def _described(bus: BusSettings) -> DescribedBus:
    return {
        "interface": bus.interface,
        "channel": bus.channel,
        "bitrate": bus.bitrate,
        "fd": bus.fd,
        "data_bitrate": bus.data_bitrate,
    }
