"""Logs written in any of the formats, whole or not at all, and never with something left out in silence.

What a format cannot hold is counted for a caller who asks for it, and refused otherwise.
"""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from can import Message
from can.io import ASCWriter, CanutilsLogWriter, CSVWriter, TRCWriter
from can.io.generic import MessageWriter

from fmus.errors import TraceError
from fmus.files import atomic_write
from orchestrator.can.frames import Flag, Frames
from orchestrator.can.logs import sqlite
from orchestrator.can.logs.blf import writing as blf_writing
from orchestrator.can.logs.messages import silence
from orchestrator.can.logs.mf4 import records as mf4_records


@dataclass(frozen=True)
class Holds:
    """What a format can hold of a frame besides stamp, identifier and up to eight data bytes.

    Attributes:
        fd, remote, error: such frames at all.
        error_content: identifier and data of an error frame.
        earlier: stamps before the first frame's.
    """

    fd: bool = True
    remote: bool = True
    error: bool = True
    error_content: bool = True
    error_sent: bool = True
    sent: bool = True
    channel: bool = True
    earlier: bool = True


FORMATS = {
    ".asc": Holds(error_content=False, error_sent=False, earlier=False),
    ".blf": Holds(error_sent=False, earlier=False),
    ".csv": Holds(fd=False, sent=False, channel=False),
    ".db": Holds(fd=False, sent=False, channel=False),
    ".log": Holds(error_content=False, error_sent=False, earlier=False),
    ".mf4": Holds(),
    ".trc": Holds(fd=False, remote=False, error=False),
}


def write(
    path: str | Path, batches: Iterable[Frames], database: Path | None = None, lost: Counter[str] | None = None
) -> int:
    """Number of frames in the log that was written; it is there as a whole or not at all.

    Args:
        database: file that an .mf4 log carries along.
        lost: counts what the format cannot hold; where it is not given, such a log is refused.

    Raises:
        TraceError: an unknown suffix, something that the format cannot hold, or stamps that are no dates.
    """
    target = Path(path)
    holds = FORMATS.get(target.suffix.lower())
    if holds is None:
        raise TraceError(target, f"a log in the format '{target.suffix}' is not known", f"use {', '.join(FORMATS)}")
    count = 0

    def content(file: BinaryIO) -> None:
        nonlocal count
        fitting = _fitting(batches, holds, target, lost)
        count = _fill(file, target, fitting, database)

    try:
        atomic_write(target, content)
    except (ValueError, OverflowError) as problem:
        if isinstance(problem, TraceError):
            raise
        raise TraceError(target, f"cannot hold these time stamps ({problem})", "check them") from None
    return count


def _fill(file: BinaryIO, target: Path, batches: Iterator[Frames], database: Path | None) -> int:
    suffix, part = target.suffix.lower(), Path(file.name)
    if suffix == ".mf4":
        return mf4_records.fill(file, batches, database)
    if suffix == ".blf":
        return blf_writing.fill(file, batches)
    if suffix == ".db":
        return sqlite.fill(part, batches)
    silence()
    count = 0
    with WRITERS[suffix](part, target) as writer:
        for batch in batches:
            for message in batch.messages():
                writer.on_message_received(message)
            count += len(batch)
    return count


def _fitting(batches: Iterable[Frames], holds: Holds, target: Path, lost: Counter[str] | None) -> Iterator[Frames]:
    """The frames as the format can hold them."""
    first = None
    for batch in batches:
        if first is None and len(batch):
            first = float(batch.time[0])
        kept, missing = _reduced(batch, holds, first or 0.0)
        if missing and lost is None:
            what, count = missing.most_common(1)[0]
            raise TraceError(
                target,
                f"the format does not hold {what} ({count} in a row of {len(batch)} frames)",
                "write .mf4 or .blf",
            )
        if lost is not None:
            lost.update(missing)
        yield kept


def _reduced(batch: Frames, holds: Holds, first: float) -> tuple[Frames, Counter[str]]:
    """What is left of a batch, and what had to go."""
    missing: Counter[str] = Counter()
    error, remote = batch.has(Flag.ERROR), batch.has(Flag.REMOTE) & ~batch.has(Flag.ERROR)
    whole = {
        "error frames": error & (not holds.error),
        "remote frames": remote & (not holds.remote),
        "CAN FD frames": batch.has(Flag.FD) & ~error & ~remote & (not holds.fd),
    }
    gone = np.zeros(len(batch), bool)
    for what, rows in whole.items():
        gone |= rows
        missing[what] = int(np.count_nonzero(rows))
    content = (batch.id != 0) | (batch.length != 0)
    parts = {
        "what error frames hold": error & content & (not holds.error_content),
        "that error frames were sent": error & batch.has(Flag.SENT) & (not holds.error_sent),
        "that frames were sent": ~error & batch.has(Flag.SENT) & (not holds.sent),
        "channels": (batch.channel != 0) & (not holds.channel),
        "stamps before the first frame's": (batch.time < first) & (not holds.earlier),
    }
    missing.update({what: int(np.count_nonzero(rows & ~gone)) for what, rows in parts.items()})
    time = batch.time if holds.earlier else np.maximum(batch.time, first)
    kept = Frames(time, batch.id, batch.flags, batch.channel, batch.length, batch.data)
    return kept[~gone] if gone.any() else kept, +missing


class AscWriter(ASCWriter):
    """python-can's writer with dates in UTC, three digits for their milliseconds, and stamps that count from there."""

    def log_event(self, message: str, timestamp: float | None = None) -> None:
        if not self.header_written:
            self.header_written = True
            self.started = self.last_timestamp = int((timestamp or 0.0) * 1000) / 1000
            start = self._format_header_datetime(datetime.fromtimestamp(self.started, UTC))
            self.file.write(f"Begin Triggerblock {start}\n")
            super().log_event("Start of measurement")
        super().log_event(message, timestamp)

    def _format_header_datetime(self, dt: datetime) -> str:
        return dt.strftime(self.FORMAT_DATE.format(f"{dt.microsecond // 1000:03d}"))


class CandumpWriter(CanutilsLogWriter):
    """python-can's writer with how many bytes remote frames ask for, as candump has it."""

    def on_message_received(self, msg: Message) -> None:
        file, line = self.file, io.StringIO()
        self.file = line
        super().on_message_received(msg)
        self.file = file
        text = line.getvalue()
        asked = msg.is_remote_frame and msg.dlc
        file.write(text.replace("#R", f"#R{msg.dlc}", 1) if asked else text)


def _trc(part: Path, target: Path) -> MessageWriter:
    writer = TRCWriter(part)
    writer.filepath = target.name
    return writer


def _plain(kind: Callable[..., MessageWriter]) -> Callable[[Path, Path], Any]:
    return lambda part, target: kind(part)


WRITERS: dict[str, Callable[[Path, Path], Any]] = {
    ".asc": _plain(AscWriter),
    ".csv": _plain(CSVWriter),
    ".log": _plain(CandumpWriter),
    ".trc": _trc,
}
