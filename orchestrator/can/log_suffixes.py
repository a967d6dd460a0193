"""Which files are logs of CAN frames, and in which format: told without python-can, which takes long to be imported.

Suffixes that other files have, too (`.csv`, `.txt`), and those that several tools use (`.log`) say little: the first
lines decide.
"""

from __future__ import annotations

import gzip
import re
import zlib
from contextlib import suppress
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import BinaryIO

from orchestrator.can.table_head import table_head

SUFFIXES = (".asc", ".blf", ".csv", ".db", ".log", ".mf4", ".trc")
TEXT = {".asc": "asc", ".csv": "table", ".log": "candump", ".trc": "trc", ".txt": ""}
"""Suffix of a text -> its format where its lines do not tell."""
SHARED = (".csv", ".txt")
PACKED = ".gz"
PACKED_PROBLEM = "is packed, as only text logs of CAN frames may be"
FRAMES = (b"CAN_DataFrame", b"CAN_ErrorFrame", b"CAN_RemoteFrame", b"LIN_Frame", b"FLX_Frame")  # channels of MDF logs
HEAD, PART = 1 << 16, 1 << 8  # bytes that are looked at, and at once: of a damaged file those before the damage
PLAIN = bytes(32 if octet < 32 and octet != 10 else octet for octet in range(256))  # control characters are blanks

LINES = {
    "busmaster": re.compile(r"\*\*\*BUSMASTER", re.IGNORECASE),
    "kvaser": re.compile(r"\s*chn\s+identifier\s+flg\s+dlc\b", re.IGNORECASE),
    "trc": re.compile(r";\$FILEVERSION|;-+\+-+|\s*\d+\)\s+\d+(\.\d+)?\s"),
    "asc": re.compile(
        r"base\s+(hex|dec)\b|\s*\d+\.\d+\s+(CANFD\s|\d+\s+([0-9a-f]+x?\s+(Rx|Tx)|ErrorFrame))",
        re.IGNORECASE,
    ),
    "candump": re.compile(
        r"\s*(\([\d.: -]+\)\s+)?(?P<interface>\S+)\s+"
        r"(([RT]X\s+\S\s+\S\s+)?([0-9a-f]{3}|[0-9a-f]{8})\s+(\[\d+\]|\{[0-9a-f]\})|[0-9a-f]{3,8}#)",
        re.IGNORECASE,
    ),
}
"""Format -> what one of its first lines looks like."""


def suffix_of(path: Path) -> str:
    """The suffix in small letters, that of the content where it is packed."""
    name = path.name.lower()
    return Path(name.removesuffix(PACKED)).suffix


def opened(path: Path, raw: BinaryIO) -> BinaryIO:
    """The content of a file that is open, unpacked."""
    return gzip.GzipFile(fileobj=raw) if path.name.lower().endswith(PACKED) else raw  # type: ignore[return-value]


def first_lines(path: Path) -> list[str]:
    """Some of the first lines, those before the place from where the file cannot be read."""
    head = b""
    with suppress(OSError, EOFError, zlib.error), path.open("rb") as raw, opened(path, raw) as file:
        while len(head) < HEAD and (part := file.read(min(PART, HEAD - len(head)))):
            head += part
    lines = head.translate(PLAIN).decode("utf-8-sig", "replace").split("\n")
    return lines[:-1] if len(head) == HEAD else lines


def text_format(path: Path) -> str:
    """The format of a text by its first lines, else by its suffix; "" where neither tells."""
    lines = first_lines(path)
    for line in lines[:100]:
        for name, pattern in LINES.items():
            if pattern.match(line):
                return name
        if table_head(line) is not None:
            return "table"
    suffix = suffix_of(path)
    return "" if suffix in SHARED else TEXT.get(suffix, "")


def is_log(path: str | Path) -> bool:
    """Whether a file is a log of frames: by its suffix, where others have that, too, by its first lines."""
    file = Path(path)
    suffix = suffix_of(file)
    if suffix in SHARED:
        return file.is_file() and bool(text_format(file))  # to open a pipe waits for who writes to it
    if suffix == ".mf4" and file.is_file() and file.suffix.lower() != PACKED:
        return _holds_frames(file)
    return suffix in TEXT if file.suffix.lower() == PACKED else suffix in SUFFIXES


def _holds_frames(path: Path) -> bool:
    """Whether an MDF file names channels of bus frames, or is none: then its reader says so."""
    try:
        with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as content:
            return content[:8].strip() != b"MDF" or any(content.find(name) >= 0 for name in FRAMES)
    except (OSError, ValueError):
        return True
