"""Processes that a test has started, directly or not, found by a mark in their environment."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

MARK = "SERVOTWIN_TEST_MARK"


def started() -> list[tuple[int, str]]:
    """Processes with this test's mark but this one: id and command line."""
    mark, found = f"{MARK}={os.environ[MARK]}".encode(), []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and mark in (entry / "environ").read_bytes():
                found.append((int(entry.name), (entry / "cmdline").read_bytes().decode(errors="replace")))
        except OSError:  # gone, a zombie, or somebody else's
            continue
    return [each for each in found if each[0] != os.getpid()]


def children(pid: int) -> list[int]:
    """The processes that one has started."""
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def workers() -> list[int]:
    return [number for number, command in started() if "isolation_worker" in command]


def waited_for(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)
