"""Reads a CAN database file (DBC, ARXML, KCD, SYM) with cantools, as a file from outside.

Files that would make the parser take all memory or never end are refused before it sees them, and what it complains
about is located by line.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cantools
from cantools.database.errors import UnsupportedDatabaseFormatError

from fmus.errors import DatabaseError

SUFFIXES = (".dbc", ".arxml", ".kcd", ".sym")
LARGEST = 32 << 20  # bytes
LARGEST_SIZE = 1 << 14  # bits of a signal, bytes of a message; the parser makes lists of that length
MOST_SELECTIONS = 1 << 16  # combinations of multiplexer values of a file

_SIZES = {
    ".dbc": re.compile(r"\bBO_\s+\d+\s+\w+\s*:\s*(\d+)|\bSG_\s[\s\w]{2,400}:\s*(\d+)\s*\|\s*(\d+)"),
    ".kcd": re.compile(r"\b(?:length|offset)\s*=\s*[\"']\s*(\d+)"),
    ".arxml": re.compile(r"<(?:\w+:)?(?:LENGTH|START-POSITION|FRAME-LENGTH)\b[^<>]*>\s*(\d+)"),
    ".sym": re.compile(r"\b(?:Len|DLC|MaxLen)\s*=\s*(\d+)|\s(\d+)\s*,\s*(\d+)"),
}
_SELECTED = re.compile(r"\bSG_MUL_VAL_\s+(\d+)\s+(\w+)\s+(\w+)\s+(\d[\d\s,-]*);")
_RANGE = re.compile(r"(?<!\d)(\d+)\s*-\s*(\d+)")
_SKIPPED = re.compile(r'"[^"\\]*(?:\\.[^"\\]*)*"|//[^\n]*')  # strings and comments
_PLACE = re.compile(r"line (\d+), column (\d+)")

Selected = list[tuple[str, tuple[int, int]]]  # signals and the range of multiplexer values they belong to


def read(path: Path, encoding: str | None) -> Any:
    """The file as cantools' database.

    Raises:
        DatabaseError: it cannot be read; the line is named where it is known.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise DatabaseError(path, f"'{path.suffix}' is no format of a CAN database", f"use {', '.join(SUFFIXES)}")
    text = _text(path, encoding)
    _refuse_hostile(path, suffix, text)
    try:
        with _silenced():
            return cantools.database.load_string(text, suffix[1:], prune_choices=False, strict=False)
    except UnsupportedDatabaseFormatError as error:
        cause = error.e_dbc or error.e_arxml or error.e_kcd or error.e_sym or error
        raise _complaint(path, suffix, text, cause) from error
    except (RecursionError, MemoryError) as error:
        raise DatabaseError(path, f"is too deeply nested or too large ({type(error).__name__})") from error


@contextmanager
def _silenced() -> Iterator[None]:
    """Keep cantools' warnings off the terminal: what matters in them is told by what is used of the file."""
    logger = logging.getLogger("cantools")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)


def _text(path: Path, encoding: str | None) -> str:
    """The contents: in `encoding`, else UTF-8 where they are valid UTF-8, else Windows' Western one."""
    if not path.is_file():
        raise DatabaseError(path, "no such file", "check the path")
    try:
        if path.stat().st_size > LARGEST:
            raise DatabaseError(path, f"is larger than {LARGEST >> 20} MiB", "keep only the messages in use")
        data = path.read_bytes()
    except OSError as error:
        raise DatabaseError(path, f"cannot be read ({error.strerror})") from error
    if not data.strip():
        raise DatabaseError(path, "is empty", "export it again")
    for name in (encoding,) if encoding else ("utf-8-sig", "cp1252"):
        try:
            return data.decode(name)
        except UnicodeDecodeError as error:
            problem = f"byte {error.start} is not {name}"
        except LookupError:
            raise DatabaseError(path, f"there is no encoding '{name}'", "use for example utf-8 or cp1252") from None
    raise DatabaseError(path, f"is no text: {problem}", "name its encoding, or export it again")


