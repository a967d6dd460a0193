"""Recording a bus: log files and a manifest in a folder, with everything that was received, however it ends.

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

import can

from fmus.errors import BusError, InputError
from orchestrator.can import frame_time, frames
from orchestrator.can.codec.decoding import Decoder
from orchestrator.can.database.bus import LogDatabase, load_all
from orchestrator.can.live.bus import is_bus_off, opened
from orchestrator.can.live.manifest import BusRecording, RecordingManifest, moment
from orchestrator.can.live.receiver import Receiver
from orchestrator.can.logs.rotation import LogFiles
from orchestrator.can.statistics import FrameStatistics
from orchestrator.progress import Progress, silent
from orchestrator.realtime.pacing import quiet
from orchestrator.realtime.stopping import Stop, stop_requests
from orchestrator.results import write_json

LOG = logging.getLogger("servotwin.can")
_MOST = 100  # times at which the adapter left the bus that are kept
_PERIOD = 0.05  # between two writes [s]
_SYNC = 0.5  # between two times that the file is made whole [s]


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

    def _count_identifiers(self, messages: Sequence[can.Message]) -> None:
        self.statistics.frames += len(messages)
        for message in messages:
            if message.is_error_frame:
                self.statistics.errors += 1
            else:
                self.statistics.add_unknown(message.arbitration_id, message.is_extended_id)


def record(
    recording: BusRecording,
    progress: Progress = silent,
    ready: Callable[[], None] = lambda: None,
) -> RecordingManifest:
    """Record until the duration is over, Ctrl-C or SIGTERM comes, or the bus fails; how it went.

    Args:
        progress: told the share of the duration (0 where there is none), and how it is going.
        ready: called when every frame from now on will be recorded.

    Raises:
        InputError: the folder holds something, or cannot be written; the database cannot be read.
        BusError: the adapter does not open, or failed; what had been received is on disk.
    """
    database = None if recording.database is None else load_all(recording.database, recording.encoding)
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
        manifest = session.run(stop, progress)
    if session.failure is not None:
        raise BusError(
            recording.bus.place,
            f"failed after {manifest.frames:,} frames ({session.failure})",
            f"they are kept in {recording.out}",
        )
    return manifest


class _BusRecorder:
    """One recording while it is made."""

    def __init__(
        self, recording: BusRecording, bus: can.BusABC, receiver: Receiver, database: LogDatabase | None
    ) -> None:
        settings = recording.bus
        decoder = None if database is None else Decoder(database)
        self._notes = () if database is None else tuple(database.notes)
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

    def run(self, stop: Stop, progress: Progress) -> RecordingManifest:
        """Record; the manifest, which is on disk."""
        ended = "unfinished"
        try:
            self._write_manifest(ended)
            while not stop.requested and not self._over() and self._receiver.failure is None:
                stop.sleep_until(time.monotonic() + _PERIOD)
                self._work()
                self._tell(progress)
            self._receiver.finish()
            self._work()
            ended = self._ending()
        finally:
            try:
                self._log.close()
            finally:
                manifest = self._write_manifest(ended)
        self.failure = self._receiver.failure
        return manifest

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
            LOG.warning("%s: the adapter has left the bus (bus off) at %s", self._recording.bus.place, moment(stamp))
        now = time.monotonic()
        if now - self._synced >= _SYNC:
            self._log.sync()
            self._synced = now

    def _tell(self, progress: Progress) -> None:
        """Tell how it is going: over all, and over the latest second or so."""
        now, counts, duration = time.monotonic(), self._counts, self._recording.duration
        self._recent.append((now, counts.frames, counts.busy))
        then, frames_then, busy_then = self._recent[0]
        past = max(now - then, _PERIOD)
        parts = [f"{counts.frames:,} frames", f"{(counts.frames - frames_then) / past:,.0f}/s"]
        if counts.bitrates[0] is not None:
            parts.append(f"load {100 * (counts.busy - busy_then) / past:.0f} %")
        for count, what in ((self._receiver.dropped, "dropped"), (counts.statistics.errors, "error frames")):
            parts += [f"{count:,} {what}"] if count else []
        progress(min((now - self._begin) / duration, 1.0) if duration else 0.0, ", ".join(parts))

    def _write_manifest(self, ended: str) -> RecordingManifest:
        recording, counts, failure = self._recording, self._counts, self._receiver.failure
        manifest = RecordingManifest(
            recording=recording,
            started=self._started,
            stopped=None if ended == "unfinished" else datetime.now(UTC),
            ended=ended,
            failure=None if failure is None else str(failure),
            frames=counts.frames,
            dropped=self._receiver.dropped,
            bus_off=tuple(counts.bus_off),
            malformed=getattr(self._bus, "malformed", 0),
            refused=getattr(self._bus, "refused", 0),
            files=tuple(self._log.files),
            statistics=counts.statistics,
            notes=self._notes,
        )
        fresh = recording.out / ".manifest.json"
        write_json(fresh, manifest.document())
        fresh.replace(recording.out / "manifest.json")
        return manifest


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
