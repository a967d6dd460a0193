"""What a frame is on the wire: how long it keeps a bus busy, and who goes first when two start together."""

from __future__ import annotations

from functools import cache

_TRAILER = 13  # bits after the CRC that are never stuffed, with the gap to the next frame


@cache
def bits(length: int, extended: bool = False, remote: bool = False, fd: bool = False) -> tuple[int, int]:
    """The most bits that a frame can have, at the nominal and at the data bit rate (0 for a classic frame).

    With as many stuff bits as can be: a classic frame after Davis et al. 2007, Eq. 1; typical data need some 10 % less.
    A CAN FD frame switches its bit rate with the bit after BRS and back after the CRC.

    Args:
        length: data bytes.
    """
    if not fd:
        stuffed = (54 if extended else 34) + (0 if remote else 8 * length)
        return stuffed + (stuffed - 1) // 4 + _TRAILER, 0
    head = 36 if extended else 17
    body = 5 + 8 * length  # ESI, length code, data
    check = 4 + 17 + 6 if length <= 16 else 4 + 21 + 7  # stuff count, CRC, and their stuff bits at fixed places
    return head + (head - 1) // 4 + _TRAILER, body + body // 4 + check


def seconds(length: int, extended: bool, remote: bool, fd: bool, bitrate: int, data_bitrate: int | None) -> float:
    """The longest time that a frame takes [s]; no data bit rate: it does not switch."""
    nominal, data = bits(length, extended, remote, fd)
    return nominal / bitrate + data / (data_bitrate or bitrate)


def priority(identifier: int, extended: bool, remote: bool) -> int:
    """The arbitration field as one number: the lower one wins the bus."""
    if not extended:
        return identifier << 21 | remote << 20
    return identifier >> 18 << 21 | 0b11 << 19 | (identifier & 0x3FFFF) << 1 | remote
