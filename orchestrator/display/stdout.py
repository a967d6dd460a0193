"""Standard output belongs to the command's answer: what FMUs print while it works goes to standard error."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from collections.abc import Iterator


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


def _flush_native() -> None:
    """Let the C library write out what it still holds back, before standard output is the answer's again."""
    if os.name == "posix":
        ctypes.CDLL(None).fflush(None)
