"""Reads a CAN database file (DBC, ARXML, KCD, SYM; EDS, DCF), as a file from outside: what is sound in it.

Files that would make the parser take all memory or never end are refused before it sees them, and what it complains
about is located by line.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import cantools
from cantools.database.errors import UnsupportedDatabaseFormatError

from fmus.encodings import decoded, encoding_of
from fmus.errors import DatabaseError
from fmus.files import absence
from fmus.words import complaint
from orchestrator.can.database import autosar, canopen_pdos
from orchestrator.can.database.dbc_text import STRINGS, DbcText
from orchestrator.can.database.message import LeftOut, instead

SUFFIXES = (".dbc", ".arxml", ".kcd", ".sym", ".eds", ".dcf")
CANOPEN = SUFFIXES[4:]
LARGEST = 32 << 20  # bytes
LARGEST_SIZE = 1 << 14  # bits of a signal, bytes of a message; the parser makes lists of that length
LARGEST_PAYLOAD, MOST_PAYLOAD = 8 * 65535, 1 << 25  # bits of one in AUTOSAR, for ISO-TP or Ethernet, and of a file
MOST_FAULTS, MOST_TEXT = 20, 20 << 20  # that are taken out one by one, each by reading the file again
MOST_SELECTIONS = 1 << 16  # combinations of multiplexer values of a file

_SIZES = {
    ".dbc": re.compile(r"\bBO_\s+\d+\s+\w+\s*:\s*(\d+)|\bSG_\s[\s\w]{2,400}:\s*(\d+)\s*\|\s*(\d+)"),
    ".kcd": re.compile(r"\b(?:length|offset)\s*=\s*[\"']\s*(\d+)"),
    ".arxml": re.compile(r"<(?:\w+:)?(?:LENGTH|START-POSITION|FRAME-LENGTH)\b[^<>]*>\s*(\d+)"),
    ".sym": re.compile(r"\b(?:Len|DLC|MaxLen)\s*=\s*(\d+)|\s(\d+)\s*,\s*(\d+)"),
}
_SELECTED = re.compile(r"\bSG_MUL_VAL_\s+(\d+)\s+(\w+)\s+(\w+)\s+(\d[\d\s,-]*);")
_RANGE = re.compile(r"(?<!\d)(\d+)\s*-\s*(\d+)")
_DECLARED = re.compile(rb"<\?xml[^>]{0,200}\bencoding\s*=\s*[\"']([\w.-]{1,40})")
_PLACE = re.compile(r"line (\d+), column (\d+)")

Selected = list[tuple[str, tuple[int, int]]]  # signals and the range of multiplexer values they belong to


@dataclass(frozen=True)
class Read:
    """What could be read of a file.

    Attributes:
        messages: cantools'.
        left_out: messages and signals that cannot be used.
        notes: what else was found, a line each.
        j1939: whether the file says that it is of that protocol.
        of_any_node: names of messages that any CANopen node may send, by its number.
    """

    messages: list[Any]
    left_out: list[LeftOut]
    notes: list[str]
    j1939: bool = False
    of_any_node: frozenset[str] = frozenset()


def read(path: Path, encoding: str | None) -> Read:
    """The messages in the file.

    Raises:
        DatabaseError: it cannot be read; the line is named where it is known.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise DatabaseError(path, f"'{path.suffix}' is no format of a CAN database", f"use {', '.join(SUFFIXES)}")
    text, guess = text_of(path, _content(path), encoding)
    notes = [guess] if guess else []
    if suffix in CANOPEN:
        with _silenced("canopen"):
            device = canopen_pdos.read(path, text)
        return Read(device.messages, [], [*notes, *device.notes], of_any_node=device.of_any_node)
    _refuse_hostile(path, suffix, text)
    if suffix == ".dbc":
        return _sound(path, DbcText(text), notes)
    if suffix == ".sym" and not text.endswith("\n"):  # cantools passes over a line that is cut off
        notes = [*notes, f"its last line, {text.rpartition(chr(10))[2][:40]}, has no end; check that the file is whole"]
    if suffix == ".arxml":
        text, told = autosar.completed(text)
        notes = [*notes, *told]
    try:
        return replace(_parsed(path, suffix, text), notes=notes)
    except UnreadableError as fault:
        raise fault.complaint from fault


def text_of(path: Path, data: bytes, encoding: str | None) -> tuple[str, str]:
    """The text of a database, and a line about a guess of its encoding; "" where it took none.

    Raises:
        DatabaseError: there is no such encoding, or the bytes are none of it.
    """
    declared = _DECLARED.match(data.lstrip())
    known = encoding or (declared[1].decode() if declared else None)
    name = known or encoding_of(data).name
    try:
        text = decoded(data, name)
    except UnicodeError as error:
        place = f"byte {error.start}" if isinstance(error, UnicodeDecodeError) else "it"
        raise DatabaseError(path, f"is no text: {place} is not {name}", "name its encoding") from None
    except LookupError:
        raise DatabaseError(path, f"there is no encoding '{name}'", "use for example utf-8 or cp1252") from None
    plain = known is not None or name.startswith("utf")
    return (
        text,
        "" if plain else f"its text is read as {name}, which is a guess; --encoding or `encoding` says what it is",
    )


class UnreadableError(Exception):
    """What the parser found: the complaint, and where in the text it is; None where that is not known."""

    def __init__(self, complaint: DatabaseError, offset: int | None) -> None:
        self.complaint, self.offset = complaint, offset


