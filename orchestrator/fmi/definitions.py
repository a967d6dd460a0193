"""What an FMU says by its own word, and what it cannot mean: units, start values, places in its structure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fmpy.model_description import ModelDescription

from fmus.errors import FmuFileError
from fmus.units import BASES, Unit
from orchestrator.fmi.interface import Port

if TYPE_CHECKING:
    from lxml import etree


def units(path: Path, description: ModelDescription) -> dict[str, Unit]:
    """Name -> unit as the FMU defines it; of display units those that no unit is named like.

    Raises:
        FmuFileError: a factor that is no number but 0.
    """
    defined, shown = {}, {}
    for entry in description.unitDefinitions:
        if entry.baseUnit is None:
            continue
        base = entry.baseUnit
        exponents = tuple(int(getattr(base, name)) for name in BASES)
        defined[entry.name] = unit = Unit(float(base.factor), exponents, float(base.offset))
        for display in entry.displayUnits:
            factor, offset = float(display.factor), float(display.offset)
            scale = unit.factor / factor if factor else math.inf
            shown[display.name] = Unit(scale, exponents, unit.offset - scale * offset)
    found = shown | defined
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


def check_starts(path: Path, port: Port, start: str | Sequence[str] | None) -> None:
    """See that the start value of a scalar, or those of an array, are of its type.

    Raises:
        FmuFileError: one is not.
    """
    if start is None or port.alone or port.type == "String":
        return
    for text in start.split() or [start] if isinstance(start, str) else start:
        try:
            port.parsed(text)
        except ValueError:
            raise FmuFileError(f"{path}: {port.name}", f"start='{text}' is no {port.type}", "correct it") from None
