"""How many bits a classic frame has on the wire, counted with its own stuff bits.

From the start of the frame to the end of its checksum a bit of the other value follows five equal ones (ISO 11898-1,
10.5); each byte moves the state, the latest value and how many of them there were, by a table.
"""

from __future__ import annotations

from functools import cache, lru_cache

_CHECK = 15  # bits of the checksum
_POLYNOMIAL = 0x4599
_RUN = 5  # equal bits after which one is stuffed
_UNSTUFFED = 13  # bits after the checksum, with the gap to the next frame
_STATES = 2 * _RUN + 1  # the latest value and how many of them there were; 0: nothing yet


def bits(identifier: int, extended: bool, remote: bool, length: int, data: bytes) -> int:
    """Bits of a classic frame, with the gap to the next one."""
    check, state, count = _head(identifier, extended, remote, length)
    for byte in data:
        check = (check << 8 & 0x7FFF) ^ _CHECKS[(check >> 7) ^ byte]
        stuffed, state = _STUFFED[state << 8 | byte]
        count += 8 + stuffed
    stuffed, state = _STUFFED[state << 8 | check >> 7]
    return count + _CHECK + _UNSTUFFED + stuffed + _last(state, check & 0x7F)


@lru_cache(1 << 16)
def _head(identifier: int, extended: bool, remote: bool, length: int) -> tuple[int, int, int]:
    """Checksum, state and number of bits after the bits before the data."""
    if extended:
        sent = f"0{identifier >> 18:011b}11{identifier & 0x3FFFF:018b}{remote:b}00{length:04b}"
    else:
        sent = f"0{identifier:011b}{remote:b}00{length:04b}"
    check = 0
    for bit in sent:
        over = (check >> _CHECK - 1) ^ int(bit)
        check = (check << 1 & 0x7FFF) ^ (_POLYNOMIAL if over else 0)
    stuffed, state = _through(0, sent)
    return check, state, len(sent) + stuffed


def _through(state: int, sent: str) -> tuple[int, int]:
    """How many bits are stuffed among these, and the state after them."""
    value, run = (state - 1) // _RUN, (state - 1) % _RUN + 1 if state else 0
    count = 0
    for bit in map(int, sent):
        value, run = bit, run + 1 if run and bit == value else 1
        if run == _RUN:
            count, value, run = count + 1, 1 - bit, 1
    return count, 1 + _RUN * value + run - 1


@cache
def _last(state: int, rest: int) -> int:
    """How many bits are stuffed among the last seven of the checksum."""
    return _through(state, f"{rest:07b}")[0]


def _checksum_step(byte: int) -> int:
    """What a byte that leaves the checksum at the front does to it."""
    check = byte << 7
    for _ in range(8):
        check = check << 1 ^ (_POLYNOMIAL if check & 0x4000 else 0)
    return check & 0x7FFF


_CHECKS = [_checksum_step(byte) for byte in range(256)]
_STUFFED = [_through(state, f"{byte:08b}") for state in range(_STATES) for byte in range(256)]
