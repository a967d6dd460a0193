"""How much memory a process has had at most."""

from __future__ import annotations

from pathlib import Path


def peak_megabytes() -> float:
    """Peak resident memory of this process, and of no other [MB]; Linux only.

    What getrusage tells is at least the memory of the process that this one was started by.
    """
    status = Path("/proc/self/status").read_text().splitlines()
    return float(next(line.split()[1] for line in status if line.startswith("VmHWM"))) / 1024
