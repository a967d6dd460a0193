"""What was built before, kept in the user's cache folder: each entry under a hash of all that it was made of.

Entries are written beside and renamed, and carry the hash of their content: one that a killed process or a bad disk
left damaged is built again. Processes that build the same thing at once write the same entry. `SERVOTWIN_CACHE` names
another folder; empty, or `off`, it switches the cache off.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache as once
from pathlib import Path

from fmus.errors import InputError
from fmus.files import atomic_write

LOG = logging.getLogger("servotwin.cache")
VARIABLE = "SERVOTWIN_CACHE"
LARGEST = 1 << 30  # bytes
_ENTRY = re.compile(r"[0-9a-f]{64}\.built")
_PART = re.compile(r"\.[0-9a-f]{64}\.built\.[0-9a-f]+\.part")
_ABANDONED = 3600.0  # seconds after which a part is one that a killed process left
_DIGEST = hashlib.sha256().digest_size


@dataclass(frozen=True)
class CacheEntry:
    """One file of the cache: its size [bytes], and when it was used last [s since 1970]."""

    path: Path
    size: int
    used: float


@dataclass(frozen=True)
class Cache:
    """Entries in a folder, of `largest` bytes together at most; those go first that were not used for longest."""

    folder: Path
    largest: int = LARGEST

    def get(self, key: str) -> bytes | None:
        """The content under a key (hexadecimal SHA-256), None where there is none that is whole."""
        path = self._path(key)
        try:
            stored = path.read_bytes()
        except OSError:
            return None
        content = stored[_DIGEST:]
        if hashlib.sha256(content).digest() != stored[:_DIGEST]:
            return None
        with suppress(OSError):
            os.utime(path)
        return content

    def put(self, key: str, content: bytes) -> None:
        """Keep a content; a folder that cannot be written is no failure, and told once."""
        if len(content) + _DIGEST > self.largest:
            return
        try:
            atomic_write(self._path(key), hashlib.sha256(content).digest() + content)
            self._trim()
        except InputError as error:
            _complain(self.folder, error.problem)

    def entries(self) -> list[CacheEntry]:
        """All entries, the one that was not used for longest first."""
        return sorted(self._matching(_ENTRY), key=lambda entry: (entry.used, entry.path))

    def clear(self) -> int:
        """Remove all entries, and nothing else that is in the folder; how many there were comes back."""
        entries = self.entries()
        for entry in [*entries, *self._matching(_PART)]:
            entry.path.unlink(missing_ok=True)
        return len(entries)

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}.built"

    def _matching(self, pattern: re.Pattern[str]) -> Iterator[CacheEntry]:
        try:
            paths = list(self.folder.iterdir())
        except OSError:
            return
        for path in paths:
            with suppress(OSError):  # another process has just removed it
                if pattern.fullmatch(path.name):
                    found = path.stat()
                    yield CacheEntry(path, found.st_size, found.st_mtime)

    def _trim(self) -> None:
        entries = self.entries()
        size = sum(entry.size for entry in entries)
        for entry in entries:
            if size <= self.largest:
                break
            with suppress(OSError):
                entry.path.unlink()
            size -= entry.size
        for part in self._matching(_PART):
            if part.used < time.time() - _ABANDONED:
                with suppress(OSError):
                    part.path.unlink()


def current() -> Cache | None:
    """The user's cache, None where it is switched off."""
    named = os.environ.get(VARIABLE)
    if named is None:
        import platformdirs  # noqa: PLC0415 (not needed where the variable is set)

        return Cache(Path(platformdirs.user_cache_dir("servotwin", appauthor=False)) / "built")
    return None if named in ("", "off") else Cache(Path(named))


@once
def _complain(folder: Path, problem: str) -> None:
    LOG.warning("%s: %s; FMUs are built anew each time, unless %s names another folder", folder, problem, VARIABLE)
