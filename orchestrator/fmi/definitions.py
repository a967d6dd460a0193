"""What an FMU says by its own word, what it cannot mean, and what it may not mean: units, values, aliases, places."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fmpy.model_description import ModelDescription, ModelVariable

from fmus.errors import FmuFileError
from fmus.parameters.bounds import span
from fmus.units import BASES, SECOND, Unit
from fmus.words import nearest
from orchestrator.fmi.interface import Port

if TYPE_CHECKING:
    from lxml import etree

_ASK = "ask its supplier for a valid FMU"
_KINDS = {
    "causality": (
        *("parameter", "calculatedParameter", "structuralParameter"),
        *("input", "output", "local", "independent"),
    ),
    "variability": ("constant", "fixed", "tunable", "discrete", "continuous"),
    "initial": ("exact", "approx", "calculated"),
}


def units(path: Path, description: ModelDescription) -> dict[str, Unit]:
    """Name -> unit as the FMU defines it; of display units those that no unit is named like, if they mean one thing.

    Raises:
        FmuFileError: a factor that is no number but 0, or two meanings of one unit.
    """
    defined, shown, several = dict[str, Unit](), dict[str, Unit](), set[str]()
    for entry in description.unitDefinitions:
        if entry.baseUnit is None:
            continue
        base = entry.baseUnit
        exponents = tuple(int(getattr(base, name)) for name in BASES)
        unit = Unit(float(base.factor), exponents, float(base.offset))
        if defined.setdefault(entry.name, unit) != unit:
            raise FmuFileError(f"{path}: unit {entry.name}", "is defined twice, and differently", _ASK)
        for display in entry.displayUnits:
            factor, offset = float(display.factor), float(display.offset)
            scale = unit.factor / factor if factor else math.inf
            meant = Unit(scale, exponents, unit.offset - scale * offset)
            if shown.setdefault(display.name, meant) != meant:
                several.add(display.name)
    found = {name: unit for name, unit in shown.items() if name not in several} | defined
    for name, unit in found.items():
        if not (math.isfinite(unit.factor) and unit.factor and math.isfinite(unit.offset)):
            raise FmuFileError(f"{path}: unit {name}", "has a factor or offset that converts nothing", "correct it")
    return found


def check_places(root: etree._Element) -> None:
    """See that what FMI 2 counts from 1 is nowhere 0 or less, which FMPy would count from the end.

    Raises:
        LookupError: it is.
    """
    for entry in root.iterfind("ModelStructure/*/Unknown"):
        for place in f"{entry.get('index', '')} {entry.get('dependencies', '')}".split():
            if int(place) < 1:
                raise LookupError(f"variable {place} of ModelStructure")


def check_variable(path: Path, variable: ModelVariable, port: Port, shape: Sequence[int]) -> None:
    """See that a variable is of a kind that FMI has, and can have some value.

    Args:
        port: of an array as a whole.
        shape: of an array as it is declared.

    Raises:
        FmuFileError: it is of no such kind, has bounds that nothing lies between, no elements, or a start value of
            another type; or it is a time that is not counted in seconds.
    """
    place, low, high = f"{path}: {port.name}", port.minimum, port.maximum
    for word, known in _KINDS.items():
        said = getattr(variable, word)
        if said is not None and said not in known:
            raise FmuFileError(place, f"{word}='{said}' is none of FMI", nearest(said, known))
    if not (-math.inf if low is None else low) <= (math.inf if high is None else high):
        raise FmuFileError(place, f"has no value between its bounds {span(low, high)}", _ASK)
    if min(shape, default=1) < 1:
        raise FmuFileError(place, f"is an array of {' x '.join(map(str, shape))} elements", _ASK)
    if port.causality == "independent" and port.measure.unit not in (None, SECOND):
        raise FmuFileError(place, f"counts in {port.unit}, where runs count seconds", "export it with a time in s")
    _check_starts(place, port, variable.start)


def _check_starts(place: str, port: Port, start: str | Sequence[str] | None) -> None:
    """See that the start value of a scalar, or those of an array, are of its type."""
    if start is None or port.alone or port.type == "String":
        return
    for text in start.split() or [start] if isinstance(start, str) else start:
        try:
            port.parsed(text)
        except ValueError:
            items = ", ".join(f"{name} ({number})" for name, number in (port.items or {}).items())
            fix = f"correct it: there are {items}" if items else "correct it"
            raise FmuFileError(place, f"start='{text}' is no {port.type}", fix) from None


def check_aliases(path: Path, description: ModelDescription, ports: Iterable[Port]) -> None:
    """See that variables with one value reference can be one: FMI 3 has declared aliases only, FMI 2 those of one type,
    with one unit and one start value, and no two inputs.

    Args:
        ports: of all variables, of arrays as a whole.

    Raises:
        FmuFileError: two cannot.
    """
    first: dict[tuple[str, int], Port] = {}
    for variable, port in zip(description.modelVariables, ports, strict=True):
        if variable.alias is not None:
            continue
        modern = description.fmiVersion.startswith("3")
        kind = "" if modern else {"Enumeration": "Integer"}.get(port.type, port.type)
        other = first.setdefault((kind, port.reference), port)
        apart = "" if other is port else "are two variables" if modern else _apart(other, port)
        if apart:
            problem = f"has the value reference {port.reference} of {other.name}, and they {apart}"
            raise FmuFileError(f"{path}: {port.name}", problem, _ASK)


def _apart(one: Port, other: Port) -> str:
    """Why two variables of FMI 2 cannot be one, "" where they can."""
    if one.causality == other.causality == "input":
        return "are both inputs"
    if None not in (one.start, other.start) and one.parsed(one.start or "") != other.parsed(other.start or ""):
        return f"start from {one.start} and from {other.start}"
    units = one.measure.unit, other.measure.unit
    if None not in units and units[0] != units[1]:
        return f"are in {one.unit} and in {other.unit}"
    return ""


def doubts(description: ModelDescription, ports: Iterable[Port]) -> dict[str, str]:
    """Variable, or else what there is, -> what a description says that may not be meant, with the fix.

    Bounds say for what values an FMU is made; a start value outside of them is still the one that it has.
    """
    found = {port.name: why for port in ports if (why := _doubt(port))}
    for variable in description.modelVariables:
        declared = getattr(variable.declaredType, "nominal", None)
        nominal = _number(declared if variable.nominal is None else variable.nominal)
        if nominal is not None and not 0 < nominal < math.inf:
            found.setdefault(variable.name, f"has the nominal value {nominal:g}, which should be positive")
    experiment = description.defaultExperiment
    begin, end = (_number(getattr(experiment, key, None)) for key in ("startTime", "stopTime"))
    begin = begin or 0.0
    if not 0 <= begin < math.inf or not begin <= (begin if end is None else end) < math.inf:
        found["default experiment"] = f"is from {begin:g} s to {begin if end is None else end:g} s: say when runs stop"
    for key in ("stepSize", "tolerance"):
        value = _number(getattr(experiment, key, None))
        if value is not None and not 0 < value < math.inf:
            found.setdefault("default experiment", f"has the {key} {value:g}, which should be positive")
    return found


def _doubt(port: Port) -> str:
    """What may not be meant by the start value of a variable; "" where nothing is."""
    if port.start is None:
        needed = port.causality in ("parameter", "input") and port.array is None and not port.alone
        return "has no start value, so that only the FMU knows it: give it one" if needed else ""
    value = port.start_number
    if value is None or not port.numeric:
        return ""
    if not math.isfinite(value):
        return f"starts from {port.start}, which is no finite number: give it one"
    low, high = port.minimum, port.maximum
    if (low is not None and value < low) or (high is not None and value > high):
        return f"starts from {value:g}, outside its bounds {span(low, high)}: give it a value inside"
    return ""


def _number(text: str | None) -> float | None:
    """What is written as a number; what cannot be read is NaN."""
    try:
        return None if text is None else float(text)
    except ValueError:
        return math.nan
