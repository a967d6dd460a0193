"""Parameter sets (SSV, as a calibration writes them) and lists (CSV) that give a scenario values."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from fmus import units
from fmus.errors import FmuFileError
from fmus.files import absence
from fmus.packaging.archive import parse_xml
from fmus.words import nearest
from orchestrator.fmi.interface import Value
from orchestrator.scenario import parameter_list
from orchestrator.ssp.description import SsvParameter
from orchestrator.ssp.names import SSV
from orchestrator.ssp.parameters import parameters
from orchestrator.ssp.parameters import units as own_units


def values_of(files: Sequence[Path], components: Iterable[str]) -> dict[str, Value | list[Any]]:
    """component.variable -> value with its unit, of an array nested lists; what stands in a later set counts.

    Args:
        components: that there are.

    Raises:
        FmuFileError: a file is no parameter set, or has a value of no component.
    """
    known, found = list(components), dict[str, Value | list[Any]]()
    for file in files:
        for name, value in values_in(file).items():
            component, dot, _ = name.partition(".")
            if not dot or component not in known:
                raise FmuFileError(f"{file}: {name}", f"no component '{component}'", nearest(component, known))
            found[name] = value
    return found


def values_in(file: Path) -> dict[str, Value | list[Any]]:
    """Parameter -> value with its unit of a set or a list, of an array nested lists.

    Raises:
        FmuFileError: it is no parameter set, or means something else by the name of a unit.
        ScenarioError: it is no list of parameters.
    """
    if file.suffix.lower() == parameter_list.SUFFIX:
        return {one.name: one.written(one.value) for one in parameter_list.read(file)}
    if not file.is_file():
        raise FmuFileError(file, absence(file), "check the path")
    root = parse_xml(file, file.read_bytes())
    for name, unit in own_units(root.find(f"{SSV}Units"), str(file)).items():
        if (usual := units.parse(name)) is not None and usual != unit:
            raise FmuFileError(f"{file}: unit {name}", "is another one than is usual by this name", "rename it")
    return {name: _value(one) for name, one in parameters(root, str(file)).items()}


def _value(parameter: SsvParameter) -> Value | list[Any]:
    unit = "" if parameter.unit in (None, "1") else f" {parameter.unit}"
    if not isinstance(parameter.value, tuple):
        return _with(parameter.value, unit)
    nested: list[Any] = [_with(one, unit) for one in parameter.value]
    for size in reversed(parameter.shape[1:]):
        nested = [nested[first : first + size] for first in range(0, len(nested), size)]
    return nested


def _with(value: float | str, unit: str) -> Value:
    return f"{value!r}{unit}" if unit and isinstance(value, float) else value


def joined(files: Path | list[Path] | None, base: Path) -> list[Path]:
    """The files of a key that names one or several, as seen from a folder."""
    return [base / file for file in (files if isinstance(files, list) else [files] if files else [])]
