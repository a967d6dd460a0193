"""What an FMU declares of its clocks, and where that contradicts itself."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import Any

from fmpy.model_description import ModelDescription
from lxml import etree

from fmus.errors import FmuFileError, WiringError
from orchestrator.rational import seconds

_ATTRIBUTES = (
    "intervalVariability",
    "intervalDecimal",
    "shiftDecimal",
    "resolution",
    "intervalCounter",
    "shiftCounter",
)


class TickInterval(StrEnum):
    """How a clock comes by its next tick: all but the last by time, which the importer watches."""

    CONSTANT = "constant"
    FIXED = "fixed"
    TUNABLE = "tunable"
    CHANGING = "changing"
    COUNTDOWN = "countdown"
    TRIGGERED = "triggered"


PERIODIC = (TickInterval.CONSTANT, TickInterval.FIXED, TickInterval.TUNABLE)


@dataclass(frozen=True)
class Clock:
    """A clock of an FMU.

    Attributes:
        interval: between two ticks, as far as the description tells [s].
        shift: from the start to the first tick [s].
    """

    name: str
    reference: int
    causality: str
    kind: TickInterval
    interval: Fraction | None = None
    shift: Fraction = Fraction(0)

    @property
    def timed(self) -> bool:
        """Whether it is an input that ticks by time."""
        return self.causality == "input" and self.kind is not TickInterval.TRIGGERED

    @property
    def periodic(self) -> bool:
        """Whether it ticks at one interval until somebody changes it."""
        return self.kind in PERIODIC

    def __str__(self) -> str:
        return f"{self.kind} clock '{self.name}'"


def adopt_types(root: etree._Element) -> bool:
    """Give clocks what their declared types say, and take the types away, which FMPy does not know; whether there were
    any."""
    found = root.findall("ModelVariables/Clock[@declaredType]")
    types = {entry.get("name"): entry for entry in root.iterfind("TypeDefinitions/ClockType")}
    for clock in found:
        declared = types.get(clock.attrib.pop("declaredType"))
        said = {} if declared is None else declared.attrib
        for name in _ATTRIBUTES:
            if name in said and name not in clock.attrib:
                clock.set(name, said[name])
    return bool(found)


def amend(description: ModelDescription, root: etree._Element) -> None:
    """Add what FMPy does not read of clocks, as it is written; None where it is not."""
    written = {entry.get("name"): entry for entry in root.iterfind("ModelVariables/Clock")}
    for variable in description.modelVariables:
        if variable.type == "Clock":
            for name in _ATTRIBUTES:
                setattr(variable, name, written[variable.name].get(name))


def clocks(path: Path, description: ModelDescription) -> dict[str, Clock]:
    """Name -> clock.

    Raises:
        FmuFileError: what the description says of one contradicts itself; the message names it and what to correct.
    """
    found = {
        variable.name: _clock(f"{path}: {variable.name}", variable)
        for variable in description.modelVariables
        if variable.type == "Clock"
    }
    for variable in description.modelVariables:
        for clock in variable.clocks or ():
            if clock.type != "Clock":
                problem = f"belongs to the clock '{clock.name}', which is a {clock.type}"
                raise FmuFileError(f"{path}: {variable.name}", problem, "correct `clocks`")
    return found


def _clock(place: str, variable: Any) -> Clock:
    text = variable.intervalVariability
    if text not in list(TickInterval):
        problem = "has no intervalVariability" if text is None else f"has the intervalVariability '{text}'"
        raise FmuFileError(place, problem, f"give {', '.join(TickInterval)}")
    kind = TickInterval(text)
    interval, shift = _length(place, variable, "interval"), _length(place, variable, "shift")
    clock = Clock(variable.name, int(variable.valueReference), variable.causality, kind, interval, shift or Fraction(0))
    if clock.causality not in ("input", "output", "local"):
        raise FmuFileError(place, f"is a clock and a {clock.causality}", "make it an input, an output or local")
    if clock.causality == "output" and kind is not TickInterval.TRIGGERED:
        problem = f"is an output and ticks by time ({kind}): whoever imports the FMU would have to tick it"
        raise FmuFileError(place, problem, "make it an input, or `triggered`")
    if kind is TickInterval.TRIGGERED and interval is not None:
        raise FmuFileError(place, "is triggered and has an interval", "remove the interval, or make it periodic")
    if kind is TickInterval.CONSTANT and interval is None:
        raise FmuFileError(place, "is constant and has no interval", "give intervalDecimal or intervalCounter")
    if interval is not None and interval <= 0:
        raise FmuFileError(place, f"has the interval {float(interval):g} s", "give one above 0")
    if clock.shift < 0:
        raise FmuFileError(place, f"has the shift {float(clock.shift):g} s", "give none below 0")
    return clock


def _length(place: str, variable: Any, what: str) -> Fraction | None:
    """An interval or a shift [s], as a decimal or as a counter of the resolution; None where neither is there."""
    decimal, counter = getattr(variable, f"{what}Decimal"), getattr(variable, f"{what}Counter")
    lengths = [] if decimal is None else [_exact(place, decimal, f"{what}Decimal")]
    if counter is not None and (what == "interval" or counter != "0"):
        resolution = variable.resolution
        if resolution is None:
            raise FmuFileError(place, f"has {what}Counter='{counter}' and no resolution", "give the resolution")
        per = _exact(place, resolution, "resolution")
        if per <= 0:
            raise FmuFileError(place, f"has the resolution {resolution}", "give ticks of its counter per second")
        lengths.append(_exact(place, counter, f"{what}Counter") / per)
    if len(lengths) == 2 and abs(lengths[0] - lengths[1]) > Fraction(1, 10**6) * abs(lengths[1]):
        one, other = (f"{float(length):.9g} s" for length in lengths)
        raise FmuFileError(place, f"has the {what} {one} by its decimal and {other} by its counter", "make them agree")
    return lengths[-1] if lengths else None


def _exact(place: str, text: str, what: str) -> Fraction:
    try:
        return seconds(text, place)
    except WiringError:
        raise FmuFileError(place, f"{what}='{text}' is no number", "correct it") from None
