"""BusRecording a bus: log files and a manifest in a folder, with everything that was received, however it ends.

A thread receives; frames are written every few hundredths of a second, and are on disk within a second.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import can

from fmus.errors import BusError, InputError
from orchestrator.can import frame_time, frames
from orchestrator.can.codec.decoding import Decoder
from orchestrator.can.database.database import Database, load
from orchestrator.can.live.bus import BusSettings, is_bus_off, opened
from orchestrator.can.live.receiver import Receiver
from orchestrator.can.logs.rotation import LogFiles, writer_of
from orchestrator.can.statistics import FrameStatistics
from orchestrator.realtime.pacing import quiet
from orchestrator.realtime.stopping import Stop, stop_requests
from orchestrator.results import versions, write_json

LOG = logging.getLogger("servotwin.can")
QUEUE = 65536  # frames that wait to be written at most
_MOST = 100  # times at which the adapter left the bus that are kept
_PERIOD = 0.05  # between two writes [s]
_SYNC = 0.5  # between two times that the file is made whole [s]


@dataclass(frozen=True)
class BusRecording:
    """What is recorded, where to, and for how long.

    Attributes:
        out: folder of the log files and of the manifest.
        database: of the bus, for counts by message.
        duration: None: until it is told to end [s].
        rotate_size, rotate_seconds: when a new file begins [bytes], [s].
        suffix: names the format.
        queue: frames that may wait to be written; more are dropped and counted.

    Raises:
        InputError: the format cannot be written while frames come.
    """

    bus: BusSettings
    out: Path
    database: Path | None = None
    duration: float | None = None
    rotate_size: float | None = None
    rotate_seconds: float | None = None
    suffix: str = ".blf"
    queue: int = QUEUE

    def __post_init__(self) -> None:
        writer_of(self.suffix)


@dataclass(frozen=True)
class Status:
    """How a recording is going: over all, and over the latest second or so.

    Attributes:
        elapsed: since it began [s].
        frames, dropped, errors: so far.
        rate: [frames/s].
        load: share of the time in which the bus was busy, at most; None where no bit rate is given.
    """

    elapsed: float
    frames: int
    dropped: int
    errors: int
    rate: float
    load: float | None


@dataclass
class _Counts:
    """What has been seen."""

    statistics: FrameStatistics
    decoder: Decoder | None
    bitrates: tuple[int | None, int | None]
    frames: int = 0
    busy: float = 0.0
    bus_off: list[float] = field(default_factory=list)  # stamps [s]

    def add(self, messages: Sequence[can.Message]) -> None:
        """Count frames."""
        if not messages:
            return
        self.frames += len(messages)
        batch = frames.from_messages(messages)
        if self.decoder is not None:
            self.decoder.feed(batch)
        else:
            self._count_identifiers(messages)
        nominal, data = self.bitrates
        if nominal is not None:
            self.busy += sum(
                frame_time.seconds(
                    message.dlc,
                    message.is_extended_id,
                    message.is_remote_frame,
                    message.is_fd,
                    nominal,
                    data if message.bitrate_switch else None,
                )
                for message in messages
                if not message.is_error_frame
            )
        self.bus_off += [message.timestamp for message in messages if is_bus_off(message)][: _MOST - len(self.bus_off)]

    def document(self) -> dict[str, Any]:
        """The statistics; frames by identifier where there is no database."""
        found = self.statistics.document()
        if self.decoder is None:
            found["identifiers"] = found.pop("unknown", {})
        return found

    def _count_identifiers(self, messages: Sequence[can.Message]) -> None:
        self.statistics.frames += len(messages)
        for message in messages:
            if message.is_error_frame:
                self.statistics.errors += 1
            else:
                self.statistics.add_unknown(message.arbitration_id, message.is_extended_id)


def record(
    recording: BusRecording,
    progress: Callable[[Status], None] = lambda status: None,
    ready: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Record until the duration is over, Ctrl-C or SIGTERM comes, or the bus fails; the manifest's document.

    Args:
        ready: called when every frame from now on will be recorded.

    Raises:
        InputError: the folder holds something, or cannot be written; the database cannot be read.
        BusError: the adapter does not open, or failed; what had been received is on disk.
    """
    database = None if recording.database is None else load(recording.database)
    _check_free(recording.out)
    with (
        quiet(),  # takes a while, in which frames would wait for their stamps, so it comes first
        stop_requests() as stop,
        opened(recording.bus) as bus,
        Receiver(bus, recording.queue) as receiver,
    ):
        _make(recording.out)
        session = _BusRecorder(recording, bus, receiver, database)
        ready()
        document = session.run(stop, progress)
    if session.failure is not None:
        raise BusError(
            recording.bus.place,
            f"failed after {document['frames']:,} frames ({session.failure})",
            f"they are kept in {recording.out}",
        )
    return document


