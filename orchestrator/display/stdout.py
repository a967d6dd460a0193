"""Standard output belongs to the command's answer: what FMUs print while it works goes to standard error.

Whoever reads a stream may have read enough, and may have given a command none.
"""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
import sys
from collections.abc import Iterator
from typing import IO, Any

from fmus.errors import InputError


@contextlib.contextmanager
def stdout_kept() -> Iterator[None]:
    """Prints of Python code and of native libraries, in this process and those it starts, go to standard error."""
    sys.stdout.flush()
    kept = os.dup(1)
    try:
        os.dup2(2, 1)
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        _flush_native()
        os.dup2(kept, 1)
        os.close(kept)


def unread(name: str) -> None:
    """Let what is said on this stream ("stdout", "stderr") from now on, and what is held back of it, go nowhere."""
    setattr(sys, name, _nowhere("w"))


def unwritable(problem: OSError) -> InputError:
    """The error of an answer that cannot be written; what is left of it goes nowhere."""
    unread("stdout")
    reason = problem.strerror or str(problem)
    return InputError("standard output", f"cannot be written ({reason})", "send it elsewhere")


def all_there() -> None:
    """Have standard streams that are closed lead nowhere, lest what is opened next takes their numbers.

    Into standard output nothing can be written then, as before: an answer is not lost without a word. What cannot be
    told on standard error is no fault of who tells it.
    """
    for name, mode, access in (("stdin", "r", os.O_RDWR), ("stdout", "w", os.O_RDONLY), ("stderr", "w", os.O_RDWR)):
        if getattr(sys, name) is None:
            setattr(sys, name, _nowhere(mode, access))
    told = io.BufferedWriter(_Forgiving(sys.stderr.fileno(), "wb", closefd=False))
    sys.stderr = io.TextIOWrapper(told, sys.stderr.encoding, sys.stderr.errors, line_buffering=True)


class _Forgiving(io.FileIO):
    """A file that takes all: what its disk or its reader does not is lost."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError:
            return memoryview(data).nbytes


def _nowhere(mode: str, access: int = os.O_RDWR) -> IO[Any]:
    descriptor = os.open(os.devnull, access)
    os.set_inheritable(descriptor, True)
    return os.fdopen(descriptor, mode, closefd=False)


def _flush_native() -> None:
    """Let the C library write out what it still holds back, before standard output is the answer's again."""
    if os.name == "posix":
        ctypes.CDLL(None).fflush(None)
