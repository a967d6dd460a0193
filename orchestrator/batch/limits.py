"""How much time and memory a case of the suite may take, and who looks that it does not take more."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

from fmus.errors import InputError
from orchestrator.processes.last_words import LastWords

MEGABYTE = 1 << 20
_STATUS = "/proc/{pid}/statm"


@dataclass(frozen=True)
class CaseLimits:
    """What a case may take before its process is killed; None is no limit.

    Attributes:
        seconds: wall time of a case, and of all that comes before the first one and after the last [s].
        megabytes: resident memory of the process that runs it.

    Raises:
        InputError: no time, no memory, or a system that does not tell how much memory a process has.
    """

    seconds: float | None = None
    megabytes: float | None = None

    def __post_init__(self) -> None:
        for name, value in {"--time-limit": self.seconds, "--memory-limit": self.megabytes}.items():
            if value is not None and not 0 < value < float("inf"):
                raise InputError(name, f"is {value:g}", "give more than 0")
        if self.megabytes is not None and not Path(_STATUS.format(pid=os.getpid())).exists():
            raise InputError("--memory-limit", "cannot be looked after on this system", "leave it out")

    def __bool__(self) -> bool:
        return self.seconds is not None or self.megabytes is not None

    def exceeded(self, pid: int, words: LastWords, begun: float) -> str:
        """Why the process with this id is to be killed, "" where it keeps within the limits.

        Args:
            words: what it says of itself.
            begun: when it was given its task, by the monotonic clock [s].
        """
        if self.seconds is not None and monotonic() - max(words.part_since or 0.0, begun) > self.seconds:
            return f"was killed after {self.seconds:g} s, the limit of a case"
        if self.megabytes is not None and (taken := resident(pid) / MEGABYTE) > self.megabytes:
            return f"was killed with {taken:.0f} MB of memory, over the {self.megabytes:g} MB of a case"
        return ""


def resident(pid: int) -> int:
    """Resident memory of a process; 0 where it has ended [bytes]."""
    if sys.platform == "win32":
        raise OSError("Windows does not tell how much memory a process has")
    try:
        pages = int(Path(_STATUS.format(pid=pid)).read_text().split()[1])
    except (OSError, IndexError, ValueError):
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")
