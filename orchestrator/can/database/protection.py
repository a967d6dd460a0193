"""What protects a message on its way: a counter that counts its frames, and a checksum over its bytes.

Works on columns of many frames; what is found is counted by the decoder, and what is sent is filled in by the encoder.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from orchestrator.trace import Bytes


@dataclass(frozen=True)
class Crc8:
    """A cyclic redundancy check of 8 bits, most significant bit first, with start value and final mask 0xFF."""

    polynomial: int
    start: int = 0xFF
    mask: int = 0xFF


ALGORITHMS = {
    "CRC8_SAE_J1850": Crc8(0x1D),
    "CRC8_H2F": Crc8(0x2F),  # AUTOSAR's second one, Specification of CRC Routines, 7.2.1.2
}


@dataclass(frozen=True)
class Protection:
    """How a message is protected.

    Attributes:
        counter: signal that counts the frames; "" for none.
        modulus: number of values of the counter before it starts again at 0; 0 for as many as its signal has.
        checksum: signal of 8 bits on a byte boundary with the checksum of all other bytes; "" for none.
        algorithm: name in `ALGORITHMS`.
        data_id: of 16 bits, what the checksum begins with, low byte first; None for nothing.
    """

    counter: str = ""
    modulus: int = 0
    checksum: str = ""
    algorithm: str = "CRC8_SAE_J1850"
    data_id: int | None = None


def checksums(data: Bytes, algorithm: str, skip: int | None = None, data_id: int | None = None) -> Bytes:
    """(K,) the checksum of each row of `data` (K, n) without its byte `skip`."""
    crc, table = ALGORITHMS[algorithm], _table(ALGORITHMS[algorithm].polynomial)
    value = np.full(len(data), crc.start, dtype=np.uint8)
    for byte in () if data_id is None else (data_id & 0xFF, data_id >> 8 & 0xFF):
        value = table[value ^ np.uint8(byte)]
    for column in range(data.shape[1]):
        if column != skip:
            value = table[value ^ data[:, column]]
    return value ^ np.uint8(crc.mask)


def checksum(data: bytes | bytearray, algorithm: str, skip: int | None = None, data_id: int | None = None) -> int:
    """The checksum of one frame's bytes without its byte `skip`."""
    crc, table = ALGORITHMS[algorithm], _bytes(ALGORITHMS[algorithm].polynomial)
    value = crc.start
    for byte in () if data_id is None else (data_id & 0xFF, data_id >> 8 & 0xFF):
        value = table[value ^ byte]
    for place, byte in enumerate(data):
        if place != skip:
            value = table[value ^ byte]
    return value ^ crc.mask


def steps(counter: NDArray[np.int64], modulus: int, last: int | None) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """(K,) by how much the counter went on to each frame, and where that was wrong; `last` came before them."""
    before = np.concatenate(([counter[0] - 1 if last is None else last], counter[:-1]))
    went = (counter - before) % modulus
    wrong = (went != 1) | (counter >= modulus)
    wrong[:1] &= last is not None
    return went, wrong


@cache
def _table(polynomial: int) -> Bytes:
    """(256,) the remainder of each byte."""
    value = np.arange(256)
    for _ in range(8):
        value = (value << 1) ^ np.where(value & 0x80, polynomial, 0)
    return (value & 0xFF).astype(np.uint8)


@cache
def _bytes(polynomial: int) -> bytes:
    """The same for one byte at a time, which Python reads faster."""
    return _table(polynomial).tobytes()
