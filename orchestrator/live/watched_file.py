"""A file of values that is watched while a run goes on: a line `component.variable=value` each, # begins a comment."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fmus.errors import InputError, ServotwinError
from orchestrator.live.beside import beside
from orchestrator.live.requests import Requests

LOG = logging.getLogger("servotwin.live")
LARGEST = 1 << 20  # bytes
_LOOK = 0.05  # between two looks [s]


@contextmanager
def watched(path: Path, requests: Requests) -> Iterator[None]:
    """What is in the file is asked for, now and, within the block, whenever its lines have changed.

    A file is read when two looks in a row have found it the same, for it may be in the middle of being written. What is
    wrong in it at first is an error, afterwards a warning.

    Raises:
        ServotwinError: a line does not fit; the message names it.
    """
    file = _RequestFile(path, requests)
    for problem in file.ask():
        raise problem
    with beside(file.watch, "watched file"):
        yield


class _RequestFile:
    """The file, and what was asked for in it."""

    def __init__(self, path: Path, requests: Requests) -> None:
        self._path, self._requests = path, requests
        self._read = _stamp(path)
        self._asked: dict[str, str] = {}  # name -> its line

    def watch(self, over: threading.Event) -> None:
        """Ask for what changes, until it is over."""
        before = self._read
        while not over.wait(_LOOK):
            stamp = _stamp(self._path)
            if stamp is not None and stamp == before != self._read:
                self._read = stamp
                self._tell()
            before = stamp

    def ask(self) -> Iterator[ServotwinError]:
        """Ask for the lines that are not as they were the last time; what is wrong with some."""
        seen = set()
        for number, line in enumerate(_lines(self._path), start=1):
            text = line.partition("#")[0].strip()
            name = text.partition("=")[0].strip()
            if name in seen:
                yield InputError(f"{self._path}:{number}", f"{name} has a value above already", "keep one")
            elif text and text != self._asked.get(name):
                self._asked[name] = text
                try:
                    self._requests.ask(text, self._path.name)
                except ServotwinError as error:
                    yield error.within(f"{self._path}:{number}")
            seen.add(name)
            seen.discard("")

    def _tell(self) -> None:
        try:
            for problem in self.ask():
                LOG.warning("%s", problem)
        except InputError as problem:
            LOG.warning("%s", problem)


def _stamp(path: Path) -> tuple[int, int, int] | None:
    """What tells whether a file is another, None while it is not there."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size, status.st_ino


def _lines(path: Path) -> list[str]:
    """Its lines."""
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST + 1)
        if len(content) > LARGEST:
            raise InputError(path, f"has more than {LARGEST} bytes", "keep a line a value")
        return content.decode().splitlines()
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})", "check its permissions") from None
    except UnicodeDecodeError:
        raise InputError(path, "is no text in UTF-8", "write lines like component.variable=value") from None
