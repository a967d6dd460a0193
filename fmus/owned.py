"""Folders, and files being written, that belong to a process: when that is dead, the next one that looks removes them.

The process holds a lock on each, which the system lets go of however the process ends.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

if sys.platform != "win32":
    import fcntl

MARK = ".servotwin-"  # in the names of all, so that nothing else is taken for one

_YOUNG = 5.0  # a file may not be held yet [s]


def create(parent: Path, name: str) -> tuple[Path, int]:
    """A new folder for files of this process that have to do with `name`, and the descriptor that holds its lock.

    Raises:
        OSError: it cannot be made.
    """
    while True:
        folder = parent / f"{name}{MARK}{os.urandom(4).hex()}"
        folder.mkdir(mode=0o700)
        descriptor = _lock(folder)
        if folder.is_dir():  # another process may have thought it left behind
            return folder, -1 if descriptor is None else descriptor


def sweep(parent: Path, name: str) -> None:
    """Remove the folders of dead processes that have to do with `name`."""
    with suppress(OSError):
        for folder in [Path(entry) for entry in os.scandir(parent) if entry.name.startswith(name + MARK)]:
            if folder.is_symlink() or not hasattr(os, "getuid") or folder.stat().st_uid != os.getuid():
                continue
            descriptor = _lock(folder)
            if descriptor is not None:
                shutil.rmtree(folder, ignore_errors=True)
                os.close(descriptor)


@contextmanager
def owned_folder(parent: Path, name: str) -> Iterator[Path]:
    """A folder while the block lasts; those that dead processes left under this name go first.

    Raises:
        OSError: it cannot be made.
    """
    sweep(parent, name)
    folder, descriptor = create(parent, name)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        with suppress(OSError):  # an FMU may have closed it
            os.close(descriptor)


def hold(file: BinaryIO) -> None:
    """Mark an open file as one of a living process."""
    if sys.platform != "win32":
        with suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def sweep_files(parent: Path, start: str, end: str) -> None:
    """Remove the files that processes held which are dead, named so at both ends of eight characters."""
    with suppress(OSError):
        for entry in os.scandir(parent):
            named = entry.name.startswith(start) and entry.name[len(start) + 8 :] == end
            if not named or time.time() - entry.stat(follow_symlinks=False).st_mtime < _YOUNG:
                continue
            descriptor = _lock(Path(entry))
            if descriptor is not None:
                Path(entry).unlink()
                os.close(descriptor)


def _lock(folder: Path) -> int | None:
    """The descriptor that holds a folder's lock now; None where another process has it, or there are no locks."""
    if sys.platform != "win32":
        try:
            descriptor = os.open(folder, os.O_RDONLY)
        except OSError:
            return None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(descriptor)
            return None
        return descriptor
    return None
