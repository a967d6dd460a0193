"""Where signals lie in the bytes of frames: numbers out of many frames at once, and into them.

Frames are rows of 64-bit words, in one of two orders: `LITTLE`, where bit 0 is the first byte's lowest and numbers
grow upwards, and `BIG`, where bit 0 is the first byte's highest and numbers run on downwards through the bytes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orchestrator.trace import BoolArray, Bytes, FloatArray

Words = NDArray[np.uint64]
LITTLE, BIG = "<u8", ">u8"

_FLOATS = {16: ("u2", "f2"), 32: ("u4", "f4"), 64: ("u8", "f8")}
_LARGEST = {16: 65504.0, 32: float(np.finfo(np.float32).max), 64: float(np.finfo(np.float64).max)}
_EXACT = 1 << 53  # whole numbers up to here are floats


@dataclass(frozen=True)
class BitField:
    """A number of at most 64 bits in a frame, and the value it stands for: scale * raw + offset.

    Attributes:
        lowest: position of its lowest bit in its order.
    """

    lowest: int
    length: int
    big_endian: bool
    is_signed: bool
    is_float: bool
    scale: float
    offset: float

    def raw(self, words: Words) -> Words:
        """(K,) its bits in `words` (K, n), which are in the field's order."""
        word, shift = self._place()
        found = words[:, word] >> np.uint64(shift)
        if shift + self.length > 64:
            found |= words[:, self._next(word)] << np.uint64(64 - shift)
        return found & np.uint64((1 << self.length) - 1) if self.length < 64 else found

    def put(self, words: Words, raw: Words) -> None:
        """Add its bits (K,) to `words` (K, n), which are 0 there."""
        word, shift = self._place()
        words[:, word] |= raw << np.uint64(shift)
        if shift + self.length > 64:
            words[:, self._next(word)] |= raw >> np.uint64(64 - shift)

    def values(self, raw: Words) -> FloatArray:
        """(K,) the values, exactly those that cantools computes."""
        if self.is_float:
            bits, floats = _FLOATS[self.length]
            with np.errstate(over="ignore", invalid="ignore"):
                return self._scaled(raw.astype(bits).view(floats).astype(np.float64))
        return self._whole(self._signed(raw)) if self.is_signed else self._whole(raw)

    def limits(self) -> tuple[float, float]:
        """Smallest and largest raw number that is a float."""
        if self.is_float:
            return -_LARGEST[self.length], _LARGEST[self.length]
        high = (1 << self.length - self.is_signed) - 1
        return float(-high - 1 if self.is_signed else 0), float(high if high <= _EXACT else high & -2048)

    def encoded(self, values: FloatArray, low: float, high: float) -> tuple[Words, BoolArray]:
        """(K,) bits of the finite values, the nearest raw numbers from `low` to `high`; and which did not fit."""
        with np.errstate(over="ignore"):
            raw = (values - self.offset) / self.scale
        slack = 1e-9 * max(abs(low), abs(high)) if self.is_float else 0.5  # less is lost by rounding anyway
        limited = (raw < low - slack) | (raw > high + slack)
        if self.is_float:
            bits, floats = _FLOATS[self.length]
            return np.clip(raw, low, high).astype(floats).view(bits).astype(np.uint64), limited
        raw = np.clip(np.rint(raw), low, high)
        found = raw.astype(np.int64).view(np.uint64) if self.is_signed else raw.astype(np.uint64)
        return found & np.uint64((1 << self.length) - 1), limited

    def _place(self) -> tuple[int, int]:
        """The word with the lowest bit, and how far up it lies there."""
        word, bit = divmod(self.lowest, 64)
        return word, 63 - bit if self.big_endian else bit

    def _next(self, word: int) -> int:
        """The word with the higher bits."""
        return word - 1 if self.big_endian else word + 1

    def _signed(self, raw: Words) -> NDArray[np.int64]:
        spare = np.uint64(64 - self.length)
        return (raw << spare).view(np.int64) >> spare.astype(np.int64)

    def _whole(self, raw: NDArray[np.int64] | Words) -> FloatArray:
        """Whole numbers scaled: with whole scale and offset exactly, as Python's integers would be."""
        scale, offset = self.scale, self.offset
        if float(scale).is_integer() and float(offset).is_integer():
            scale, offset = int(scale), int(offset)
        if scale == 1 and offset == 0:
            return raw.astype(np.float64)
        if isinstance(scale, int):
            exact = abs(scale) << self.length
            if isinstance(offset, int) and exact + abs(offset) > _EXACT:
                return (raw.astype(object) * scale + offset).astype(np.float64)
            if exact > _EXACT:
                return (raw.astype(object) * scale).astype(np.float64) + offset
        return self._scaled(raw.astype(np.float64))

    def _scaled(self, raw: FloatArray) -> FloatArray:
        if self.scale == 1 and self.offset == 0:
            return raw
        raw *= self.scale
        raw += self.offset
        return raw


def words(data: Bytes, order: str) -> Words:
    """(K, n / 8) rows of `data` (K, n) as words in the order; n is a multiple of 8."""
    return np.ascontiguousarray(data).view(order).astype(np.uint64, copy=False)
