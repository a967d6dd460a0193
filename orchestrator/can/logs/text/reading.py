"""Logs that are lines of text: most lines many at once, those that look otherwise one by one, with what is wrong."""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from orchestrator.can.frames import Frames, concatenated
from orchestrator.can.log_suffixes import first_lines, opened
from orchestrator.can.logs.findings import COARSE, Findings
from orchestrator.can.logs.text.form import HeaderState, InterfaceNumbers, LogReading, TextFormat
from orchestrator.can.logs.text.lines import TextLines, lines_of
from orchestrator.can.logs.text.rows import FoundRows, LogRow, NoFrameError, nothing, with_rows
from orchestrator.trace import BoolArray

MAX_LINE = 1 << 12  # bytes
BLOCK = 1 << 19  # bytes that are taken apart at once
FINE = re.compile(r"(?<!\d)\d{10}\.\d{8}|-\d\d[T ]\d\d:\d\d:\d\d[.,]\d{8}")  # dates of more digits than a double has
FEW = 16  # lines, for which it does not pay
INFLATED, UNSUSPICIOUS = 250, 1 << 26  # times a packed log may grow; bytes that need no such check


class LineBlock(NamedTuple):
    """Whole lines of the file.

    Attributes:
        offset: of the first in the (unpacked) file [bytes].
        number: of the first, from 1.
    """

    offset: int
    number: int
    text: bytes


def frames(path: Path, text_format: TextFormat[Any], findings: Findings) -> Iterator[tuple[Frames, float]]:
    """The frames in batches, in the order of the file, and the share of it that is read by then."""
    size = path.stat().st_size
    reading, lines = LogReading(findings, InterfaceNumbers(findings)), first_lines(path)
    reader = _BlockReader(text_format, text_format.state(lines, reading), reading)
    if any(FINE.search(line) for line in lines):
        findings.note(COARSE)
    with path.open("rb") as raw, opened(path, raw) as file:
        for block in _blocks(file, raw, findings):
            yield reader.read(block), min(1.0, raw.tell() / size)


class _BlockReader:
    """Turns blocks into frames, and remembers what the header said."""

    def __init__(self, text_format: TextFormat[Any], state: HeaderState, reading: LogReading) -> None:
        self._format, self._state, self._reading = text_format, state, reading
        self._clock = 0.0  # the sum of stamps that count from the line before
        self._firsts = np.isin(np.arange(256), list(text_format.first))

    def read(self, block: LineBlock) -> Frames:
        """The frames of the next lines."""
        lines = lines_of(block.text)
        parts: list[Frames] = []
        heads: set[int] = set()
        begin = 0
        for place in np.flatnonzero(~self._of_frames(lines)).tolist():
            try:
                state = self._format.header(lines.text(place), self._state, self._reading)
            except NoFrameError as problem:
                self._complain(block, lines, place, str(problem))
                state = self._state
            if state is not None:
                heads.add(place)
            if state is not None and state != self._state:
                parts.append(self._part(block, lines, begin, place, heads))
                self._state, begin = state, place
        parts.append(self._part(block, lines, begin, len(lines), heads))
        return concatenated(parts)

    def _of_frames(self, lines: TextLines) -> BoolArray:
        """(n,) which lines begin as those of frames do."""
        return np.asarray(self._firsts[lines.starts(lines.trimmed(lines.whole, 8))])

    def _part(self, block: LineBlock, lines: TextLines, begin: int, behind: int, heads: set[int]) -> Frames:
        """The frames of lines that one header is valid for."""
        part = lines[begin:behind]
        many = nothing(len(part)) if len(part) < FEW else self._format.many(part, self._state, self._reading)
        if b"\0" in block.text:  # NumPy's texts end before zeros
            many = FoundRows(many.frames, many.sound & ~_with_zeros(block, lines)[begin:behind])
        rows: dict[int, LogRow] = {}
        for place in np.flatnonzero(~many.sound).tolist():
            row = None if begin + place in heads else self._row(block, lines, begin + place)
            if row is not None:
                rows[place] = row
                self._reading.findings.skipped += not row.frame
        if self._state.relative:
            many, rows = self._added_up(many, rows)
        frames, origin = with_rows(many, rows), self._state.origin
        return replace(frames, time=self._reading.findings.dated(origin, frames.time)) if origin else frames

    def _row(self, block: LineBlock, lines: TextLines, place: int) -> LogRow | None:
        length = int(lines.whole.length[place])
        if length > MAX_LINE:
            self._complain(block, lines, place, f"a line of {length + 1} bytes is no frame")
            return None
        text = lines.text(place)
        try:
            row: LogRow | None = self._format.one(text, self._state, self._reading) if text else None
        except NoFrameError as problem:
            self._complain(block, lines, place, f"this line is no frame: {problem}")
            return None
        return row

    def _complain(self, block: LineBlock, lines: TextLines, place: int, problem: str) -> None:
        offset = block.offset + int(lines.whole.begin[place] - lines.whole.begin[0])
        self._reading.findings.add(offset, problem, block.number + place)

    def _added_up(self, many: FoundRows, rows: dict[int, LogRow]) -> tuple[FoundRows, dict[int, LogRow]]:
        """Stamps from the start where they count from the line before."""
        steps = np.where(many.sound, many.frames.time, 0.0)
        for place, row in rows.items():
            steps[place] = row.time
        time = np.round(self._clock + np.cumsum(steps), 9)
        self._clock = float(time[-1]) if len(time) else self._clock
        moved = {place: replace(row, time=float(time[place])) for place, row in rows.items()}
        return FoundRows(replace(many.frames, time=time), many.sound), moved