def _parsed(path: Path, suffix: str, text: str) -> Read:
    try:
        with _silenced("cantools"):
            loaded = cantools.database.load_string(text, suffix[1:], prune_choices=False, strict=False)
        attributes = getattr(getattr(loaded, "dbc", None), "attributes", None) or {}
        j1939 = "ProtocolType" in attributes and attributes["ProtocolType"].value == "J1939"
        messages = list(getattr(loaded, "messages", ()))
        return Read(messages, [], [], j1939)
    except UnsupportedDatabaseFormatError as error:
        cause = error.e_dbc or error.e_arxml or error.e_kcd or error.e_sym or error
        raise _unreadable(path, suffix, text, cause) from error
    except (RecursionError, MemoryError) as error:
        raise DatabaseError(path, f"is too deeply nested or too large ({type(error).__name__})") from error


def of_bus(path: Path, read: Read, bus: str) -> Read:
    """What is of this bus; all, and a line about that, where none is meant and there are several.

    Raises:
        DatabaseError: there is no such bus.
    """
    names = list(dict.fromkeys(message.bus_name for message in read.messages if message.bus_name))
    if bus:
        own = [message for message in read.messages if message.bus_name == bus]
        if not own:
            raise DatabaseError(path, f"has no bus '{bus}'", instead(bus, names) if names else "leave the bus out")
        return replace(read, messages=own)
    if len(names) < 2:
        return read
    told = f"holds the buses {', '.join(names[:10])}, whose messages are taken for those of one"
    choice = " ".join(f"--dbc {channel}={path.name}#{name}" for channel, name in enumerate(names[:2]))
    return replace(read, notes=[*read.notes, f"{told}; {choice} gives each channel its own bus"])


def _sound(path: Path, dbc: DbcText, notes: list[str]) -> Read:
    """What is sound in a DBC, of which an end that is cut off and what cannot be read are taken out.

    Raises:
        DatabaseError: nothing is, or its faults are too many.
    """
    dbc.end()
    try:
        read = _parsed(path, ".dbc", dbc.text)
        return replace(read, left_out=dbc.left_out, notes=[*notes, *dbc.notes])
    except UnreadableError as error:
        first = fault = error
    dbc.clean()
    for _ in range(max(1, min(MOST_FAULTS, MOST_TEXT // len(dbc.text)))):
        try:
            read = _parsed(path, ".dbc", dbc.text)
        except UnreadableError as found:
            fault, why = found, found.complaint.problem
        else:
            if read.messages:
                return replace(read, left_out=dbc.left_out, notes=[*notes, *dbc.notes])
            break
        taken = dbc.without_attributes(why) if fault.offset is None else dbc.without(fault.offset, why)
        if not taken:
            break
    raise first.complaint from fault


@contextmanager
def _silenced(name: str) -> Iterator[None]:
    """Keep a library's warnings off the terminal: what matters in them is told by what is used of the file."""
    logger = logging.getLogger(name)
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)


def _content(path: Path) -> bytes:
    if not path.is_file():
        raise DatabaseError(path, absence(path), "check the path")
    try:
        if path.stat().st_size > LARGEST:
            raise DatabaseError(path, f"is larger than {LARGEST >> 20} MiB", "keep only the messages in use")
        data = path.read_bytes()
    except OSError as error:
        raise DatabaseError(path, f"cannot be read ({error.strerror})") from error
    if not data.strip():
        raise DatabaseError(path, "is empty", "export it again")
    return data


def _refuse_hostile(path: Path, suffix: str, text: str) -> None:
    if suffix in (".arxml", ".kcd"):
        found = re.search(r"<!\s*(DOCTYPE|ENTITY)", text, re.IGNORECASE)
        if found:
            raise _at(path, text, found.start(), "declares a document type or entities", "remove the declaration")
    if suffix in (".dbc", ".sym"):
        text = STRINGS.sub(lambda skipped: "\n" * skipped[0].count("\n"), text)
    total, largest = 0, LARGEST_PAYLOAD if suffix == ".arxml" else LARGEST_SIZE
    for found in _SIZES[suffix].finditer(text):
        size = max(found.groups("0"), key=lambda digits: int(digits[:12]))
        total += int(size[:12]) if int(size[:12]) > LARGEST_SIZE else 0
        if int(size[:12]) > largest or total > MOST_PAYLOAD:
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


def _unreadable(path: Path, suffix: str, text: str, cause: Exception) -> UnreadableError:
    """The parser's problem with its line, which it may name itself, or which its names lead to."""
    problem = complaint(cause)
    fix = "correct the line, or export the file again"
    if found := _PLACE.search(problem):
        shown = re.sub(r"^.*?line \d+, column \d+: *|: line \d+, column \d+$", "", problem).strip("\"' ")
        told = DatabaseError(f"{path}, line {found[1]}", f"cannot be read at column {found[2]}: {shown}", fix)
        lines = re.finditer(r"^", text, re.MULTILINE)
        line = next(islice(lines, int(found[1]) - 1, None), None)
        return UnreadableError(told, line and line.start() + int(found[2]) - 1)
    offset = _offset(suffix, text, problem)
    if offset is None:
        return UnreadableError(DatabaseError(path, problem.rstrip("."), "correct it, or export the file again"), None)
    return UnreadableError(_at(path, text, offset, problem.rstrip("."), fix), offset)


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
        return (lambda name: rf"BO_\s+-?\d+\s+{name}\b") if kind == "message" else (lambda name: rf"SG_\s+{name}\b")
    return lambda name: rf"\b{name}\b"


def _at(path: Path, text: str, offset: int, problem: str, fix: str) -> DatabaseError:
    return DatabaseError(f"{path}, line {text.count(chr(10), 0, offset) + 1}", problem, fix)
