"""How a value crosses the border between two units: by what it is converted, on whose word, and what is said of it."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from functools import cache

from typing_extensions import TypedDict

from fmus import units
from fmus.errors import WiringError
from fmus.unit_table import TURN
from fmus.units import ONE, SAME, SECOND, Conversion, Unit

_NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_QUANTITY = re.compile(rf"\s*({_NUMBER})(?:\s*(?=[^\s0-9.])|\s+(?=1\s*/))(.*)")
LOG = logging.getLogger("servotwin.units")


@dataclass(frozen=True)
class NamedUnit:
    """A unit as it is written somewhere, "" where none is, and what it means, None where that is not known.

    Attributes:
        declared: whether an FMU defines it.
    """

    name: str = ""
    unit: Unit | None = None
    declared: bool = False

    @property
    def counts_turns(self) -> bool:
        """Whether it is written with a Hz: periods, where a rad/s counts radians."""
        return "Hz" in self.name

    @property
    def difference(self) -> NamedUnit:
        """The unit of differences between values in this one."""
        return NamedUnit(self.name, self.unit and self.unit.difference, self.declared)

    def rate(self, order: int) -> NamedUnit:
        """The unit of its derivative of that order by time."""
        if not order:
            return self
        name = self.name + "/s" * order if self.name else ""
        return NamedUnit(name, self.unit and self.unit.times(SECOND, -order), self.declared)


def named(name: str | None) -> NamedUnit:
    """A unit that goes by its name alone."""
    return NamedUnit(name or "", units.parse(name or ""))


class Basis(StrEnum):
    """On whose word a value is converted, or not."""

    SAME = "same"
    UNITS = "units"
    ASSUMED = "assumed"
    NO_UNIT = "no unit"
    GIVEN = "given"


@dataclass(frozen=True)
class GivenConversion:
    """What somebody wrote to convert by, over the units; None leaves it to them."""

    factor: float | None = None
    offset: float | None = None

    def __bool__(self) -> bool:
        return self.factor is not None or self.offset is not None


NOTHING_GIVEN = GivenConversion()


@dataclass(frozen=True)
class Crossing:
    """How a value passes from one unit to another.

    Attributes:
        place: what crosses, and where to.
        by_units: what the units say, where somebody's factor or offset is used instead; None where they say nothing.
    """

    place: str
    source: str
    target: str
    conversion: Conversion
    basis: Basis
    by_units: Conversion | None = None

    @property
    def doubtful(self) -> bool:
        """Whether it rests on an assumption, or on a factor that the units contradict."""
        return self.basis is Basis.ASSUMED or (self.by_units is not None and not _agree(self.conversion, self.by_units))

    def __str__(self) -> str:
        if self.basis is Basis.ASSUMED:
            how = "as it is, by factor 1" if self.conversion == SAME else f"{_words(self.conversion)}, radians left out"
            return f"{self.place}: {self.source} is taken for {self.target} {how}"
        if self.basis is Basis.NO_UNIT:
            return f"{self.place}: taken in {self.source}, since the variable has no unit"
        if self.basis is Basis.GIVEN:
            return f"{self.place}: {_words(self.conversion)} as given{self._instead()}"
        how = "as it is" if self.conversion == SAME else _words(self.conversion)
        return f"{self.place}: {self.source or 'no unit'} to {self.target or 'no unit'}, {how}"

    def _instead(self) -> str:
        if self.by_units is None:
            return ", whatever the units"
        verdict = "which is" if _agree(self.conversion, self.by_units) else "not"
        return f", {verdict} {self.source} to {self.target} ({_words(self.by_units)})"


def crossing(place: str, source: NamedUnit, target: NamedUnit, given: GivenConversion = NOTHING_GIVEN) -> Crossing:
    """How a value in one unit becomes one in another.

    A `given` factor or offset stands over the units. Without a unit on one side nothing is converted; one that is not
    known is taken for the other.

    Raises:
        WiringError: they are units of different quantities, or cannot be told apart by 2 pi.
    """
    if given:
        return _by_hand(place, source, target, given)
    if source.unit is None or target.unit is None or source.unit == target.unit:
        return Crossing(place, source.name, target.name, SAME, _unconverted(source, target))
    found, basis = _converted(place, source, target, source.unit, target.unit)
    return Crossing(place, source.name, target.name, found, basis)


def quantity(text: str) -> tuple[float, str] | None:
    """Number and unit of a text like `3000 rpm`; None where it is not one."""
    match = _QUANTITY.fullmatch(text)
    return None if match is None else (float(match[1]), match[2])


def taken(place: str, number: float, source: NamedUnit, target: NamedUnit) -> float:
    """What somebody's number with a unit is in another unit; what is doubtful of that is told, once in a process.

    Raises:
        WiringError: as `crossing`.
    """
    how = crossing(place, source, target)
    if how.doubtful:
        _told_once(str(how))
    return how.conversion(number)


@cache
def _told_once(text: str) -> None:
    LOG.warning("%s", text)


def notes(documents: Iterable[CrossingDocument]) -> list[str]:
    """A line for people about each that is sure, but for connections: both of their units stand in FMUs."""
    return [f"note: {one['text']}" for one in documents if not one["doubtful"] and " -> " not in one["place"]]


def noted(crossings: Iterable[Crossing]) -> tuple[Crossing, ...]:
    """Those that are to be told, each once: a value changes, or equal units are not the reason that it does not."""
    unsaid = (Basis.SAME, Basis.UNITS)
    return tuple(one for one in dict.fromkeys(crossings) if one.conversion != SAME or one.basis not in unsaid)


def logged(crossings: Iterable[Crossing]) -> tuple[Crossing, ...]:
    """Those that are to be told; what is doubtful is logged as a warning at once, the others for those who want it."""
    told = noted(crossings)
    for one in told:
        LOG.log(logging.WARNING if one.doubtful else logging.INFO, "%s", one)
    return told


class CrossingDocument(TypedDict):
    """A crossing in plain values: target = factor * source + offset, on whose word, and all of that in words."""

    place: str
    source: str
    target: str
    factor: float
    offset: float
    basis: str
    doubtful: bool
    text: str


def documents_of(crossings: Iterable[Crossing]) -> list[CrossingDocument]:
    """Crossings in plain values."""
    return [
        {
            "place": one.place,
            "source": one.source,
            "target": one.target,
            "factor": one.conversion.factor,
            "offset": one.conversion.offset,
            "basis": str(one.basis),
            "doubtful": one.doubtful,
            "text": str(one),
        }
        for one in crossings
    ]


def _unconverted(source: NamedUnit, target: NamedUnit) -> Basis:
    """Why a value stays as it is: equal units, none to convert from or to, or one that is not known."""
    equal = source.unit == target.unit if source.unit and target.unit else source.name == target.name
    if equal or not source.name or (source.unit == ONE and not target.name):
        return Basis.SAME
    return Basis.ASSUMED if target.name else Basis.NO_UNIT


def _by_hand(place: str, source: NamedUnit, target: NamedUnit, given: GivenConversion) -> Crossing:
    try:
        by_units = crossing(place, source, target)
    except WiringError:
        by_units = None
    known = by_units.conversion if by_units is not None and by_units.basis is Basis.UNITS else None
    factor, offset = given.factor, given.offset
    if factor is None:
        factor = 1.0 if known is None else known.factor
    elif offset is None:
        offset = 0.0
    if offset is None:
        offset = 0.0 if known is None else known.offset
    return Crossing(place, source.name, target.name, Conversion(factor, offset), Basis.GIVEN, known)


def _converted(place: str, source: NamedUnit, target: NamedUnit, one: Unit, other: Unit) -> tuple[Conversion, Basis]:
    found = units.conversion(one, other)
    if found is None:
        raise WiringError(place, f"{source.name} does not fit {target.name}", "connect like quantities")
    if one.radians == other.radians:
        return found, Basis.UNITS
    basis = Basis.UNITS
    if source.counts_turns != target.counts_turns:
        found = Conversion(found.factor * TURN ** (other.radians - one.radians))
        sure = source.declared and target.declared
    else:
        sure, basis = _without_radians(source, target, found)
    if not sure:
        raise WiringError(
            place,
            f"{source.name} and {target.name} differ by 2 pi, or do not",
            "write rad/s, rpm or Hz on both sides, or give a factor",
        )
    return found, basis


def _without_radians(source: NamedUnit, target: NamedUnit, found: Conversion) -> tuple[bool, Basis]:
    """Whether a conversion may leave radians out, and on whose word: not where turns may be meant.

    In a torsional stiffness they are left out by habit. An angle as a number may be one of turns, which is said, and a
    1/s may count turns, too: what FMUs define must then be 1, or what the names say.
    """
    assert source.unit is not None
    if not source.unit.counts:
        return True, Basis.UNITS
    if source.unit.fits(ONE):
        return True, Basis.UNITS if found == SAME else Basis.ASSUMED
    one, other = units.parse(source.name), units.parse(target.name)
    by_name = units.conversion(one, other) if one and other and one.radians == other.radians else None
    if by_name == found:
        return source.declared and target.declared, Basis.UNITS
    return source.declared and target.declared and found == SAME, Basis.ASSUMED


def _agree(one: Conversion, other: Conversion) -> bool:
    """Whether they are the same but for the digits that people leave out."""
    pairs = ((one.factor, other.factor), (one.offset, other.offset))
    return all(math.isclose(a, b, rel_tol=1e-3) for a, b in pairs)


def _words(conversion: Conversion) -> str:
    plus = f" {'-' if conversion.offset < 0 else '+'} {abs(conversion.offset):.6g}" if conversion.offset else ""
    return f"times {conversion.factor:.6g}{plus}"
