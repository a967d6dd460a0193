"""Units as factor, offset and powers of the SI base units: read from names, or as an FMU defines them; and conversion.

Names follow FMI, "N.m.s/rad": factors joined by dots, slashes, integer exponents behind a symbol ("kg.m2/s2"). Other
common spellings are known too (`unit_table`). The radian is kept as a base, as in FMI: without it turns and radians,
rad/s and Hz, could not be told apart.
"""

from __future__ import annotations

import math
import re
import unicodedata
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, TypeVar

from fmus.unit_table import HEADS, OFFSETS, PLAIN, PREFIXED, PREFIXES, SIGNS, TAILS, UNSURE, WHOLE, WORDS

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

BASES = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_LONGEST = 60  # letters of a name
_RADIANS = BASES.index("rad")

Values = TypeVar("Values", float, "NDArray[np.float64]")


@dataclass(frozen=True)
class Unit:
    """SI value = factor * value + offset, in the product of base units with these exponents (in order of `BASES`)."""

    factor: float
    exponents: tuple[int, ...]
    offset: float = 0.0

    def __str__(self) -> str:
        powers = zip(BASES, self.exponents, strict=True)
        product = ".".join(f"{base}{'' if power == 1 else power}" for base, power in powers if power) or "1"
        return f"{self.factor:.6g} {product}" + (f" + {self.offset:g}" if self.offset else "")

    @property
    def radians(self) -> int:
        """Exponent of the radian."""
        return self.exponents[_RADIANS]

    @property
    def counts(self) -> bool:
        """Whether it is of an angle, a number, or a rate of one: what may count turns as well as radians."""
        return all(not power or base in ("s", "rad") for base, power in zip(BASES, self.exponents, strict=True))

    @property
    def difference(self) -> Unit:
        """The unit of differences between values in this one, which have no offset."""
        return replace(self, offset=0.0)

    def fits(self, other: Unit) -> bool:
        """Same quantity; radians may be left out of one, as the mechanics' equations have it."""
        left_out = self.radians == other.radians or 0 in (self.radians, other.radians)
        return left_out and self.exponents[:_RADIANS] == other.exponents[:_RADIANS]

    def times(self, other: Unit, power: int = 1) -> Unit:
        """The product with a power of another, both as units of differences."""
        exponents = tuple(a + power * b for a, b in zip(self.exponents, other.exponents, strict=True))
        return Unit(self.factor * other.factor**power, exponents)


ONE = Unit(1.0, (0,) * len(BASES))
SECOND = Unit(1.0, tuple(int(base == "s") for base in BASES))


@dataclass(frozen=True)
class Conversion:
    """Value in one unit = factor * value in the other + offset."""

    factor: float = 1.0
    offset: float = 0.0

    def __call__(self, value: Values) -> Values:
        return self.factor * value + self.offset


SAME = Conversion()


def conversion(source: Unit, target: Unit) -> Conversion | None:
    """From values in one unit to values in the other; None where they are units of different quantities."""
    if not source.fits(target):
        return None
    return Conversion(source.factor / target.factor, (source.offset - target.offset) / target.factor)


@lru_cache(4096)
def parse(name: str) -> Unit | None:
    """The unit of that name, None when it is not one we know."""
    if len(name) > _LONGEST:
        return None
    text = " ".join(unicodedata.normalize("NFKC", name).split())
    for sign, plain in SIGNS.items():
        text = text.replace(sign, plain)
    text = WHOLE.get(text, text)
    if (alone := OFFSETS.get(WORDS.get(text.lower(), text))) is not None:
        return Unit(alone[0], _power_of("K"), alone[1])
    try:
        unit = _quotient(text)
    except OverflowError:
        return None
    return unit if unit is not None and 0 < unit.factor < math.inf else None


def spelt_as_in_fmi(name: str) -> bool:
    """Whether it is a unit whose symbols stand by themselves, joined by dots and slashes: N.m.s/rad, not Nms/rad."""
    symbols = re.findall(r"[^\W\d_]+", name)
    return parse(name) is not None and all(_defined(symbol) is not None for symbol in symbols)


def _quotient(text: str) -> Unit | None:
    tight = re.sub(r"\s*([./])\s*", r"\1", text.strip())
    joined = re.sub(r"(?<=[A-Za-z])-(?=[A-Za-z])", ".", tight).replace(" ", ".").replace("^", "")
    numerator, *denominators = _apart(joined, "/")
    if len(denominators) > 1 and not all(denominators):
        return None
    unit = _product(numerator)
    for denominator in denominators:
        below = _product(denominator)
        if unit is None or below is None:
            return None
        unit = unit.times(below, -1)
    return unit


def _product(text: str) -> Unit | None:
    unit = ONE
    for term in _apart(text, "."):
        within = re.fullmatch(r"\((.*)\)(-?[0-9]{1,2})?", term)
        match = within or re.fullmatch(r"([A-Za-zμ%]+|1)(-?[0-9]{1,2})?", term)
        if match is None:
            return None
        power = int(match[2] or 1)
        if within:
            whole = _quotient(WHOLE.get(match[1], match[1]))
            one = whole and ONE.times(whole, power)
        else:
            one = ONE if match[1] == "1" else _power(match[1], power)
        if one is None:
            return None
        unit = unit.times(one)
    return unit


def _apart(text: str, mark: str) -> list[str]:
    """What is between marks that are not in parentheses."""
    parts, depth = [""], 0
    for letter in text:
        depth += (letter == "(") - (letter == ")")
        if letter == mark and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def _power(symbol: str, power: int) -> Unit | None:
    """A power of a symbol or word; of two symbols side by side ("kgm2") only the second has it."""
    known = WORDS.get(symbol.lower(), symbol) if len(symbol) > 1 else symbol
    plain = _defined(symbol) or _defined(known)
    return _attached(symbol, power) if plain is None else ONE.times(plain, power)


def _defined(symbol: str) -> Unit | None:
    if symbol in UNSURE:
        return None
    if symbol in BASES:
        return Unit(1.0, _power_of(symbol))
    if symbol in OFFSETS:
        return Unit(OFFSETS[symbol][0], _power_of("K"))
    scale, found = 1.0, PLAIN.get(symbol) or PREFIXED.get(symbol)
    if found is None and symbol[0] in PREFIXES:
        scale, found = PREFIXES[symbol[0]], PREFIXED.get(symbol[1:])
    if found is None:
        return None
    base = _quotient(found[1])
    return base and Unit(scale * found[0] * base.factor, base.exponents)


def _attached(symbol: str, power: int) -> Unit | None:
    """A product without a dot, of a few symbols that are written so: Nm, mNm, kgm, Vs, Ah, Nms."""
    for tail in TAILS:
        head = symbol.removesuffix(tail)
        if head and head != symbol and head.endswith(HEADS):
            before, after = _power(head, 1), _defined(tail)
            if before is not None and after is not None:
                return before.times(after, power)
    return None


def _power_of(base: str) -> tuple[int, ...]:
    return tuple(int(base == other) for other in BASES)
