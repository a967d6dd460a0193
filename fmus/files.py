"""Files that are never half there: written beside and renamed into place, known by their hash."""

from __future__ import annotations

import hashlib
import os
import secrets
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from fmus import owned
from fmus.errors import InputError

RawMap = dict[str, Any]
"""A map of a file as people, or other tools, have written it or will read it: no schema has looked at it."""


def atomic_write(path: str | Path, content: bytes | Callable[[BinaryIO], object], *, for_good: bool = True) -> Path:
    """The path, once `content` is completely there; whatever was there before stays until then.

    Args:
        path: the file to write; missing folders are made.
        content: the bytes, or a function that writes them into the binary file it is given.
        for_good: whether it is on the disk, too, before it is there; what can be made again does not wait for that.

    Raises:
        InputError: the place cannot be written.
    """
    target = Path(path)
    atomic_writes({target: content}, for_good=for_good)
    return target


def atomic_writes(contents: Mapping[Path, bytes | Callable[[BinaryIO], object]], *, for_good: bool = True) -> None:
    """Have several files there: each completely, and none of them before all are on the disk.

    Args:
        contents: file -> as of `atomic_write`.
        for_good: as of `atomic_write`.

    Raises:
        InputError: a place cannot be written, or is no file; then what was there before stays.
    """
    with _beside(contents, for_good) as parts:
        for target, part in parts.items():
            try:
                part.replace(os.path.realpath(target))  # a link stays one
            except OSError as problem:
                raise _unwritable(target, problem) from problem


def check_place(path: Path) -> None:
    """See that a file may be written there, before the work for it is done.

    Raises:
        InputError: it may not, or what is there is no file.
    """
    with _beside({path: b""}, for_good=False):
        pass


def add_text(path: Path, text: str) -> None:
    """Add to the end of a file; it and its folder are made where they are not there.

    Raises:
        InputError: the place cannot be written, or is no file.
    """
    _refuse_other(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as file:
            file.write(text)
    except OSError as problem:
        raise _unwritable(path, problem) from problem


@contextmanager
def _beside(
    contents: Mapping[Path, bytes | Callable[[BinaryIO], object]], for_good: bool
) -> Iterator[dict[Path, Path]]:
    """File -> one beside it that holds its content, for a while."""
    parts: dict[Path, Path] = {}
    try:
        for target, content in contents.items():
            _refuse_other(target)
            place = Path(os.path.realpath(target))
            parts[target] = place.with_name(f".{place.name}.{secrets.token_hex(4)}.part")
            try:
                place.parent.mkdir(parents=True, exist_ok=True)
                owned.sweep_files(place.parent, f".{place.name}.", ".part")
                _write(parts[target], content, for_good)
            except OSError as problem:
                raise _unwritable(target, problem) from problem
        yield parts
    finally:
        for part in parts.values():
            with suppress(OSError):
                part.unlink(missing_ok=True)


def _refuse_other(path: Path) -> None:
    if path.exists() and not path.is_file():
        raise InputError(path, absence(path), "choose another place")


def _unwritable(path: Path, problem: OSError) -> InputError:
    return InputError(path, f"cannot be written ({problem.strerror or problem})", "choose another place")


def absence(path: Path, missing: str = "no such file") -> str:
    """What is there in place of a file."""
    if path.is_dir():
        return "is a folder, not a file"
    return "is a pipe, a device or a socket, not a file" if path.exists() else missing


def _write(path: Path, content: bytes | Callable[[BinaryIO], object], for_good: bool) -> None:
    with path.open("xb") as file:
        owned.hold(file)
        if callable(content):
            content(file)
        else:
            file.write(content)
        file.flush()
        if for_good:
            os.fsync(file.fileno())


def sha256(path: str | Path) -> str:
    """Hexadecimal SHA-256 of a file's bytes.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        with Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as problem:
        raise InputError(path, f"cannot be read ({problem.strerror})", "check the path") from problem


def package_folder(name: str) -> Path:
    """The folder of an installed package, also where an FMU has brought another copy of it into this process."""
    from importlib.metadata import distribution  # noqa: PLC0415 (slow to load, and wanted only where FMUs are built)

    return Path(str(distribution(name).locate_file(name)))
