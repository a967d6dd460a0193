"""What a recording of a bus is of, and how it went: its manifest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from orchestrator.can.database.sources import DatabaseFiles, paths
from orchestrator.can.live.bus import BusSettings
from orchestrator.can.logs.rotation import LogFile, writer_of
from orchestrator.can.statistics import FrameStatistics
from orchestrator.results import versions

QUEUE = 65536  # frames that wait to be written at most


@dataclass(frozen=True)
class BusRecording:
    """What is recorded, where to, and for how long.

    Attributes:
        out: folder of the log files and of the manifest.
        database: of the bus, for counts by message; its text in this `encoding`, or in what it seems to be.
        duration: None: until it is told to end [s].
        rotate_size, rotate_seconds: when a new file begins [bytes], [s].
        suffix: names the format.
        queue: frames that may wait to be written; more are dropped and counted.

    Raises:
        InputError: the format cannot be written while frames come.
    """

    bus: BusSettings
    out: Path
    database: DatabaseFiles | None = None
    duration: float | None = None
    rotate_size: float | None = None
    rotate_seconds: float | None = None
    suffix: str = ".blf"
    queue: int = QUEUE
    encoding: str | None = None

    @property
    def database_names(self) -> str | None:
        """Names of the database's files, None where there is none."""
        return None if self.database is None else ", ".join(path.name for path in paths(self.database))

    def __post_init__(self) -> None:
        writer_of(self.suffix)


@dataclass(frozen=True)
class RecordingManifest:
    """How a recording went.

    Attributes:
        stopped: None while it is not finished.
        ended: "unfinished", "duration", "stopped" or "failed".
        failure: of the adapter, None without one.
        dropped: frames that came faster than they could be written.
        bus_off: stamps at which the adapter left the bus [s].
        malformed, refused: lines from the adapter that were no frames, and commands that it refused.
        statistics: of all frames; without a database their identifiers are all unknown.
        notes: what is not as in the database, a line each.
    """

    recording: BusRecording
    started: datetime
    stopped: datetime | None
    ended: str
    failure: str | None
    frames: int
    dropped: int
    bus_off: tuple[float, ...]
    malformed: int
    refused: int
    files: tuple[LogFile, ...]
    statistics: FrameStatistics
    notes: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=versions)

    def document(self) -> dict[str, Any]:
        """As the file has it."""
        recording, bus = self.recording, self.recording.bus
        found = self.statistics.document()
        if recording.database is None:
            found["identifiers"] = found.pop("unknown", {})
        return {
            "kind": "CAN recording",
            "interface": bus.interface,
            "channel": bus.channel,
            "bitrate": bus.bitrate,
            "fd": bus.fd,
            "data_bitrate": bus.data_bitrate,
            "options": dict(bus.options),
            "database": recording.database_names,
            "started": self.started.isoformat(),
            "stopped": None if self.stopped is None else self.stopped.isoformat(),
            "ended": self.ended,
            "failure": self.failure,
            "frames": self.frames,
            "dropped": self.dropped,
            "error_frames": self.statistics.errors,
            "bus_off": [moment(stamp) for stamp in self.bus_off],
            "malformed_lines": self.malformed,
            "refused_lines": self.refused,
            "files": [file.document() for file in self.files],
            "found": found,
            "versions": dict(self.versions),
            "remarks": self.remarks(),
        }

    def remarks(self) -> list[str]:
        """What somebody should know about it, a line each."""
        database, errors = self.recording.database_names, self.statistics.errors
        first = moment(self.bus_off[0]) if self.bus_off else ""
        told = {
            f"{self.dropped:,} frames were dropped: they came faster than they could be written": self.dropped,
            f"the adapter has left the bus (bus off), first at {first}": self.bus_off,
            f"{self.malformed:,} lines from the adapter were no frames: noise, or another baud rate of the port": (
                self.malformed
            ),
            f"the adapter refused {self.refused:,} commands": self.refused,
            "no frame came: see that the bit rate is that of the bus, and that somebody sends": self.frames == errors,
        }
        lines = [line for line, holds in told.items() if holds]
        if database is not None:
            return [*lines, *self.notes] + [f"decoded with {database}: {line}" for line in self.statistics.lines()]
        return lines + ([f"{errors:,} error frames"] if errors else [])


def moment(stamp: float) -> str:
    """A stamp as date and time."""
    return datetime.fromtimestamp(stamp, UTC).isoformat()
