"""Recording buses: log files and a manifest in a folder, with everything that was received, however it ends.

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

from fmus.errors import BusError, InputError, RecordError
from orchestrator.can import frames
from orchestrator.can.codec.decoding import Decoder
from orchestrator.can.database.bus import LogDatabase, load_all
from orchestrator.can.frames import moment
from orchestrator.can.live.bus import BusSettings, is_bus_off, occupied
from orchestrator.can.live.channels import Channels, listening
from orchestrator.can.live.manifest import BusRecording, ManifestFile, RecordingManifest
from orchestrator.can.live.news import ErrorStates, News, troubles
from orchestrator.can.live.trigger import Trigger
from orchestrator.can.logs.rotation import LogFiles
from orchestrator.can.statistics import FrameStatistics
from orchestrator.progress import Figures, Progress, silent
from orchestrator.realtime.pacing import quiet
from orchestrator.realtime.stopping import Stop, stop_requests

LOG = logging.getLogger("servotwin.can")
_MOST = 100  # times at which the adapter left the bus that are kept
_PERIOD = 0.05  # between two writes [s]
_SYNC = 0.5  # between two times that the file is made whole [s]


@dataclass
class _Counts:
    """What has been seen."""

    statistics: FrameStatistics
    decoder: Decoder | None
    buses: Sequence[BusSettings]
    frames: int = 0
    busy: float = 0.0  # over all buses [s]
    bus_off: list[tuple[int, float]] = field(default_factory=list)  # channel, stamp [s]
    states: ErrorStates = field(default_factory=ErrorStates)

    def add(self, messages: Sequence[can.Message]) -> None:
        """Count frames."""
        if not messages:
            return
        self.frames += len(messages)
        if self.decoder is not None:
            self.decoder.feed(frames.from_messages(messages))
        else:
            self._count_identifiers(messages)
        self.busy += sum(occupied(message, self.buses[_number(message)]) for message in messages)
        self.states.add(messages)
        off = [(_number(message), message.timestamp) for message in messages if is_bus_off(message)]
        self.bus_off += off[: _MOST - len(self.bus_off)]

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
    """Record until the duration is over, a condition holds, Ctrl-C or SIGTERM comes, or all buses fail; how it went.

    Args:
        progress: told the share of the duration (0 where there is none), and how it is going.
        ready: called when every frame from now on will be recorded.

    Raises:
        InputError: the folder holds something, or cannot be written; the database cannot be read; a condition is not
            understood.
        BusError: an adapter does not open, or failed; what had been received is on disk.
        RecordError: the disk is full; what had been written is kept.
    """
    database = None if recording.database is None else load_all(recording.database, recording.encoding)
    trigger = Trigger(recording.limits, database, [bus.channel for bus in recording.buses])
    _check_free(recording.out)
    with (
        quiet(),  # takes a while, in which frames would wait for their stamps, so it comes first
        stop_requests() as stop,
        listening(recording.buses, recording.queue) as channels,
    ):
        _make(recording.out)
        session = _BusRecorder(recording, channels, trigger, database)
        ready()
        manifest = session.run(stop, progress)
    if session.unwritten is not None:
        raise session.unwritten
    if channels.failed:
        raise BusError(
            " and ".join(channel.settings.place for channel in channels.failed),
            f"failed after {manifest.frames:,} frames ({channels.failed[0].receiver.failure})",
            f"they are kept in {recording.out}",
        )
    return manifest


class _BusRecorder:
    """One recording while it is made."""

    def __init__(
        self, recording: BusRecording, channels: Channels, trigger: Trigger, database: LogDatabase | None
    ) -> None:
        names = dict(enumerate(bus.channel for bus in recording.buses))
        decoder = None if database is None else Decoder(database, channels=names)
        self._notes = () if database is None else tuple(database.notes)
        self._recording, self._channels, self._trigger = recording, channels, trigger
        self._lost: list[str] = []
        self._counts = _Counts(decoder.statistics if decoder else FrameStatistics(), decoder, recording.buses)
        self._log = LogFiles(
            recording.out,
            recording.out.resolve().name,
            recording.suffix,
            recording.rotate_size,
            recording.rotate_seconds,
            list(names.values()),
        )
        self._file = ManifestFile(recording.out)
        self.unwritten: RecordError | None = None
        self._news = News(lambda line: LOG.warning("%s: %s", recording.places, line))
        self._started = datetime.now(UTC)
        self._begin = self._synced = time.monotonic()
        self._recent: deque[tuple[float, int, float]] = deque(maxlen=25)  # when, frames, busy: the latest second or so

    def run(self, stop: Stop, progress: Progress) -> RecordingManifest:
        """Record; the manifest, which is on disk."""
        ended = "unfinished"
        try:
            self._write_manifest(ended)
            while not stop.requested and not self._over() and len(self._lost) < len(self._channels.all):
                stop.sleep_until(time.monotonic() + _PERIOD)
                self._work()
                self._tell(progress)
            self._channels.finish()
            self._work(last=True)
            ended = self._ending()
            self._log.close()
        except RecordError as error:
            self.unwritten, ended = error, "failed"
            self._channels.finish()
        finally:
            self._log.close()
            manifest = self._write_manifest(ended)
        return manifest

    def _over(self) -> bool:
        return self._trigger.stopped is not None or self._is_long_enough()

    def _is_long_enough(self) -> bool:
        duration = self._recording.duration
        return duration is not None and not self._trigger.waiting and time.monotonic() - self._begin >= duration

    def _ending(self) -> str:
        if self._channels.failed:
            return "failed"
        if self._trigger.stopped is not None:
            return "condition"
        return "duration" if self._over() else "stopped"

    def _work(self, last: bool = False) -> None:
        """Write and count what has come."""
        waited = self._trigger.waiting
        messages = self._trigger.passed(self._channels.take(last))
        if waited and not self._trigger.waiting:
            self._begin = time.monotonic()
            LOG.warning("%s holds: recording since %s", self._recording.limits.start, moment(messages[0].timestamp))
        self._log.write(messages)
        off = self._counts.bus_off
        known = len(off)
        self._counts.add(messages)
        for number, stamp in off[known:]:
            place = self._recording.buses[number].place
            LOG.warning("%s: the adapter has left the bus (bus off) at %s", place, moment(stamp))
        self._tell_of_lost()
        now = time.monotonic()
        if now - self._synced >= _SYNC:
            self._log.sync()
            self._synced = now

    def _tell_of_lost(self) -> None:
        """Say of which bus nothing comes any more, while others go on."""
        for channel in self._channels.failed:
            if channel.settings.place not in self._lost:
                self._lost.append(channel.settings.place)
                if len(self._lost) < len(self._channels.all):
                    LOG.warning("%s: lost (%s); the others go on", channel.settings.place, channel.receiver.failure)

    def _tell(self, progress: Progress) -> None:
        """Tell how it is going: over all, and over the latest second or so."""
        now, counts, duration = time.monotonic(), self._counts, self._recording.duration
        self._news.look(now - self._begin, self._troubles)
        self._recent.append((now, counts.frames, counts.busy))
        then, frames_then, busy_then = self._recent[0]
        past = max(now - then, _PERIOD)
        figures: dict[str, float] = {
            "frames": counts.frames,
            "frames_per_s": round((counts.frames - frames_then) / past),
        }
        parts = [f"{counts.frames:,} frames", f"{figures['frames_per_s']:,}/s"]
        if all(bus.bitrate for bus in counts.buses):
            load = (counts.busy - busy_then) / past / len(counts.buses)
            figures |= {"load": round(load, 4)}
            parts.append(f"load {100 * load:.0f} %")
        if self._trigger.waiting:
            parts.append(f"waiting for {self._recording.limits.start} ({self._trigger.watched:,} frames seen)")
        told = {what: count for what, count in self._troubles().items() if count}
        parts += [f"{count:,} {what}" for what, count in told.items()]
        line = Figures.of(", ".join(parts), figures | told)
        progress(min((now - self._begin) / duration, 1.0) if duration else 0.0, line)

    def _troubles(self) -> dict[str, int]:
        """Words for what is not as it should be -> how often it was."""
        pauses = sum(channel.receiver.pause_count for channel in self._channels.all)
        counts = self._counts
        lost = {
            "frames dropped": self._channels.dropped,
            "pauses in reading": pauses,
            "lines of the adapter that are no frames": sum(channel.malformed for channel in self._channels.all),
            "refusals of the adapter (BEL)": sum(channel.refused for channel in self._channels.all),
        }
        return troubles(counts.statistics) | counts.states.counts | lost

    def _write_manifest(self, ended: str) -> RecordingManifest:
        recording, counts = self._recording, self._counts
        manifest = RecordingManifest(
            recording=recording,
            started=self._started,
            stopped=None if ended == "unfinished" else datetime.now(UTC),
            ended=ended,
            frames=sum(file.frames for file in self._log.files),
            unwritten=None if self.unwritten is None else str(self.unwritten),
            bus_off=tuple(counts.bus_off),
            channels=self._channels.all,
            trigger=self._trigger,
            files=tuple(self._log.files),
            statistics=counts.statistics,
            notes=self._notes,
        )
        self._file.write(manifest)
        return manifest


def _number(message: can.Message) -> int:
    """Of the channel that a received frame came over."""
    assert isinstance(message.channel, int)
    return message.channel


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
