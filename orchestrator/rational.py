"""Times as exact fractions of a second, so that steps can be counted instead of added up."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from fmus.errors import WiringError
from fmus.units import SECOND, parse

_DIGITS = "[0-9]{1,30}"
_DECIMAL = rf"(?:{_DIGITS}(?:\.[0-9]{{0,30}})?|\.{_DIGITS})(?:[eE][+-]?[0-9]{{1,3}})?"
_TIME = re.compile(rf"([+-]?(?:{_DIGITS} ?/ ?{_DIGITS}|{_DECIMAL}))(?: ?([a-zA-Zµμ]{{1,9}}))?")
_SHORTEST, _LONGEST = Fraction(1, 10**15), 10**15  # [s]


def seconds(value: str | float | int | Fraction, place: str = "time") -> Fraction:
    """The exact value of a decimal or a quotient, with a unit or in seconds: 0.001, "1/300", "2e-3", "10 ms" [s].

    Raises:
        WiringError: not a number, or beyond what can be stepped (1e-15 to 1e15 s in size; 0 is a time).
    """
    try:
        exact = value if isinstance(value, Fraction) else _parsed(str(value).strip())
    except (ValueError, ZeroDivisionError):
        fix = 'give seconds, such as 0.001 or "1/300", or a unit of time, 10 ms'
        raise WiringError(place, f"{_short(value)} is no time", fix) from None
    if exact and not _SHORTEST <= abs(exact) <= _LONGEST:
        raise WiringError(place, f"{_short(value)} s cannot be stepped", "give seconds, such as 0.001")
    return exact


def _parsed(text: str) -> Fraction:
    found = _TIME.fullmatch(text)
    if not found:
        raise ValueError(text)
    number = Fraction("".join(found[1].split()))
    return number * _length(found[2]) if found[2] else number


def _length(name: str) -> Fraction:
    """How long a unit of time is [s]."""
    unit = parse(name)
    if unit is None or unit.exponents != SECOND.exponents:
        raise ValueError(name)
    return Fraction(repr(unit.factor))


def _short(value: object) -> str:
    try:
        return f"'{' '.join(str(value)[:40].split())}'"
    except ValueError:  # an integer of more digits than Python prints
        return "a number of thousands of digits"


def written(value: Fraction) -> str:
    """The time as people write it: a decimal where that is exact, else a quotient."""
    decimal = f"{float(value):.12g}"
    return decimal if Fraction(decimal) == value else str(value)


def common_divisor(values: Iterable[Fraction]) -> Fraction:
    """The longest time of which every value is a multiple [s]."""
    parts = list(values)
    denominator = math.lcm(*(value.denominator for value in parts))
    return Fraction(math.gcd(*(int(value * denominator) for value in parts)), denominator)


@dataclass(frozen=True, slots=True)
class TickTimes:
    """From the number of a tick to its time, correctly rounded: (first + number * step) / denominator [s]."""

    first: int
    step: int
    denominator: int

    def __call__(self, number: int) -> float:
        return (self.first + number * self.step) / self.denominator

    def exact(self, last: int) -> bool:
        """Whether floats can count up to this tick: quotients of whole floats are rounded as those of integers."""
        return max(abs(self.first), abs(self.first + last * self.step), self.denominator) < 1 << 53

    def times(self, first: int, count: int, every: int = 1) -> NDArray[np.float64]:
        """(count,) times of the ticks first, first + every, ... [s]."""
        if not self.exact(first + count * every):
            return np.array([self(first + number * every) for number in range(count)], dtype=float)
        return (self.first + (first + np.arange(count) * every) * float(self.step)) / self.denominator


def clock(start: Fraction, tick: Fraction) -> TickTimes:
    """From the number of a tick to start + number * tick."""
    denominator = math.lcm(start.denominator, tick.denominator)
    return TickTimes(int(start * denominator), int(tick * denominator), denominator)


def multiples(value: Fraction, of: Fraction, place: str) -> int:
    """How often `of` goes into `value`.

    Raises:
        WiringError: not a whole number of times; the message names the nearest value that is.
    """
    count = value / of
    if count.denominator != 1:
        nearest = max(1, round(count))
        raise WiringError(
            place, f"{written(value)} s is not a multiple of {written(of)} s", f"use {written(nearest * of)} s"
        )
    return int(count)
