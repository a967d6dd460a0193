"""The lines that serial CAN adapters (slcan) speak, after the LAWICEL CAN232 manual and what Linux and CANable added.

Each ends with a carriage return: t1232AABB is a frame with identifier 0x123 and two bytes of data.
"""

from __future__ import annotations

import re
from typing import NamedTuple

END, BELL = b"\r", b"\a"
LONGEST = 256  # no line is longer: B, 8 digits, 1 digit, 128 digits, a time stamp of 4
LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)  # data bytes by length code
BITRATES = {
    "S0": 10_000,
    "S1": 20_000,
    "S2": 50_000,
    "S3": 100_000,
    "S4": 125_000,
    "S5": 250_000,
    "S6": 500_000,
    "S7": 750_000,
    "S8": 1_000_000,
    "S9": 83_300,
}  # [bit/s]
DATA_BITRATES = {"Y2": 2_000_000, "Y5": 5_000_000}  # [bit/s]

_FRAME = re.compile(
    rb"(?:([trdb])([0-7][0-9A-Fa-f]{2})|([TRDB])([01][0-9A-Fa-f]{7}))([0-9A-Fa-f])((?:[0-9A-Fa-f]{2})*)"
)
_REMOTE, _FD, _SWITCHED = frozenset(b"rR"), frozenset(b"dDbB"), frozenset(b"bB")


class FrameLine(NamedTuple):
    """A frame as its line says it; `digits` are the hexadecimal digits of its data, `stamp` is in ms, None without."""

    identifier: int
    extended: bool
    remote: bool
    fd: bool
    switched: bool
    length: int
    digits: bytes
    stamp: int | None = None


def marked(data: bytes) -> bytes:
    """Bytes from an adapter in which each BEL is a line of its own."""
    return data.replace(BELL, BELL + END)


def parse(line: bytes) -> FrameLine | None:
    """The frame of a line without its end, None where it is none: another answer, or noise.

    Frames may end with a time stamp of 4 digits, as adapters send it when told so once.
    """
    match = _FRAME.fullmatch(line)
    if match is None:
        return None
    kind, identifier, _, extended_identifier, code, digits = match.groups()
    letter = line[0]
    fd = letter in _FD
    length = LENGTHS[int(code, 16)]
    if length > 8 and not fd:
        return None
    remote = letter in _REMOTE
    expected = 0 if remote else 2 * length
    if len(digits) - expected not in (0, 4):
        return None
    return FrameLine(
        int(identifier or extended_identifier, 16),
        kind is None,
        remote,
        fd,
        letter in _SWITCHED,
        length,
        digits[:expected],
        int(digits[expected:], 16) if digits[expected:] else None,
    )
