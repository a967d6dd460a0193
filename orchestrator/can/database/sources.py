"""Which files say what the frames of a log mean: one or several for all its channels, or some for one of them.

A file of several buses may stand for one of them, as `car.kcd#Body`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from fmus.errors import InputError

Files = Path | Sequence[Path]
DatabaseFiles = Files | Mapping[str, Files]
"""A file, several, or those of each channel, by its number from 0 or its interface's name; `all` is every channel."""

ALL = "all"


def by_channel(files: DatabaseFiles) -> dict[str, list[Path]]:
    """Channel, or `all` -> its files."""
    given = files if isinstance(files, Mapping) else {ALL: files}
    return {channel: [own] if isinstance(own, Path) else list(own) for channel, own in given.items()}


def file_and_bus(path: Path) -> tuple[Path, str]:
    """A file, and the bus of it that is meant; "" for all that is in it."""
    file, mark, bus = path.name.rpartition("#")
    return (path.with_name(file), bus) if mark and file and not path.is_file() else (path, "")


def paths(files: DatabaseFiles) -> list[Path]:
    """All files, each once."""
    return list(dict.fromkeys(file_and_bus(path)[0] for own in by_channel(files).values() for path in own))


def moved(files: DatabaseFiles, move: Callable[[Path], Path]) -> DatabaseFiles:
    """The same choice of files that are somewhere else."""
    if isinstance(files, Path):
        return move(files)
    return {channel: [move(path) for path in own] for channel, own in by_channel(files).items()}


def parsed(options: Sequence[str]) -> DatabaseFiles:
    """The files of options as `FILE` or `CHANNEL=FILE`.

    Raises:
        InputError: an option names no file, or no channel.
    """
    found: dict[str, list[Path]] = {}
    for option in options:
        channel, equals, file = option.partition("=")
        whole = not equals or file_and_bus(Path(option))[0].is_file()
        if not (channel and (file or whole)):
            raise InputError(
                f"--dbc {option}", "names no file or no channel", "give FILE or CHANNEL=FILE, as 0=rig.dbc"
            )
        found.setdefault(ALL if whole else channel, []).append(Path(option if whole else file))
    return found
