"""What a process says of itself in memory that outlives it: its end, the FMUs it has loaded, what it leaves behind.

An FMU shares its process: one that ends it, crashes it or closes its descriptors leaves nothing but this.
"""

from __future__ import annotations

import json
import mmap
import struct
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic

SIZE = 1 << 16  # bytes; what does not fit is not said
_ENDED, _CODE, _HEARD, _SINCE, _PART, _TEXT = 0, 1, 2, 8, 16, 24  # where things are


class LastWords:
    """Words that one process writes and another one reads.

    Args:
        file: where they are, so that a process that is no fork can read them; without one, forks share them.
    """

    def __init__(self, file: Path | None = None) -> None:
        self._said: Counter[tuple[str, str]] = Counter()
        if file is None:
            self._memory = mmap.mmap(-1, SIZE)
            return
        with file.open("a+b") as opened:
            opened.truncate(SIZE)
            self._memory = mmap.mmap(opened.fileno(), SIZE)

    @property
    def code(self) -> int | None:
        """The exit code with which all was done; None where the process did not get so far."""
        return self._memory[_CODE] if self._memory[_ENDED] else None

    def end(self, code: int) -> None:
        """Say that all is done."""
        self._memory[_CODE], self._memory[_ENDED] = code & 255, 1

    @property
    def heard(self) -> int:
        """How many wishes to end were heard, up to 255."""
        return self._memory[_HEARD]

    def hear(self) -> None:
        """Say that a wish to end was heard."""
        self._memory[_HEARD] = min(255, self._memory[_HEARD] + 1)

    @property
    def part(self) -> int | None:
        """The part of its work, such as a case of a scenario, that the process is at; None where it is at none."""
        (number,) = struct.unpack_from("q", self._memory, _PART)
        return number - 1 if number > 0 else None

    @property
    def part_since(self) -> float | None:
        """When it has come to where it is, by the monotonic clock that all processes share [s]; None before."""
        (since,) = struct.unpack_from("d", self._memory, _SINCE)
        return float(since) or None

    @contextmanager
    def working_on(self, part: int) -> Iterator[None]:
        """Be at a part of the work, by its number from 0, while the block lasts."""
        self._come_to(part + 1)
        try:
            yield
        finally:
            self._come_to(0)

    def _come_to(self, number: int) -> None:
        struct.pack_into("d", self._memory, _SINCE, monotonic())  # first: who reads between takes it for younger
        struct.pack_into("q", self._memory, _PART, number)

    def said(self, kind: str) -> list[str]:
        """What was said of a kind and not taken back."""
        try:
            told = json.loads(self._memory[_TEXT:].rstrip(b"\0") or b"[]")
            return [str(text) for known, text in told if known == kind]
        except ValueError:  # the memory was spoilt
            return []

    def say(self, kind: str, text: str, times: int = 1) -> None:
        """Say something, or take it back."""
        known = bool(self._said[kind, text])
        self._said[kind, text] += times
        if known != bool(self._said[kind, text]):
            self._tell()

    def forget(self, kind: str) -> None:
        """Take back all that was said of a kind."""
        self._said = Counter({entry: count for entry, count in self._said.items() if entry[0] != kind})
        self._tell()

    def _tell(self) -> None:
        body = json.dumps([entry for entry, count in self._said.items() if count > 0]).encode()
        if len(body) <= SIZE - _TEXT:
            self._memory[_TEXT:] = body.ljust(SIZE - _TEXT, b"\0")

    @contextmanager
    def saying(self, kind: str, text: object) -> Iterator[None]:
        """Say something while the block lasts."""
        self.say(kind, str(text))
        try:
            yield
        finally:
            self.say(kind, str(text), -1)


FMU, OURS, GONE, LITTER = "FMU", "FMU of ours", "FMU that was closed", "litter"  # kinds of what is said
KILLED, SAVING = "killed by ours", "saving"  # why one of our processes kills the command, and what is still at work
_own = LastWords()


def own() -> LastWords:
    """Those of this process."""
    return _own


def begin(words: LastWords) -> LastWords:
    """Have this process say its last words there."""
    global _own  # noqa: PLW0603 (a process has one end)
    _own = words
    return words


def culprits(words: LastWords) -> str:
    """The FMUs that can have ended a process: those of others, or else all; empty where none was loaded."""
    names = words.said(FMU) or words.said(OURS) or words.said(GONE)
    return names[0] if len(names) == 1 else f"one of {', '.join(names)}" if names else ""
