"""Two sides held against each other: case by case, signal by signal, where they part first and by what."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fmus.errors import InputError, TraceError
from fmus.units import ONE
from orchestrator.comparison.sides import Side
from orchestrator.crossing import Crossing, crossing, logged, named, quantity
from orchestrator.measures import Parting, partings, together
from orchestrator.trace import Trace

ABSOLUTE, RELATIVE = 1e-9, 1e-6


@dataclass(frozen=True)
class Tolerance:
    """By how much sides may differ.

    Attributes:
        absolute: [unit of each signal].
        relative: of a signal's largest magnitude; the larger of the two holds.
        within: signal -> what holds instead, a number [unit of the signal] or a text with its unit.
    """

    absolute: float = ABSOLUTE
    relative: float = RELATIVE
    within: Mapping[str, str | float] = field(default_factory=dict)

    def of(self, name: str, one: Trace, other: Trace) -> float:
        """What holds for a signal of two traces [unit of the signal].

        Raises:
            InputError: it is no number with the unit of the signal.
        """
        if name in self.within:
            return _number(name, str(self.within[name]), one.unit(name))
        magnitudes = [np.max(np.abs(t[name][np.isfinite(t[name])]), initial=0.0) for t in (one, other)]
        return max(self.absolute, self.relative * float(max(magnitudes)))


@dataclass(frozen=True, eq=False)
class CasePair:
    """A case of both sides.

    Attributes:
        one, other: what both recorded, in the units of the first.
        partings: of each signal that both have.
    """

    name: str
    one: Trace
    other: Trace
    partings: Sequence[Parting]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two sides held against each other.

    Attributes:
        notes: what one of them alone has, and what is to be known of both, a line each.
        crossings: signals that were converted.
        interface: what two FMUs say of their variables differently, a line each.
    """

    one: Side
    other: Side
    pairs: Sequence[CasePair]
    notes: Sequence[str]
    crossings: Sequence[Crossing]
    interface: Sequence[str] = ()

    @property
    def agree(self) -> bool:
        """Whether nothing parts beyond the tolerance."""
        return not any(parting.beyond for pair in self.pairs for parting in pair.partings)

    @property
    def first(self) -> tuple[str, Parting] | None:
        """The case and the signal that part first; None where none do."""
        parted = [(pair.name, parting) for pair in self.pairs for parting in pair.partings if parting.beyond]
        return min(parted, key=lambda one: (one[1].first, -one[1].times), default=None)

    @property
    def largest(self) -> tuple[str, Parting]:
        """The case and the signal that differ most, in tolerances."""
        return max(
            ((pair.name, parting) for pair in self.pairs for parting in pair.partings), key=lambda one: one[1].times
        )


def compare_sides(one: Side, other: Side, tolerance: Tolerance) -> Comparison:
    """Both sides held against each other; a single case of each, whatever its name.

    Raises:
        InputError: they have no case or no signal in common, or `within` names none.
        TraceError: no time in common.
        WiringError: units of different quantities.
    """
    notes = [f"{side.name}: {line}" for side in (one, other) for line in side.notes]
    pairs, crossings = [], list[Crossing]()
    for name, a, b in _cases(one, other, notes):
        signals = [signal for signal in a.names if signal in b.names]
        if not signals:
            held = f"it holds {', '.join(a.names)}; there are {', '.join(b.names)}"
            fix = f"name what is the same with --pair {a.names[0]}={b.names[0]}"
            raise TraceError(one.name, f"has no signal of {other.name} (case {name}): {held}", fix)
        notes += _alone(name, one.name, a, b) + _alone(name, other.name, b, a) + _durations(name, one, other, a, b)
        ours, theirs = _alike(a.select(signals), b.select(signals))
        converted, crossed = _converted(ours, theirs, other.name)
        crossings += crossed
        notes += _in_one_unit_alone(name, one, other, ours, theirs) + _unheld(name, one, other, ours, converted)
        if text := next((own for own in tolerance.within if own in ours.texts), None):
            raise InputError(f"--within {text}", "is text, of which nothing is tolerated", "leave it out")
        tolerances = {own: 0.0 if own in ours.texts else tolerance.of(own, ours, converted) for own in signals}
        pairs.append(CasePair(name, ours, converted, partings(ours, converted, tolerances)))
        if not any(np.ptp(trace[signal]) for trace in (ours, converted) for signal in signals if len(trace)):
            notes.append(f"case {name}: nothing moves on either side, which tells little of them")
    unknown = [name for name in tolerance.within if not any(name in pair.one.names for pair in pairs)]
    if unknown:
        known = ", ".join(dict.fromkeys(name for pair in pairs for name in pair.one.names))
        raise InputError(f"--within {unknown[0]}", "is no signal of both", f"they have {known}")
    return Comparison(one, other, pairs, notes, logged(crossings))


