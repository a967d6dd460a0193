"""How a value changes on its way through connectors: by units, as far as they are converted, and by transformations."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from fmus import units
from fmus.errors import WiringError
from fmus.units import SAME, Conversion, Unit
from orchestrator.crossing import Crossing, NamedUnit, crossing
from orchestrator.fmi.interface import Port
from orchestrator.ssp.description import Connector, Entries, Transformation

_TRUTH = {"true": 1.0, "1": 1.0, "false": 0.0, "0": 0.0}
NO_UNIT = NamedUnit()


@dataclass(frozen=True)
class ValuePassage:
    """A value on its way: what it is by now, of what it was at first.

    Attributes:
        unit: that it has by now.
        table: through which it has gone, where it did.
        doubts: how it was taken from one unit to another, where that is not sure.
    """

    unit: NamedUnit
    conversion: Conversion = SAME
    table: Entries = ()
    doubts: tuple[Crossing, ...] = ()

    def to(self, unit: NamedUnit, place: str) -> ValuePassage:
        """In another unit.

        Raises:
            WiringError: it is of another quantity.
        """
        if not unit.name:
            return self
        crossed = crossing(place, self.unit, unit)
        doubts = (*self.doubts, crossed) if crossed.doubtful else self.doubts
        return replace(self._changed(crossed.conversion, place), unit=unit, doubts=doubts)

    def over(
        self, unit: NamedUnit | None, by_unit: bool, transformation: Transformation | None, place: str
    ) -> ValuePassage:
        """Behind a connection, whose end is in this unit, None where that does not say.

        Raises:
            WiringError: units of different quantities, or more than one table.
        """
        known = self.unit if unit is None else unit
        passed = self.to(known, place) if by_unit else replace(self, unit=known)
        if transformation is None:
            return passed
        if transformation.entries:
            if passed.table or passed.conversion != SAME:
                raise WiringError(place, "maps values that were changed before", "leave one of these out")
            return replace(passed, table=transformation.entries)
        return passed._changed(Conversion(transformation.factor, transformation.offset), place)

    def _changed(self, next_: Conversion, place: str) -> ValuePassage:
        if next_ == SAME:
            return self
        if self.table:
            raise WiringError(place, "changes values that were mapped before", "leave one of these out")
        factor, offset = self.conversion.factor, self.conversion.offset
        return replace(self, conversion=Conversion(next_.factor * factor, next_.factor * offset + next_.offset))


def meaning(name: str | None, known: Mapping[str, Unit]) -> NamedUnit | None:
    """A unit by the word of a document, else by its name; None where there is none."""
    if not name:
        return None
    return NamedUnit(name, known.get(name) or units.parse(name), name in known)


def begin(port: Port, connector: Connector, known: Mapping[str, Unit], place: str) -> ValuePassage:
    """A value of a variable as its connector gives it.

    Raises:
        WiringError: they have units of different quantities.
    """
    said = meaning(connector.unit, known) if port.real else None
    passage = ValuePassage(port.measure if port.unit else said or NO_UNIT)
    return passage if said is None else passage.to(said, place)


def unit_at(port: Port, connector: Connector, known: Mapping[str, Unit]) -> NamedUnit | None:
    """The unit that a connector takes values in: its own, or that of its variable."""
    said = meaning(connector.unit, known)
    return said if said is not None or not port.unit else port.measure


def end(passage: ValuePassage, port: Port, place: str) -> ValuePassage:
    """A value as it arrives in a variable.

    Raises:
        WiringError: they have units of different quantities.
    """
    return passage.to(port.measure, place) if port.unit else passage


def line_through(table: Entries, source: Port | None, target: Port, place: str) -> Conversion:
    """The factor and offset that do what a table says; `source` is None where the table is applied to a given value.
    Items without an entry stay as they are.

    Raises:
        WiringError: an entry is no value of its type, an item is none of the target's, or no factor and offset do the
            same.
    """
    points = {_number(one, source, place): _number(other, target, place) for one, other in table}
    items = (0.0, 1.0) if source and source.type == "Boolean" else (source.items or {}).values() if source else ()
    kept = [float(item) for item in items if float(item) not in points]
    known = None if target.items is None else {float(item) for item in target.items.values()}
    if lost := [item for item in kept if known is not None and item not in known]:
        raise WiringError(place, f"leaves {lost[0]:g} as it is, which is no item of {target.name}", "give it an entry")
    points |= dict(zip(kept, kept, strict=True))
    (x0, y0), *others = points.items()
    factor = (others[0][1] - y0) / (others[0][0] - x0) if others else 1.0
    line = Conversion(factor, y0 - factor * x0)
    if not all(math.isclose(line(x), y, abs_tol=1e-9) for x, y in points.items()):
        raise WiringError(place, "maps values as no factor and offset do", "put a component between that does")
    return line


def mapped(table: Entries, value: float | int | bool | str, place: str) -> str | bool | float:
    """What a table makes of a value; one without an entry stays as it is.

    Raises:
        WiringError: its entry is no number for a number.
    """
    text = str(value).lower() if isinstance(value, bool) else str(value)
    names = {"1": "true", "0": "false"} if isinstance(value, bool) else {}
    for source, target in table:
        if names.get(source, source) == text:
            if isinstance(value, bool):
                return target in ("true", "1")
            if isinstance(value, str):
                return target
            try:
                return float(target)
            except ValueError:
                raise WiringError(place, f"maps {text} to '{target}', no number", "correct the mapping") from None
    return value


def _number(text: str, port: Port | None, place: str) -> float:
    if port is not None and port.items and text in port.items:
        return float(port.items[text])
    try:
        return _TRUTH[text] if port is not None and port.type == "Boolean" else float(text)
    except (KeyError, ValueError):
        raise WiringError(place, f"maps '{text}', which is no value there", "correct the entry") from None
