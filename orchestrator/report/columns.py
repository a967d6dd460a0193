"""Columns of numbers inside of a page, so that a browser finds any stretch of them at once.

A column is cut into parts, each 32 bits a number around a base of its own, its bytes sorted by significance and
deflated. A long one brings the extremes of its stretches along, level by level, so that a view of many samples is drawn
from few numbers and yet misses no peak. What is drawn is right to 6e-8 of a part's span; the recording has every bit.
"""

from __future__ import annotations

import json
import zlib
from base64 import b64encode
from dataclasses import dataclass, field
from typing import NotRequired, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from orchestrator.trace import FloatArray

PART = 1 << 13  # samples that are inflated together; chart.js has the same number
RAW = 1 << 15  # samples in view up to which all of them are drawn; chart.js has the same number
STRETCH = 32  # of a level, that give their extremes to the next
MOST = 11_000_000  # samples of a report: where there are more, columns give extremes alone
EVEN = 1e-6  # of a step, to which instants are even


class Level(TypedDict):
    """Extremes of stretches of so many samples, around a base, in units of a scale."""

    width: int
    base: float
    scale: float
    text: str


class Head(TypedDict):
    """What a chart needs to know of a column: of even instants start and step, of others the bases of their parts."""

    count: int
    start: NotRequired[float]
    step: NotRequired[float]
    bases: NotRequired[list[float]]
    scale: NotRequired[float]
    levels: NotRequired[list[Level]]


@dataclass(frozen=True)
class PageColumn:
    """A column as it is in a page: what a chart needs to know of it, and the text of its parts."""

    head: Head
    parts: tuple[str, ...] = ()

    @property
    def thinned(self) -> bool:
        """Whether only the extremes of its stretches are there."""
        return not self.parts and "step" not in self.head


@dataclass
class Columns:
    """All columns of a page; arrays that several charts draw are in it once."""

    columns: list[PageColumn] = field(default_factory=list)
    _numbers: dict[int, int] = field(default_factory=dict)
    _kept: list[FloatArray] = field(default_factory=list)  # so that no other array gets the identity of one
    _samples: int = 0

    def add(self, values: ArrayLike, rising: bool = False) -> int:
        """The number of the column with these values (K,).

        Args:
            rising: whether they increase strictly, as instants do; even ones then need no numbers at all.
        """
        array = np.asarray(values, dtype=float)
        number = self._numbers.get(id(array))
        if number is None:
            number = self._numbers[id(array)] = len(self.columns)
            self._kept.append(array)
            self.columns.append(self._made(array, rising))
        return number

    def heads(self) -> str:
        """What charts need to know of all columns before they are there, as JSON."""
        return json.dumps([column.head for column in self.columns], separators=(",", ":"), allow_nan=False)

    def markup(self) -> str:
        """The parts of all columns, each in an element of its own."""
        return "\n".join(
            f'<script type="text/plain" id="column-{number}-{place}">{part}</script>'
            for number, column in enumerate(self.columns)
            for place, part in enumerate(column.parts)
        )

    def _made(self, values: FloatArray, rising: bool) -> PageColumn:
        even = _even(values) if rising else None
        if even is not None:
            return PageColumn({"count": len(values), "start": even[0], "step": even[1]})
        thinned = len(values) > RAW and self._samples + len(values) > MOST
        if not thinned:
            self._samples += len(values)
        return column(values, rising, thinned)


def column(values: FloatArray, rising: bool = False, thinned: bool = False) -> PageColumn:
    """Values (K,) as a column; `thinned` leaves out all but the extremes of stretches."""
    finite = np.where(np.isfinite(values), values, np.nan)
    starts = np.arange(0, len(values), PART)
    low, high = (reduce(finite, starts) if len(values) else finite for reduce in (np.fmin.reduceat, np.fmax.reduceat))
    bases = np.nan_to_num(low if rising else low / 2 + high / 2)
    scale = _scale(low - bases, high - bases)
    head: Head = {"count": len(values), "bases": bases.tolist(), "scale": scale}
    if len(values) > RAW:
        head["levels"] = _levels(finite, np.fmin.reduce(low), np.fmax.reduce(high))
    if thinned:
        return PageColumn(head)
    pieces = (finite[start : start + PART] - base for start, base in zip(starts, bases, strict=True))
    return PageColumn(head, tuple(_text(piece / scale) for piece in pieces))


def _even(values: FloatArray) -> tuple[float, float] | None:
    """Start and step of even instants; None where they are not."""
    if len(values) < 2:
        return None
    start, step = float(values[0]), float(values[-1] - values[0]) / (len(values) - 1)
    off = np.abs(values - (start + step * np.arange(len(values))))
    return (start, step) if off.max() <= EVEN * step else None


def _scale(lowest: FloatArray, highest: FloatArray) -> float:
    """A power of two to which values lie around 0, of which these are the lowest and highest of parts."""
    ends = np.abs(np.concatenate([lowest, highest]))
    most = float(np.nan_to_num(np.fmax.reduce(ends))) if len(ends) else 0.0
    return float(2.0 ** np.clip(np.ceil(np.log2(most)), -1000, 1000)) if most else 1.0


def _levels(finite: FloatArray, lowest: np.float64, highest: np.float64) -> list[Level]:
    """Lowest and highest of stretches, and of stretches of these, until few enough are left to be drawn.

    Args:
        lowest, highest: of all, NaN where there is none.
    """
    low = high = finite
    levels, width = list[Level](), 1
    base = float(np.nan_to_num(lowest / 2 + highest / 2))
    scale = _scale(np.array([lowest - base]), np.array([highest - base]))
    while len(low) > RAW:
        starts, width = np.arange(0, len(low), STRETCH), width * STRETCH
        low, high = np.fmin.reduceat(low, starts), np.fmax.reduceat(high, starts)
        pairs = (np.column_stack([low, high]).ravel() - base) / scale
        levels.append({"width": width, "base": base, "scale": scale, "text": _text(pairs)})
    return levels


def _text(values: FloatArray) -> str:
    """Numbers within +-1 as base64 of deflated bytes: the first bytes of all numbers, then the second ..."""
    sorted_bytes = values.astype("<f4").view(np.uint8).reshape(-1, 4).T.tobytes()
    deflate = zlib.compressobj(1, strategy=zlib.Z_RLE)  # half of the time, for what repeats here are single bytes
    return b64encode(deflate.compress(sorted_bytes) + deflate.flush()).decode("ascii")