def _cases(one: Side, other: Side, notes: list[str]) -> Iterator[tuple[str, Trace, Trace]]:
    if len(one.cases) == len(other.cases) == 1:
        [(name, a)], [b] = one.cases.items(), other.cases.values()
        yield name, a, b
        return
    both = [name for name in one.cases if name in other.cases]
    if not both:
        known = " and ".join(", ".join(side.cases) for side in (one, other))
        raise InputError(other.name, f"has no case of {one.name}", f"their cases are {known}")
    for side, against in ((one, other), (other, one)):
        notes += [f"only {side.name} has case {name}" for name in side.cases if name not in against.cases]
    for name in both:
        yield name, one.cases[name], other.cases[name]


def _alone(case: str, side: str, one: Trace, other: Trace) -> list[str]:
    names = [name for name in one.names if name not in other.names]
    return [f"case {case}: only {side} has {', '.join(names)}"] if names else []


def _durations(case: str, one: Side, other: Side, a: Trace, b: Trace) -> list[str]:
    spans = [(side.name, trace.time[0], trace.time[-1]) for side, trace in ((one, a), (other, b)) if len(trace)]
    if len(spans) < 2 or (a.covers(b.time[0], b.time[-1]) and b.covers(a.time[0], a.time[-1])):
        return []
    words = ", ".join(f"{name} from {start:g} to {stop:g} s" for name, start, stop in spans)
    return [f"case {case}: compared where both are: {words}"]


def _in_one_unit_alone(case: str, one: Side, other: Side, a: Trace, b: Trace) -> list[str]:
    """What is assumed of signals that have a unit on one side only."""
    told = []
    for signal in a.numbers.names:
        units = [(one.name, a.unit(signal) or ""), (other.name, b.unit(signal) or "")]
        (with_unit, unit), (without, none) = sorted(units, key=lambda side: not side[1])
        if not none and named(unit).unit not in (None, ONE):
            told.append(f"case {case}: {signal} has no unit of {without}, and is taken in {unit} as of {with_unit}")
    return told


def _unheld(case: str, one: Side, other: Side, a: Trace, b: Trace) -> list[str]:
    """What is not held against each other as it stands: between stamps of both, and where neither has a number."""
    ours, theirs = together(a, b)
    if not len(ours):
        return []
    begin, end = ours.time[0], ours.time[-1]
    own = [int(np.count_nonzero((side.time >= begin) & (side.time <= end))) for side in (a, b)]
    stamps = f"{one.name} has {own[0]}, {other.name} {own[1]}"
    if len(ours) < min(own):
        told = [f"case {case}: compared at the {len(ours)} stamps of both; {stamps}"]
    else:
        told = [f"case {case}: compared on lines between their stamps; {stamps}"] if len(ours) > max(own) else []
    empty = {name: int(np.count_nonzero(np.isnan(ours[name]) & np.isnan(theirs[name]))) for name in ours.names}
    lacking = (f"case {case}: {name} has no number on either side at {n} stamps" for name, n in empty.items() if n)
    return [*told, *lacking]


def _alike(one: Trace, other: Trace) -> tuple[Trace, Trace]:
    """Both with the same numbers for the same texts."""
    if odd := sorted(one.texts.keys() ^ other.texts.keys()):
        text = one if odd[0] in one.texts else other
        raise TraceError(f"{text.name}.{odd[0]}", "is text in one of the two and a number in the other")
    all_texts = {name: tuple(dict.fromkeys((*one.texts[name], *other.texts[name]))) for name in one.texts}
    return _numbered(one, all_texts), _numbered(other, all_texts)


def _numbered(trace: Trace, texts: Mapping[str, tuple[str, ...]]) -> Trace:
    signals = dict(trace.signals)
    for name, known in texts.items():
        places = np.array([*map(known.index, trace.texts[name]), np.nan])  # the last is that of a missing one
        signals[name] = places[np.where(np.isnan(trace[name]), -1, trace[name]).astype(int)]
    return Trace(trace.time, signals, trace.units, trace.name, texts)


def _converted(one: Trace, other: Trace, place: str) -> tuple[Trace, list[Crossing]]:
    """The other trace in the units of the first, and how it got there."""
    numbers = other.numbers.names
    crossings = [crossing(f"{place}: {name}", named(other.unit(name)), named(one.unit(name))) for name in numbers]
    signals = dict(other.signals)
    signals |= {name: how.conversion(other[name]) for name, how in zip(numbers, crossings, strict=True)}
    units = {name: unit for name in other.names if (unit := one.unit(name) or other.unit(name))}
    return Trace(other.time, signals, units, other.name, other.texts), crossings


def _number(signal: str, text: str, unit: str | None) -> float:
    place, found = f"--within {signal}={text}", quantity(text)
    if found is not None:
        value = crossing(place, named(found[1]), named(unit)).conversion.factor * found[0]
    else:
        try:
            value = float(text)
        except ValueError:
            raise InputError(place, "is no number with a unit", f"write --within {signal}=0.1") from None
    if not (value >= 0 and math.isfinite(value)):
        raise InputError(place, "is no distance", "give one of at least 0")
    return value
