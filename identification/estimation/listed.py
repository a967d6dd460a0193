"""Parameters of a study from lists (CSV), and values of its components from parameter sets, in its document."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fmus.errors import ScenarioError
from fmus.files import RawMap
from fmus.words import nearest
from orchestrator.crossing import quantity
from orchestrator.scenario import parameter_list, parameter_sets
from orchestrator.scenario.parameter_list import ListedParameter

ESTIMATE, SETS = "estimate", "parameter_sets"


def listed(document: Mapping[str, Any], base: Path) -> dict[str, ListedParameter]:
    """Name -> row of the lists that a study estimates the parameters of; what stands in a later one counts.

    Args:
        base: the folder that its paths are relative to.

    Raises:
        ScenarioError: a file is none, or a row names no component.
    """
    components, found = list(document.get("components") or {}), dict[str, ListedParameter]()
    for file in _files(document, ESTIMATE, base):
        for one in parameter_list.read(file):
            component, dot, _ = one.name.partition(".")
            if dot and component not in components:
                raise ScenarioError(
                    f"{one.place}: {one.name}", f"no component '{component}'", nearest(component, components)
                )
            found[one.name] = one
    return found


def complete(document: Mapping[str, Any], base: Path) -> RawMap:
    """The document with what is in its lists and parameter sets, and without their names.

    An entry of a list is below the one of its name in `parameters`, key by key; values are over those of components.

    Raises:
        ScenarioError: as `listed`.
        FmuFileError: a file is no parameter set, or has a value of no component.
    """
    own = {key: value for key, value in document.items() if key not in (ESTIMATE, SETS)}
    rows = listed(document, base)
    if rows:
        given = own.get("parameters") or {}
        below = {name: _entry(row) for name, row in rows.items()}
        joined = {name: _joined(below.get(name, {}), entry or {}) for name, entry in given.items()}
        own["parameters"] = {name: joined.get(name, entry) for name, entry in below.items()} | joined
    components = own.get("components") or {}
    for name, value in parameter_sets.values_of(_files(document, SETS, base), components).values.items():
        component, _, variable = name.partition(".")
        block = components[component]
        components = {
            **components,
            component: {**block, "parameters": {**(block.get("parameters") or {}), variable: value}},
        }
    return {**own, "components": components}


def units(document: Mapping[str, Any], base: Path) -> dict[str, tuple[str, str]]:
    """Name -> where a value of a list or parameter set stands, and its unit, of those that have one of their own."""
    components = list(document.get("components") or {})
    found, given = dict[str, tuple[str, str]](), parameter_sets.values_of(_files(document, SETS, base), components)
    for name, value in given.values.items():
        if isinstance(value, str) and (known := quantity(value)):
            found[name] = (given.places[name], known[1])
    rows = listed(document, base)
    return found | {name: (row.place, row.unit) for name, row in rows.items() if row.unit}


def places(document: Mapping[str, Any], base: Path) -> dict[str, str]:
    """Name -> where what a list or parameter set says of it stands."""
    given = parameter_sets.values_of(_files(document, SETS, base), list(document.get("components") or {}))
    return {**given.places, **{name: row.place for name, row in listed(document, base).items()}}


def _files(document: Mapping[str, Any], key: str, base: Path) -> list[Path]:
    given = document.get(key) or []
    return [base / file for file in (given if isinstance(given, list) else [given])]


def _entry(row: ListedParameter) -> RawMap:
    ends = {"start": row.value, "min": row.low, "max": row.high}
    return {key: row.written(end) for key, end in ends.items() if end is not None}


def _joined(below: RawMap, own: Mapping[str, Any]) -> RawMap:
    return dict(own) if own.get("tied") is not None else {**below, **own}
