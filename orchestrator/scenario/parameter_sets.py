"""Parameter sets (SSV, as a calibration writes them) and lists (CSV) that give a scenario values."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fmus import units
from fmus.errors import FmuFileError, ServotwinError
from fmus.files import absence
from fmus.packaging.archive import parse_xml
from fmus.words import nearest
from orchestrator.fmi.interface import Value
from orchestrator.scenario import parameter_list
from orchestrator.ssp.description import SsvParameter
from orchestrator.ssp.names import SSV
from orchestrator.ssp.parameters import parameters
from orchestrator.ssp.parameters import units as own_units


@dataclass(frozen=True)
class ParameterValues:
    """What parameter sets and lists give.

    Attributes:
        values: name -> value with its unit, of an array nested lists.
        places: name -> file and line where it stands.
    """

    values: dict[str, Value | list[Any]] = field(default_factory=dict)
    places: dict[str, str] = field(default_factory=dict)


def values_of(files: Sequence[Path], components: Iterable[str]) -> ParameterValues:
    """Values of component.variable; what stands in a later set counts.

    Args:
        components: that there are.

    Raises:
        FmuFileError: a file is no parameter set, or has a value of no component.
    """
    known, found = list(components), ParameterValues()
    for file in files:
        given = values_in(file)
        for name, place in given.places.items():
            component, dot, _ = name.partition(".")
            if not dot or component not in known:
                raise FmuFileError(f"{place}: {name}", f"no component '{component}'", nearest(component, known))
        found.values.update(given.values)
        found.places.update(given.places)
    return found


@contextmanager
def naming_places(places: Mapping[str, str]) -> Iterator[None]:
    """Errors about values of variables name where these stand.

    Args:
        places: name of a variable, or of an array as a whole -> file and line.
    """
    try:
        yield
    except ServotwinError as error:
        words = [word.partition("[")[0] for word in error.place.replace(": ", " ").split()]
        found = (place for name, place in places.items() for word in words if word == name or word.endswith(f".{name}"))
        place = next(found, None)
        if place is None or place in error.place:
            raise
        raise error.within(place) from error


def values_in(file: Path) -> ParameterValues:
    """Values of a set or a list.

    Raises:
        FmuFileError: it is no parameter set, or means something else by the name of a unit.
        ScenarioError: it is no list of parameters.
    """
    if file.suffix.lower() == parameter_list.SUFFIX:
        rows = parameter_list.read(file)
        return ParameterValues({r.name: r.written(r.value) for r in rows}, {r.name: r.place for r in rows})
    if not file.is_file():
        raise FmuFileError(file, absence(file), "check the path")
    root = parse_xml(file, file.read_bytes())
    for name, unit in own_units(root.find(f"{SSV}Units"), str(file)).items():
        if (usual := units.parse(name)) is not None and usual != unit:
            raise FmuFileError(f"{file}: unit {name}", "is another one than is usual by this name", "rename it")
    found = parameters(root, str(file))
    places = {name: f"{file}:{one.line}" for name, one in found.items()}
    return ParameterValues({name: _value(one) for name, one in found.items()}, places)


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
