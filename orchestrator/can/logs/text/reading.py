"""Logs that are lines of text, through python-can's readers: a line that cannot be read costs no other line.

The readers get their lines from a feed that knows where it is. When one fails, a new one is made that gets the header
again and goes on behind the line.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from enum import Enum, auto
from pathlib import Path
from typing import BinaryIO

import can

from fmus.errors import TraceError
from orchestrator.can.frames import Frames, from_messages
from orchestrator.can.logs.findings import Findings
from orchestrator.can.logs.messages import BATCH, oddity, shortened, silence

MAX_LINE = 1 << 12  # bytes


class LineKind(Enum):
    """What a line is from which no frame came."""

    NOTHING = auto()
    EVENT = auto()
    BROKEN = auto()


@dataclass(frozen=True)
class TextFormat:
    """What is particular about a format.

    Attributes:
        reader: python-can's reader of a file.
        header: under which name a line is kept for further readers, "" for a line that is not of the header.
        kind_of: what a line is from which no frame came.
        adapt: put right in a message what the reader does not take from its line.
        preamble: what a line at the beginning of the file begins with while the header lasts.
        behind_preamble: the line that ends the header for the reader, which would otherwise take the next for it.
    """

    reader: Callable[[Feed], Iterable[can.Message]]
    header: Callable[[str], str]
    kind_of: Callable[[str], LineKind]
    adapt: Callable[[can.Message, str], None]
    preamble: re.Pattern[str] | None = None
    behind_preamble: str = ""


@dataclass
class Feed:
    """The lines of a log as a file to read from, which says what became of them."""

    file: BinaryIO
    text_format: TextFormat
    findings: Findings
    offset: int = 0
    number: int = 0
    line: str = ""
    _waits: bool = False  # whether no frame has come yet from the line
    _start: int = 0
    _kept: dict[str, str] = field(default_factory=dict)
    _again: list[tuple[str, bool]] = field(default_factory=list)  # lines to give once more, and whether frames may come
    _in_preamble: bool = True

    def __next__(self) -> str:
        self.settle()
        if not self._again:
            self._again = self._read()
        self.line, self._waits = self._again.pop(0)
        return self.line

    def __iter__(self) -> Feed:
        return self

    def close(self) -> None:
        """Nothing: the file stays open for the next reader."""

    def came(self) -> None:
        """A frame came from the line."""
        self._waits = False

    def settle(self) -> None:
        """FileJudge the line where no frame came from it."""
        if not self._waits:
            return
        self._waits = False
        kind = self.text_format.kind_of(self.line)
        if kind is LineKind.BROKEN:
            self.complain("this line is no frame")
        elif kind is LineKind.EVENT:
            self.findings.skipped += 1

    def complain(self, problem: str) -> None:
        """Note the line as one that could not be read; a line of the header is not given again."""
        self.findings.add(self._start, problem, self.number)
        self._waits = False
        self._kept = {name: line for name, line in self._kept.items() if line != self.line}

    def rewind(self) -> None:
        """Give the header again, then what follows the line."""
        self._again = [(line, False) for line in self._kept.values()]

    def state(self) -> tuple[int, int]:
        """What changes when there is any progress."""
        return self.number, len(self._kept)

    def _read(self) -> list[tuple[str, bool]]:
        """The next line, behind the one that ends the preamble where it is the first after it."""
        line = self._next_line()
        while (name := self.text_format.header(line)) and self._kept.get(name) == line:
            line = self._next_line()  # logs that were put together repeat their header
        given = []
        preamble = self.text_format.preamble
        if self._in_preamble and preamble is not None and not preamble.match(line):
            self._in_preamble, end = False, self.text_format.behind_preamble
            self._kept[end] = end
            given.append((end, False))
        if name:
            self._kept[name] = line
        return [*given, (line, not name)]

    def _next_line(self) -> str:
        while True:
            self._start = self.offset
            raw = self.file.readline(MAX_LINE)
            if not raw:
                raise StopIteration
            self.number += 1
            self.offset += len(raw)
            if len(raw) == MAX_LINE and not raw.endswith(b"\n"):
                self._pass_over()
            elif text := _text(raw).strip():
                if not raw.endswith(b"\n"):
                    self.findings.add(self._start, "the last line has no end, what it says may be cut", self.number)
                return text

    def _pass_over(self) -> None:
        length = MAX_LINE
        while raw := self.file.readline(1 << 16):
            length += len(raw)
            if raw.endswith(b"\n"):
                break
        self.offset = self._start + length
        self.findings.add(self._start, f"a line of {length} bytes is no frame", self.number)


def frames(path: Path, text_format: TextFormat, findings: Findings) -> Iterator[tuple[Frames, float]]:
    """The frames in batches, in the order of the file, and the share of it that is read by then."""
    silence()
    size = path.stat().st_size
    with path.open("rb") as file:
        feed = Feed(file, text_format, findings)
        taken: list[can.Message] = []
        for message in _messages(feed):
            taken.append(message)
            if len(taken) == BATCH:
                yield from_messages(taken), min(1.0, feed.offset / size)
                taken = []
        yield from_messages(taken), 1.0


def _messages(feed: Feed) -> Iterator[can.Message]:
    before = (-1, -1)
    while before != feed.state():
        before = feed.state()
        try:
            for message in feed.text_format.reader(feed):
                feed.came()
                feed.text_format.adapt(message, feed.line)
                if problem := oddity(message):
                    feed.complain(problem)
                else:
                    yield message
            feed.settle()
            return
        except TraceError as refusal:
            raise TraceError(feed.file.name, refusal.problem, refusal.fix) from None
        except Exception as problem:  # whatever a reader does with lines it was not made for
            feed.complain(f"this line is no frame ({shortened(problem)})")
            feed.rewind()


def _text(raw: bytes) -> str:
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")
