"""What FMUs say: like messages are shown a few times and counted, all of them are kept where a file is given."""

from __future__ import annotations

import logging
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LOG = logging.getLogger("servotwin.fmu")
SHOWN = 3  # messages that differ in nothing but numbers
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


@contextmanager
def kept(file: Path | None) -> Iterator[None]:
    """Have all that FMUs say in a file, which is not there where they say nothing."""
    if file is None:
        yield
        return
    handler, level = logging.FileHandler(file, encoding="utf-8", delay=True), LOG.level
    handler.setFormatter(logging.Formatter("%(levelname)s %(message)s"))
    LOG.setLevel(logging.DEBUG)
    REPEATS.everything = handler
    try:
        yield
    finally:
        REPEATS.everything = None
        LOG.setLevel(level)
        handler.close()
