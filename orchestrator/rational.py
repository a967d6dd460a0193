"""Times as exact fractions of a second, so that steps can be counted instead of added up."""

from __future__ import annotations

import math
from collections.abc import Iterable
from fractions import Fraction

from fmus.errors import WiringError


def seconds(value: str | float | int | Fraction, place: str = "time") -> Fraction:
    """The exact value of a decimal or a quotient: 0.001, "1/300", "2e-3" [s].

    Raises:
        WiringError: not a finite number.
    """
    try:
        return Fraction(str(value).replace(" ", "")) if not isinstance(value, Fraction) else value
    except (ValueError, ZeroDivisionError):
        raise WiringError(place, f"'{value}' is no time", 'give seconds, such as 0.001 or "1/300"') from None


def common_divisor(values: Iterable[Fraction]) -> Fraction:
    """The longest time of which every value is a multiple [s]."""
    parts = list(values)
    denominator = math.lcm(*(value.denominator for value in parts))
    return Fraction(math.gcd(*(int(value * denominator) for value in parts)), denominator)


def multiples(value: Fraction, of: Fraction, place: str) -> int:
    """How often `of` goes into `value`.

    Raises:
        WiringError: not a whole number of times.
    """
    count = value / of
    if count.denominator != 1:
        nearest = max(1, round(count))
        raise WiringError(place, f"{float(value):g} s is not a multiple of {float(of):g} s",
                          f"use {float(nearest * of):.9g} s")  # fmt: skip
    return int(count)
