"""Log files of CAN buses: any of them as batches of frames, and back, behind one table from suffix to format.

What can be read of a damaged log is read; the rest is located. Frames stay what they are: nothing is decoded here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from fmus.errors import TraceError
from orchestrator.can.frames import Frames
from orchestrator.can.log_suffixes import PACKED, PACKED_PROBLEM, SHARED, SUFFIXES, is_log, suffix_of, text_format
from orchestrator.can.logs import sqlite
from orchestrator.can.logs.blf import reading as blf
from orchestrator.can.logs.findings import Damage, Findings
from orchestrator.can.logs.mf4 import reading as mf4
from orchestrator.can.logs.text import reading as text
from orchestrator.can.logs.text.formats import FORMATS
from orchestrator.can.logs.writing import write
from orchestrator.progress import Progress, silent
from orchestrator.trace import check_file

__all__ = ["SUFFIXES", "Damage", "LogReader", "is_log", "read", "write"]

ReadFrames = Callable[[Path, Findings], Iterator[tuple[Frames, float]]]  # batches, and the share read by then

BATCH = 1 << 16  # frames that are handed out at once, at most


BINARY: dict[str, ReadFrames] = {".blf": blf.frames, ".db": sqlite.frames, ".mf4": mf4.frames}


class LogReader:
    """The frames of a log in batches, each time from the beginning when it is iterated over.

    Attributes:
        path: the file.
        findings: what came up in the last iteration, complete at its end.
        channels: names of interfaces by the number of their channel, as far as frames have been read.
    """

    def __init__(self, path: Path, read_frames: ReadFrames, progress: Progress = silent) -> None:
        self.path, self.findings = path, Findings()
        self.channels: dict[int, str] = {}
        self._read_frames, self._progress = read_frames, progress

    @property
    def damage(self) -> list[Damage]:
        """The places that could not be read (the first of them where there are very many)."""
        return self.findings.damage

    def __iter__(self) -> Iterator[Frames]:
        """Batches of at most 65,536 frames in the order of the log.

        Raises:
            TraceError: there is nothing in the file that can be read as such a log.
        """
        self.findings = findings = Findings(channels=self.channels)
        count = 0
        doing = f"reading {self.path.name}"
        for batch, share in self._read_frames(self.path, findings):
            count += len(batch)
            for first in range(0, len(batch), BATCH):
                yield batch[first : first + BATCH]
            self._progress(share, doing)
        if count == 0 and findings.damaged:
            raise TraceError(
                self.path,
                f"holds no frame that can be read ({findings.damage[0]})",
                f"check that it is a {suffix_of(self.path)} log",
            )
        self._progress(1.0, doing)


def read(path: str | Path, progress: Progress = silent) -> LogReader:
    """The frames of a log, as they are needed.

    Args:
        progress: told the share of the file that is read.

    Raises:
        TraceError: no such file, an empty one, or a format that is not known; or what comes up while reading.
    """
    file = Path(path)
    check_file(file)
    if not is_log(file):
        if suffix_of(file) in BINARY and file.suffix.lower() == PACKED:
            raise TraceError(file, PACKED_PROBLEM, f"gunzip {file.name}")
        if suffix_of(file) == ".mf4":
            raise TraceError(file, "holds no CAN frames but measured channels", "read it as a recording, without --dbc")
        shared = suffix_of(file) in SHARED
        fix = "its first lines are those of no format of frames" if shared else f"use {', '.join(SUFFIXES)}"
        raise TraceError(file, "is no log of CAN frames that is known", fix)
    return LogReader(file, BINARY.get(suffix_of(file)) or _lines(text_format(file)), progress)


def _lines(name: str) -> ReadFrames:
    return lambda path, findings: text.frames(path, FORMATS[name], findings)
