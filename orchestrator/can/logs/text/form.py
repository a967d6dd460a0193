"""What a format of text has to say: how its header changes what lines mean, and what a line or many of them hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from orchestrator.can.logs.findings import Findings
from orchestrator.can.logs.text.lines import Positions, TextField, TextLines
from orchestrator.can.logs.text.rows import FoundRows, LogRow, NoFrameError
from orchestrator.trace import BoolArray

MOST = 256  # interfaces


@dataclass
class InterfaceNumbers:
    """Numbers of interfaces that have names: the number in a name where it is free, else the first free one."""

    findings: Findings
    numbers: dict[str, int] = field(default_factory=dict)

    def add(self, names: Sequence[str]) -> None:
        """Give numbers to those that have none: names with numbers choose first."""
        fresh = [name for name in dict.fromkeys(names) if name not in self.numbers][: MOST - len(self.numbers)]
        for name in sorted(fresh, key=lambda name: _number(name) is None):
            taken, number = set(self.numbers.values()), _number(name)
            if number is None or number in taken:
                number = next(free for free in range(len(taken) + 1) if free not in taken)
            self.numbers[name] = number
            self.findings.channels[number] = name
            if name not in (f"can{number}", str(number)):
                self.findings.note(f"interface {name} is channel {number}")

    def of(self, name: str) -> int:
        """The number of an interface."""
        self.add([name])
        if name not in self.numbers:
            raise NoFrameError(f"its interface is one of more than {MOST}")
        return self.numbers[name]

    def many(self, lines: TextLines, names: TextField, rows: BoolArray) -> Positions:
        """(n,) the numbers of the interfaces in some lines, -1 in the others."""
        found, places = lines.names(names, rows, MOST)
        self.add(found)
        return np.array([*(self.numbers.get(name, -1) for name in found), -1])[places]


def _number(name: str) -> int | None:
    digits = name[len(name.rstrip("0123456789")) :]
    return int(digits) if digits and len(digits) <= 3 and int(digits) < 256 else None


@dataclass(frozen=True)
class HeaderState:
    """What a header says; formats add their own.

    Attributes:
        start: POSIX time from which stamps count [s].
        relative: stamps count from the line before.
    """

    start: float = 0.0
    relative: bool = False

    @property
    def origin(self) -> float:
        """What is added to stamps [s]."""
        return self.start


S = TypeVar("S", bound=HeaderState)


@dataclass
class LogReading:
    """What is found, and which interface is which channel, while a log is read."""

    findings: Findings
    channels: InterfaceNumbers


@dataclass(frozen=True)
class TextFormat(Generic[S]):
    """A format.

    Attributes:
        state: from the first lines, before any is read.
        first: characters with which lines of frames begin; others may be of the header.
        header: the state after a line of the header, None for another line. Raises NoFrameError for a broken one.
        one: the frame or event in a line, None where it holds nothing. Raises NoFrameError.
        many: the frames of the lines that look as most do.
    """

    state: Callable[[Sequence[str], LogReading], S]
    first: bytes
    header: Callable[[str, S, LogReading], S | None]
    one: Callable[[str, S, LogReading], LogRow | None]
    many: Callable[[TextLines, S, LogReading], FoundRows]
