"""Log files that are written while frames come: one after the other, each whole on disk up to the last second."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import can

from fmus.errors import InputError, RecordError
from fmus.files import sha256
from orchestrator.can.logs.writing import AscWriter, CandumpWriter


@dataclass
class LogFile:
    """A file and what is in it; stamps of its first and latest frame [s], None where it has none."""

    KEYS = ("file=path.name", "frames", "bytes", "first", "last", "sha256")

    path: Path
    frames: int = 0
    first: float | None = None
    last: float | None = None
    sha256: str = ""

    @property
    def bytes(self) -> int:
        """Size of the file so far."""
        return self.path.stat().st_size


class _BlfWriter(can.BLFWriter):
    """python-can's, which would keep frames until 128 KiB have come, and the header until the end."""

    def sync(self) -> None:
        self._flush()
        end = self.file.tell()
        self.file.seek(0)
        self._write_header(end)
        self.file.seek(end)
        self.file.flush()


_NAMING, _WORD = (".log",), re.compile(r"[A-Za-z_]\w*")  # formats with words for channels, and what a word is
WRITERS: dict[str, Any] = {".blf": _BlfWriter, ".asc": AscWriter, ".log": CandumpWriter}


def writer_of(suffix: str) -> Any:
    """python-can's writer of the format that a suffix names.

    Raises:
        InputError: the format cannot be written while frames come.
    """
    if suffix not in WRITERS:
        raise InputError(
            f"--format {suffix.lstrip('.')}",
            "cannot be written frame by frame and without loss",
            f"choose {', '.join(suffix.lstrip('.') for suffix in WRITERS)}; `servotwin trace convert` makes "
            "other formats of it",
        )
    return WRITERS[suffix]


class LogFiles:
    """Writes frames to `name_0001.blf`, `name_0002.blf`, ...

    A new file begins when one has reached its size or age, and with a frame whose stamp is before the file's first:
    logs count from their first frame, and a clock that was set back would be lost.

    Args:
        suffix: names the format.
        size: of a file at most, up to the frames of one call [bytes]; None: any.
        seconds: for which a file is written at most; None: any.
        channels: names of the channels by their number; formats that name channels have these.

    Raises (any method):
        InputError: the format cannot be written while frames come, or the file cannot be made.
        RecordError: the file cannot be written any more; what was whole of it is kept, and the log is closed.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        suffix: str,
        size: float | None,
        seconds: float | None,
        channels: Sequence[str] = (),
    ) -> None:
        self._make_writer = writer_of(suffix)
        self._folder, self._name, self._suffix = folder, name, suffix
        self._size, self._seconds = size, seconds
        self._names = dict(enumerate(channels)) if suffix in _NAMING and all(map(_WORD.fullmatch, channels)) else {}
        self.files: list[LogFile] = []
        self._whole: tuple[int, LogFile] | None = None  # what the disk has for certain: bytes, and what they hold
        self._writer: Any = None
        self._open()

    def write(self, messages: Sequence[can.Message]) -> None:
        """Add frames."""
        try:
            if messages and self._is_full():
                self._next()
            for message in messages:
                self._add(message)
        except OSError as error:
            raise self._unwritable(error) from error
        if messages and not isinstance(self._writer, _BlfWriter):  # whose containers are the better the larger
            self.sync()

    def sync(self) -> None:
        """Let the file hold all frames so far, whatever becomes of this process."""
        try:
            if isinstance(self._writer, _BlfWriter):
                self._writer.sync()
            else:
                self._writer.file.flush()
            self._whole = self.files[-1].path.stat().st_size, replace(self.files[-1])
        except OSError as error:
            raise self._unwritable(error) from error

    def close(self) -> None:
        """Finish the file, see it on the disk, and know its hash."""
        if self._writer is None:
            return
        try:
            self._writer.stop()
            self._writer = None
            _flush_to_disk(self.files[-1].path)
            self.files[-1].sha256 = sha256(self.files[-1].path)
        except OSError as error:
            raise self._unwritable(error) from error

    def _add(self, message: can.Message) -> None:
        file = self.files[-1]
        if file.first is not None and message.timestamp < file.first:
            self._next()
            file = self.files[-1]
        number = message.channel
        if isinstance(number, int):
            message.channel = self._names.get(number, number)
        self._writer.on_message_received(message)
        message.channel = number
        file.frames += 1
        file.first = message.timestamp if file.first is None else file.first
        file.last = message.timestamp

    def _is_full(self) -> bool:
        if not self.files[-1].frames:
            return False
        large = self._size is not None and self._writer.file_size() >= self._size
        return large or (self._seconds is not None and time.monotonic() - self._opened >= self._seconds)

    def _next(self) -> None:
        self.close()
        self._open()

    def _open(self) -> None:
        path = self._folder / f"{self._name}_{len(self.files) + 1:04d}{self._suffix}"
        try:
            self._writer = self._make_writer(path)
        except OSError as error:
            raise InputError(path, f"cannot be written ({error.strerror})", "give another --out") from error
        self.files.append(LogFile(path))
        self._whole = None
        self._opened = time.monotonic()
        self.sync()

    def _unwritable(self, error: OSError) -> RecordError:
        """What is wrong with the file, when it has been cut to what is whole of it."""
        path, writer, self._writer = self.files[-1].path, self._writer, None
        if writer is not None:
            with suppress(OSError, ValueError):
                writer.file.close()
        size, self.files[-1] = self._whole or (0, LogFile(path))
        with suppress(OSError):
            os.truncate(path, size)
            self.files[-1].sha256 = sha256(path)
        kept = sum(file.frames for file in self.files)
        problem = f"cannot be written ({error.strerror or error})"
        return RecordError(path, problem, f"make room on the disk; {kept:,} frames up to there are kept")


def _flush_to_disk(path: Path) -> None:
    with path.open("rb+") as file:
        os.fsync(file.fileno())
