"""What a recording of a bus is of, and how it went: its manifest."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import ClassVar

from fmus.errors import InputError, RecordError
from fmus.json_document import document_of, json_text
from orchestrator.can.database.sources import DatabaseFiles, paths
from orchestrator.can.frames import moment
from orchestrator.can.live.bus import BusSettings, OnBuses
from orchestrator.can.live.channels import Channel
from orchestrator.can.live.trigger import EVERYTHING, RecordingLimits, Trigger
from orchestrator.can.logs.rotation import LogFile, writer_of
from orchestrator.can.statistics import FrameStatistics
from orchestrator.results import versions

_ROOM = (65536, 4096)  # for the last manifest, the first that there is [bytes]
QUEUE = 65536  # frames that wait to be written at most


@dataclass(frozen=True)
class BusRecording(OnBuses):
    """What is recorded, where to, and for how long.

    Attributes:
        others: buses that are recorded into the same log; channels are numbered in this order, `bus` is 0.
        out: folder of the log files and of the manifest.
        database: of the bus, for counts by message; its text in this `encoding`, or in what it seems to be.
        duration: from the beginning, or from what starts it; None: until it is told to end [s].
        rotate_size, rotate_seconds: when a new file begins [bytes], [s].
        suffix: names the format.
        queue: frames of each bus that may wait to be written; more are dropped and counted.
        limits: conditions between which frames are recorded.

    Raises:
        InputError: the format cannot be written while frames come, or a bus is named twice.
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
    others: tuple[BusSettings, ...] = ()
    limits: RecordingLimits = EVERYTHING

    @property
    def database_names(self) -> str | None:
        """Names of the database's files, None where there is none."""
        return None if self.database is None else ", ".join(path.name for path in paths(self.database))

    def __post_init__(self) -> None:
        writer_of(self.suffix)
        places = [bus.place for bus in self.buses]
        if twice := next((place for place in places if places.count(place) > 1), None):
            raise InputError(twice, "is to be recorded twice", "give each --channel once")


@dataclass(frozen=True)
class RecordingManifest:
    """How a recording went.

    Attributes:
        stopped: None while it is not finished.
        ended: "unfinished", "duration", "condition", "stopped" or "failed".
        frames: that were recorded.
        unwritten: why the log could not be written any more, None where it could.
        bus_off: which channel's adapter left its bus, and the stamp of that [s].
        channels: the buses, by their number.
        trigger: what held when.
        statistics: of all frames; without a database their identifiers are all unknown.
        notes: what is not as in the database, a line each.
    """

    KEYS = (
        *("kind", "channels", "database=recording.database_names", "started", "stopped", "ended", "failure", "trigger"),
        *("frames", "dropped", "error_frames=statistics.errors", "bus_off=bus_off_times", "files", "found"),
        *("versions", "remarks"),
    )
    kind: ClassVar = "CAN recording"

    recording: BusRecording
    started: datetime
    stopped: datetime | None
    ended: str
    frames: int
    unwritten: str | None
    bus_off: tuple[tuple[int, float], ...]
    channels: tuple[Channel, ...]
    trigger: Trigger
    files: tuple[LogFile, ...]
    statistics: FrameStatistics
    notes: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=versions)

    @property
    def dropped(self) -> int:
        """Frames that came faster than they could be written."""
        return sum(channel.receiver.dropped for channel in self.channels)

    @property
    def failure(self) -> str | None:
        """What became of the log and of adapters that failed, None where none did."""
        lines = [
            f"{channel.settings.place}: {channel.failure}" for channel in self.channels if channel.failure is not None
        ]
        return "; ".join([*filter(None, [self.unwritten]), *lines]) or None

    @property
    def found(self) -> dict[str, object]:
        """What the statistics count; without a database the identifiers."""
        found: dict[str, object] = {**self.statistics.document()}
        if self.recording.database is None:
            found["identifiers"] = found.pop("unknown", {})
        return found

    @property
    def bus_off_times(self) -> list[str]:
        """When adapters left their buses."""
        return [moment(stamp) for _, stamp in self.bus_off]

    @property
    def remarks(self) -> list[str]:
        """What somebody should know about it, a line each."""
        database, errors = self.recording.database_names, self.statistics.errors
        places = " and ".join(self.recording.buses[number].place for number in {number for number, _ in self.bus_off})
        first = moment(self.bus_off[0][1]) if self.bus_off else ""
        came = self.frames - errors or self.trigger.watched
        told = {
            f"{self.dropped:,} frames were dropped: they came faster than they could be written": self.dropped,
            f"{places}: the adapter has left the bus (bus off), first at {first}": self.bus_off,
            "no frame came: see that the bit rate is that of the bus, and that somebody sends": not came,
        }
        lines = [line for line, holds in told.items() if holds]
        lines += self.trigger.remarks() if came else []
        lines += [line for channel in self.channels for line in channel.remarks(bool(came) and len(self.channels) > 1)]
        if database is not None:
            return [*lines, *self.notes] + [f"decoded with {database}: {line}" for line in self.statistics.lines()]
        return lines + ([f"{errors:,} error frames"] if errors else [])


class ManifestFile:
    """The manifest on disk, with room kept for its last writing: the disk may be full by then."""

    def __init__(self, folder: Path) -> None:
        self._path, self._fresh = folder / "manifest.json", folder / ".manifest.json"

    def write(self, manifest: RecordingManifest) -> None:
        """Put it in the place of the one before; into that where there is no room for another.

        Raises:
            RecordError: there is no room for it at all.
        """
        text = json_text(document_of(manifest))
        try:
            _overwrite(self._fresh, text)
            self._fresh.replace(self._path)
        except OSError as error:
            self._write_into(text, error, manifest.frames)
        if manifest.ended == "unfinished":
            self._reserve()

    def _write_into(self, text: str, error: OSError, frames: int) -> None:
        """Write it into the one before, whose last block has room for a little more; else that one stays."""
        self._free()
        before = self._path.read_text(encoding="utf-8") if self._path.is_file() else ""
        try:
            _overwrite(self._path, text)
        except OSError:
            with suppress(OSError):
                _overwrite(self._path, before) if before else self._path.unlink()
            problem = f"cannot be written ({error.strerror or error})"
            raise RecordError(self._path, problem, f"make room on the disk; {frames:,} frames are kept") from error

    def _reserve(self) -> None:
        for size in _ROOM:
            try:
                self._fresh.write_bytes(bytes(size))
            except OSError:  # less may fit
                self._free()
            else:
                return

    def _free(self) -> None:
        with suppress(OSError):
            self._fresh.unlink(missing_ok=True)


def _overwrite(path: Path, text: str) -> None:
    """Write a file over what it has held, whose room it keeps until then."""
    with path.open("r+b" if path.exists() else "wb") as file:
        file.write(text.encode())
        file.truncate()
