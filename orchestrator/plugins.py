"""What other packages add through entry points: commands, formats of recordings, methods of identification."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeGuard, TypeVar

LOG = logging.getLogger("servotwin.plugins")
T = TypeVar("T")


def plugins(group: str, fits: Callable[[object], TypeGuard[T]]) -> dict[str, T]:
    """name -> what the entry points of a group lead to, imported now.

    One that cannot be imported, or leads to something that does not fit, is left out with a warning that names it.
    """
    return {name: loaded for name, loaded in _loaded(group, fits).items() if fits(loaded)}


@cache
def _loaded(group: str, fits: Callable[[object], bool]) -> dict[str, object]:
    if not _announced(group):
        return {}
    from importlib.metadata import entry_points  # noqa: PLC0415 (takes a tenth of the time of --help)

    found = {}
    for entry in entry_points(group=group):
        origin = f"plug-in '{entry.name}' of {entry.dist.name if entry.dist else 'unknown origin'}"
        try:
            loaded = entry.load()
        except (Exception, SystemExit) as error:  # whatever a stranger's module may raise
            LOG.warning("%s: cannot be imported (%s: %s); it is left out", origin, type(error).__name__, error)
            continue
        if fits(loaded):
            found[entry.name] = loaded
        else:
            LOG.warning("%s: '%s' is nothing for %s; it is left out", origin, entry.value, group)
    return found


def _announced(group: str) -> bool:
    """Whether any installed package may have entry points of the group; reads small files only."""
    files = (file for folder in sys.path for file in Path(folder).glob("*-info/entry_points.txt"))
    return any(group.encode() in file.read_bytes() for file in files)
