"""Folders of unpacked FMUs: all in this process that open equal files share one, so that its library is loaded once.

A folder goes when the last who took it has given it back; in a process that keeps them, those that are wanted again
go with it.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
from collections import Counter, deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from zipfile import ZipFile, ZipInfo

from fmus.errors import FmuFileError
from fmus.files import sha256
from fmus.packaging import archive
from orchestrator.processes.interrupts import UNPACKED

_NEVER_RUN = ("sources/", "documentation/")  # what an FMU may not look for where it runs; to write it takes long
_lock = threading.Lock()
_shared: dict[str, Path] = {}  # hash of a file -> where it is unpacked
_users: Counter[Path] = Counter()
_given_back: deque[tuple[Path, bool]] = deque()  # and whether for those who open an equal file later
_keeping = False


def keep() -> None:
    """Have this process keep folders for files that are opened again; its temporary files are removed with it."""
    global _keeping  # noqa: PLW0603 (there is one set of folders in a process)
    _keeping = True


def take(path: Path, alone: bool) -> Path:
    """The folder that an FMU is unpacked in, to be given back; with `alone` it is nobody else's.

    Raises:
        FmuFileError: see `archive.opened`; what the archive raises where its contents are damaged.
    """
    digest = sha256(path)
    try:
        with _lock:
            folder = None if alone else _shared.get(digest)
            if folder is None or not folder.is_dir():
                folder = _unpack(path)
                if not alone:
                    _shared[digest] = folder
            _users[folder] += 1
        return folder
    finally:
        _settle()


def give_back(folder: Path, again: bool = False) -> None:
    """Let go of a folder that was taken; the last one removes it.

    Args:
        again: whether it is still as it was unpacked, for those who open an equal file later.
    """
    _given_back.append((folder, again))
    _settle()


def _settle() -> None:
    """Let go of what was given back, or leave it to whoever is at it.

    That may be this very thread: the garbage collector closes systems that nobody has closed wherever it runs.
    """
    while _given_back and _lock.acquire(blocking=False):
        try:
            while _given_back:
                _let_go(*_given_back.popleft())
        finally:
            _lock.release()


def _let_go(folder: Path, again: bool) -> None:
    _users[folder] -= 1
    if _users[folder] or (_keeping and again):
        return
    del _users[folder]
    for digest in [known for known, shared in _shared.items() if shared == folder]:
        del _shared[digest]
    shutil.rmtree(folder, ignore_errors=True)


def _unpack(path: Path) -> Path:
    folder = Path(tempfile.mkdtemp(prefix=UNPACKED))
    try:
        with archive.opened(path) as zipped:
            size, free = sum(info.file_size for info in zipped.infolist()), shutil.disk_usage(folder).free
            if size > free:
                problem = f"unpacks to {size:,} bytes, and {free:,} are free in {folder.parent}"
                raise FmuFileError(path, problem, "make space, or set TMPDIR")
            for info in zipped.infolist():
                if not info.filename.startswith(_NEVER_RUN):
                    _extract(zipped, info, folder)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return folder


def _extract(zipped: ZipFile, info: ZipInfo, folder: Path) -> None:
    """Write an entry, and let what could be executed before be executed: FMUs bring programs along."""
    there = Path(zipped.extract(info, folder))
    executable = info.external_attr >> 16 & 0o111
    if executable and there.is_file():
        there.chmod(there.stat().st_mode | executable)


@contextmanager
def same_folder() -> Iterator[None]:
    """Undo the change of the working directory that FMPy leaves behind when a library does not load."""
    here = os.getcwd()  # noqa: PTH109 - the path as it is, not resolved
    try:
        yield
    finally:
        os.chdir(here)
