"""Unit names such as "N.m.s/rad" as powers of the SI base units, for FMI unit definitions and for checking wiring.

Names follow FMI: factors joined by dots, one slash, integer exponents behind a symbol ("kg.m2/s2").
"""

from __future__ import annotations

import re
from dataclasses import dataclass

BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")

_SYMBOLS: dict[str, tuple[float, str]] = {
    "N": (1.0, "kg.m/s2"),
    "J": (1.0, "kg.m2/s2"),
    "W": (1.0, "kg.m2/s3"),
    "Pa": (1.0, "kg/m.s2"),
    "V": (1.0, "kg.m2/s3.A"),
    "Ohm": (1.0, "kg.m2/s3.A2"),
    "H": (1.0, "kg.m2/s2.A2"),
    "F": (1.0, "s4.A2/kg.m2"),
    "C": (1.0, "A.s"),
    "Hz": (1.0, "1/s"),
    "g": (1e-3, "kg"),
    "mm": (1e-3, "m"),
    "cm": (1e-2, "m"),
    "ms": (1e-3, "s"),
    "us": (1e-6, "s"),
    "min": (60.0, "s"),
    "h": (3600.0, "s"),
    "mA": (1e-3, "A"),
    "mV": (1e-3, "kg.m2/s3.A"),
    "kN": (1e3, "kg.m/s2"),
    "kW": (1e3, "kg.m2/s3"),
    "deg": (0.017453292519943295, "rad"),
    "rev": (6.283185307179586, "rad"),
    "rpm": (0.10471975511965977, "rad/s"),
}


@dataclass(frozen=True)
class Unit:
    """factor * product of base units: multiply by `factor` to get SI. `exponents` go with `BASES`."""

    factor: float
    exponents: tuple[int, ...]

    def fits(self, other: Unit) -> bool:
        """Same quantity; radians count as a pure number, as the mechanics' equations have it."""
        return self.exponents[:-1] == other.exponents[:-1]


def parse(name: str) -> Unit | None:
    """The unit of that name, None when it is not one we know."""
    tight = re.sub(r"\s*([./*])\s*", r"\1", name.strip())
    numerator, *denominators = re.sub(r"[\s*]", ".", tight).replace("^", "").split("/")
    if len(denominators) > 1 and not all(denominators):
        return None
    unit = _product(numerator)
    for denominator in denominators:
        below = _product(denominator)
        if unit is None or below is None:
            return None
        unit = Unit(
            unit.factor / below.factor,
            tuple(a - b for a, b in zip(unit.exponents, below.exponents, strict=True)),
        )
    return unit


def _product(text: str) -> Unit | None:
    factor, exponents = 1.0, [0] * len(BASES)
    for term in text.strip("()").split("."):
        match = re.fullmatch(r"([A-Za-z]+|1)(-?[0-9]{1,2})?", term)
        if match is None:
            return None
        symbol, power = match[1], int(match[2] or 1)
        if symbol == "1":
            continue
        one = _symbol(symbol)
        if one is None:
            return None
        factor *= one.factor**power
        exponents = [total + power * exponent for total, exponent in zip(exponents, one.exponents, strict=True)]
    return Unit(factor, tuple(exponents))


def _symbol(symbol: str) -> Unit | None:
    if symbol in BASES:
        return Unit(1.0, tuple(int(base == symbol) for base in BASES))
    if symbol not in _SYMBOLS:
        return None
    factor, definition = _SYMBOLS[symbol]
    base = parse(definition)
    return base and Unit(factor * base.factor, base.exponents)