class _BusRecorder:
    """One recording while it is made."""

    def __init__(self, recording: BusRecording, bus: can.BusABC, receiver: Receiver, database: Database | None) -> None:
        settings = recording.bus
        decoder = None if database is None else Decoder(database)
        self._recording, self._bus, self._receiver = recording, bus, receiver
        self._counts = _Counts(
            decoder.statistics if decoder else FrameStatistics(), decoder, (settings.bitrate, settings.data_bitrate)
        )
        self._log = LogFiles(
            recording.out,
            recording.out.resolve().name,
            recording.suffix,
            recording.rotate_size,
            recording.rotate_seconds,
        )
        self._started = datetime.now(UTC)
        self._begin = self._synced = time.monotonic()
        self._recent: deque[tuple[float, int, float]] = deque(maxlen=25)  # when, frames, busy: the latest second or so
        self.failure: Exception | None = None

    def run(self, stop: Stop, progress: Callable[[Status], None]) -> dict[str, Any]:
        """Record; the manifest's document, which is on disk."""
        ended = "unfinished"
        try:
            self._write_manifest(ended)
            while not stop.requested and not self._over() and self._receiver.failure is None:
                stop.sleep_until(time.monotonic() + _PERIOD)
                self._work()
                progress(self._status())
            self._receiver.finish()
            self._work()
            ended = self._ending()
        finally:
            try:
                self._log.close()
            finally:
                document = self._write_manifest(ended)
        self.failure = self._receiver.failure
        return document

    def _over(self) -> bool:
        duration = self._recording.duration
        return duration is not None and time.monotonic() - self._begin >= duration

    def _ending(self) -> str:
        if self._receiver.failure is not None:
            return "failed"
        return "duration" if self._over() else "stopped"

    def _work(self) -> None:
        """Write and count what has come."""
        messages = self._receiver.take()
        self._log.write(messages)
        off = self._counts.bus_off
        known = len(off)
        self._counts.add(messages)
        for stamp in off[known:]:
            LOG.warning("%s: the adapter has left the bus (bus off) at %s", self._recording.bus.place, _iso(stamp))
        now = time.monotonic()
        if now - self._synced >= _SYNC:
            self._log.sync()
            self._synced = now

    def _status(self) -> Status:
        now, counts = time.monotonic(), self._counts
        self._recent.append((now, counts.frames, counts.busy))
        then, frames_then, busy_then = self._recent[0]
        past = max(now - then, _PERIOD)
        load = None if counts.bitrates[0] is None else (counts.busy - busy_then) / past
        return Status(
            now - self._begin,
            counts.frames,
            self._receiver.dropped,
            counts.statistics.errors,
            (counts.frames - frames_then) / past,
            load,
        )

    def _write_manifest(self, ended: str) -> dict[str, Any]:
        recording, bus, counts = self._recording, self._recording.bus, self._counts
        document = {
            "kind": "CAN recording",
            "interface": bus.interface,
            "channel": bus.channel,
            "bitrate": bus.bitrate,
            "fd": bus.fd,
            "data_bitrate": bus.data_bitrate,
            "options": dict(bus.options),
            "database": None if recording.database is None else recording.database.name,
            "started": self._started.isoformat(),
            "stopped": None if ended == "unfinished" else datetime.now(UTC).isoformat(),
            "ended": ended,
            "failure": None if self._receiver.failure is None else str(self._receiver.failure),
            "frames": counts.frames,
            "dropped": self._receiver.dropped,
            "error_frames": counts.statistics.errors,
            "bus_off": [_iso(stamp) for stamp in counts.bus_off],
            "malformed_lines": getattr(self._bus, "malformed", 0),
            "refused_lines": getattr(self._bus, "refused", 0),
            "files": [file.document() for file in self._log.files],
            "found": counts.document(),
            "versions": versions(),
        }
        document["remarks"] = _remarks(document, counts.statistics)
        fresh = recording.out / ".manifest.json"
        write_json(fresh, document)
        fresh.replace(recording.out / "manifest.json")
        return document


def _remarks(document: dict[str, Any], found: FrameStatistics) -> list[str]:
    """What somebody should know about a recording: a line each."""
    lines = {
        "{dropped:,} frames were dropped: they came faster than they could be written": document["dropped"],
        "the adapter has left the bus (bus off), first at {bus_off[0]}": document["bus_off"],
        "{malformed_lines:,} lines from the adapter were no frames: noise, or another baud rate of the port": document[
            "malformed_lines"
        ],
        "the adapter refused {refused_lines:,} commands": document["refused_lines"],
        "no frame came: see that the bit rate is that of the bus, and that somebody sends": document["frames"]
        == document["error_frames"],
    }
    said = [text.format(**document) for text, holds in lines.items() if holds]
    if document["database"] is not None:
        return said + [f"decoded with {document['database']}: {line}" for line in found.lines()]
    return said + ([f"{found.errors:,} error frames"] if found.errors else [])


def _check_free(out: Path) -> None:
    """See that there is nothing in the folder, if there is one.

    Raises:
        InputError: there is something in it; a recording is never overwritten.
    """
    try:
        taken = out.exists() and any(out.iterdir())
    except OSError as error:
        raise InputError(out, f"cannot be written ({error.strerror})", "give another --out") from error
    if taken:
        raise InputError(out, "is not empty, and recordings are not overwritten", "give another --out")


def _make(out: Path) -> None:
    """Make the folder, once there is a bus to record.

    Raises:
        InputError: it cannot be made.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(out, f"cannot be written ({error.strerror})", "give another --out") from error


def _iso(stamp: float) -> str:
    return datetime.fromtimestamp(stamp, UTC).isoformat()