def _refuse_hostile(path: Path, suffix: str, text: str) -> None:
    if suffix in (".arxml", ".kcd"):
        found = re.search(r"<!\s*(DOCTYPE|ENTITY)", text, re.IGNORECASE)
        if found:
            raise _at(path, text, found.start(), "declares a document type or entities", "remove the declaration")
    if suffix in (".dbc", ".sym"):
        text = _SKIPPED.sub(lambda skipped: "\n" * skipped[0].count("\n"), text)
    for found in _SIZES[suffix].finditer(text):
        size = next((number for number in found.groups("0") if len(number) > 6 or int(number) > LARGEST_SIZE), None)
        if size:
            raise _at(
                path, text, found.start(), f"{size[:20]} bits or bytes are more than any frame has", "check the length"
            )
    if suffix == ".dbc":
        _refuse_many_selections(path, text)


def _refuse_many_selections(path: Path, text: str) -> None:
    """Refuse ranges of multiplexer values that, listed one by one and nested, are too many."""
    messages: dict[str, dict[str, Selected]] = {}
    total = 0
    for found in _SELECTED.finditer(text):
        identifier, signal, multiplexer, ranges = found.groups()
        children = messages.setdefault(identifier, {}).setdefault(multiplexer, [])
        for low, high in _ranges(ranges):
            children.append((signal, (low, high)))
            total += max(high - low + 1, 0)
        if total > MOST_SELECTIONS:
            raise _at(path, text, found.start(), "selects by too many multiplexer values", "narrow the ranges")
    for identifier, tree in messages.items():
        if any(_selections(tree, root, ()) > MOST_SELECTIONS for root in tree):
            raise DatabaseError(path, f"message {identifier} has too many combinations of multiplexer values")


def _ranges(text: str) -> Iterator[tuple[int, int]]:
    for found in _RANGE.finditer(text):
        low, high = found.groups()
        yield (int(low), int(high)) if max(len(low), len(high)) < 12 else (0, MOST_SELECTIONS)


def _selections(tree: dict[str, Selected], multiplexer: str, above: tuple[str, ...]) -> int:
    """Upper bound of the combinations below a multiplexer; a loop counts as too many."""
    if multiplexer in above or len(above) > 20:
        return MOST_SELECTIONS + 1
    total = 0
    for signal, (low, high) in tree[multiplexer]:
        below = _selections(tree, signal, (*above, multiplexer)) if signal in tree else 1
        total += (high - low + 1) * below
        if total > MOST_SELECTIONS:
            break
    return total


def _complaint(path: Path, suffix: str, text: str, cause: Exception) -> DatabaseError:
    """The parser's problem with its line, which it may name itself, or which its names lead to."""
    problem = " ".join(str(cause).split())[:300] or type(cause).__name__
    fix = "correct the line, or export the file again"
    if found := _PLACE.search(problem):
        shown = re.sub(r"^.*?line \d+, column \d+: *|: line \d+, column \d+$", "", problem).strip("\"' ")
        return DatabaseError(f"{path}, line {found[1]}", f"cannot be read at column {found[2]}: {shown}", fix)
    offset = _offset(suffix, text, problem)
    if offset is None:
        return DatabaseError(path, problem.rstrip("."), "correct it, or export the file again")
    return _at(path, text, offset, problem.rstrip("."), fix)


def _offset(suffix: str, text: str, problem: str) -> int | None:
    """Where the message and signal that a complaint names are defined."""
    message = re.search(r"(?:in|id in) message (\w+)", problem)
    signal = re.search(r"signals? (\w+)", problem)
    found = message and re.search(_defined(suffix, "message")(message[1]), text)
    if found is None:
        return None
    inside = signal and re.compile(_defined(suffix, "signal")(signal[1])).search(text, found.end())
    return (inside or found).start()


def _defined(suffix: str, kind: str) -> Callable[[str], str]:
    """Pattern of a definition by its name."""
    if suffix == ".dbc":
        return (lambda name: rf"BO_\s+\d+\s+{name}\b") if kind == "message" else (lambda name: rf"SG_\s+{name}\b")
    return lambda name: rf"\b{name}\b"


def _at(path: Path, text: str, offset: int, problem: str, fix: str) -> DatabaseError:
    return DatabaseError(f"{path}, line {text.count(chr(10), 0, offset) + 1}", problem, fix)
