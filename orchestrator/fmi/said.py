"""What FMUs say: like messages are shown a few times and counted, all of them are kept where a file is given.

Processes that simulate for this one write to the same file, a line at a time.
"""

from __future__ import annotations

import logging
import os
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

LOG = logging.getLogger("servotwin.fmu")
LOG_FILE = "fmu.log"  # in a result
SHOWN = 3  # messages that differ in nothing but numbers
LARGEST = 256_000_000  # of the file, after which nothing more is kept [bytes]
_MOST_KINDS = 1000  # that are told apart
_NUMBER = re.compile(r"[-+]?\.?\d[\w.]*(?:[eE][-+]\d+)?")


class _Repeats(logging.Filter):
    """Lets the first few messages of a kind through.

    Attributes:
        everything: takes all messages.
    """

    def __init__(self) -> None:
        super().__init__()
        self.everything: logging.Handler | None = None
        self._counts: Counter[tuple[str, str]] = Counter()
        self._first: dict[tuple[str, str], logging.LogRecord] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        if self.everything is not None:
            self.everything.handle(record)
        name, _, text = record.getMessage().partition(": ")
        kind = name, _NUMBER.sub("#", text)
        if kind not in self._first and len(self._first) >= _MOST_KINDS:
            return False
        self._first.setdefault(kind, record)
        self._counts[kind] += 1
        return self._counts[kind] <= SHOWN

    def sum_up(self, name: str) -> None:
        """Say how many more messages an instance of this name had, and forget them."""
        for kind, first in list(self._first.items()):
            if kind[0] == name:
                more = self._counts.pop(kind) - SHOWN
                del self._first[kind]
                if more > 0:
                    LOG.callHandlers(_about(first, more))


def _about(first: logging.LogRecord, more: int) -> logging.LogRecord:
    """That there were more messages like this one."""
    text = f"{first.getMessage()} (... {more:,} more like this)"
    return logging.LogRecord(first.name, first.levelno, first.pathname, first.lineno, text, None, None)


REPEATS = _Repeats()
LOG.addFilter(REPEATS)


class _Keeper(logging.FileHandler):
    """Writes messages until the file is full, and then that it is."""

    def __init__(self, file: Path) -> None:
        super().__init__(file, encoding="utf-8", delay=True)
        self.setFormatter(logging.Formatter("%(levelname)s %(message)s"))
        self._full = False

    def emit(self, record: logging.LogRecord) -> None:
        if self._full:
            return
        if self.stream is not None and os.fstat(self.stream.fileno()).st_size > LARGEST:
            text = f"the file is full with {LARGEST / 1e6:.0f} MB, what FMUs said from here on is not in it"
            record, self._full = logging.makeLogRecord({"levelname": "WARNING", "msg": text}), True
        super().emit(record)


def kept_in() -> Path | None:
    """The file that has all that FMUs say now."""
    return Path(handler.baseFilename) if isinstance(handler := REPEATS.everything, _Keeper) else None


@contextmanager
def kept(file: Path | None, *, shown: bool = True) -> Iterator[None]:
    """Have all that FMUs say in a file, which is not there where they say nothing.

    Args:
        shown: whether it is logged as well.
    """
    if file is None:
        yield
        return
    handler, level, passed_on = _Keeper(file), LOG.level, LOG.propagate
    LOG.setLevel(logging.DEBUG)
    if not shown:
        LOG.propagate = False
        LOG.addHandler(logging.NullHandler())
    REPEATS.everything = handler
    try:
        yield
    finally:
        REPEATS.everything = None
        LOG.setLevel(level)
        LOG.propagate = passed_on
        handler.close()


@dataclass(frozen=True)
class Said:
    """Messages that differ in nothing but numbers.

    Attributes:
        level: of logging, such as "WARNING".
        text: the first of them.
        count: of them.
    """

    level: str
    text: str
    count: int

    def __str__(self) -> str:
        return self.text if self.count == 1 else f"{self.text} (one of {self.count:,} like this)"


def counted(file: Path) -> list[Said]:
    """What is in a file that was `kept`, in the order of the first ones; nothing where it is not there."""
    if not file.is_file():
        return []
    first, counts = dict[str, tuple[str, str]](), Counter[str]()
    with file.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            level, _, text = line.rstrip("\n").partition(" ")
            kind = f"{level} {_NUMBER.sub('#', text)}"
            if kind not in first and len(first) >= _MOST_KINDS:
                kind, text = f"{level} others", "others"
            first.setdefault(kind, (level, text))
            counts[kind] += 1
    return [Said(*first[kind], count) for kind, count in counts.items()]
