"""What work would take of the memory that there is, known before it takes any."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from fmus.errors import InputError

PLENTY = 64 << 20  # bytes that are never asked about


def available() -> float:
    """Memory that can be had without swapping [bytes]; infinite where the system does not tell."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return 1024 * float(next(line.split()[1] for line in lines if line.startswith("MemAvailable")))
    except (OSError, StopIteration, ValueError):
        if sys.platform == "win32":
            return float("inf")
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))


def require(place: object, what: str, size: float, fix: str) -> None:
    """See that there is so much memory [bytes].

    Raises:
        InputError: there is not; the message has `what` takes it, both figures and the fix.
    """
    if size > PLENTY and size > (there := available()):
        raise InputError(place, f"{what} would take {_gigabytes(size)} of memory, {_gigabytes(there)} are there", fix)


def _gigabytes(size: float) -> str:
    return f"{size / 1e9:,.3g} GB" if size < 1e12 else f"{size / 1e9:,.0f} GB"