def _with_zeros(block: LineBlock, lines: TextLines) -> BoolArray:
    """(n,) which lines have a zero byte."""
    places = np.flatnonzero(np.frombuffer(block.text, dtype=np.uint8) == 0) + lines.whole.begin[0]
    found = np.zeros(len(lines), dtype=bool)
    found[np.searchsorted(lines.whole.begin, places, side="right") - 1] = True
    return found


def _blocks(file: BinaryIO, raw: BinaryIO, findings: Findings) -> Iterator[LineBlock]:
    """The file in whole lines; a line that does not end for long is passed over."""
    offset, number, rest, passed = 0, 1, b"", 0
    while chunk := _chunk(file, raw, offset, findings):
        if passed or (len(rest) > MAX_LINE and b"\n" not in chunk):
            end = chunk.find(b"\n")
            passed, rest = passed + len(rest) + (len(chunk) if end < 0 else end + 1), b""
            if end < 0:
                continue
            findings.add(offset, f"a line of {passed} bytes is no frame", number)
            offset, number, passed, chunk = offset + passed, number + 1, 0, chunk[end + 1 :]
        text = rest + chunk
        cut = text.rfind(b"\n") + 1
        text, rest = text[:cut], text[cut:]
        if text:
            yield LineBlock(offset, number, text)
            offset, number = offset + cut, number + text.count(b"\n")
    if passed:
        findings.add(offset, f"a line of {passed} bytes is no frame", number)
    elif rest.strip():
        findings.add(offset, "the last line has no end, what it says may be cut", number)
        yield LineBlock(offset, number, rest + b"\n")


def _chunk(file: BinaryIO, raw: BinaryIO, offset: int, findings: Findings) -> bytes:
    """The next bytes, of a packed file as far as it is sound and no trap."""
    if file is raw:
        return file.read(BLOCK)
    if offset > max(UNSUSPICIOUS, INFLATED * raw.tell()):
        findings.add(offset, f"the file unpacks to more than {INFLATED} times its size; not read on")
        return b""
    got = b""
    try:
        while len(got) < BLOCK and (piece := file.read1(BLOCK)):  # type: ignore[attr-defined]
            got += piece
    except (OSError, EOFError, zlib.error) as problem:
        if not got:
            findings.add(offset, f"the packed file cannot be unpacked from about here on ({problem})")
    return got
