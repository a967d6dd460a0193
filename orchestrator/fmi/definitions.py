"""What units are by an FMU's own word."""

from __future__ import annotations

import math
from pathlib import Path

from fmpy.model_description import ModelDescription

from fmus.errors import FmuFileError
from fmus.units import BASES, Unit


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
