"""A candidate as a study of its own: the document of the study, changed where the candidate says so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from fmus.files import RawMap

CANDIDATES = "candidates"
_ENTRIES = ("components", "inputs", "outputs", "initial", "parameters")


def of_candidate(document: Mapping[str, Any], name: str) -> RawMap:
    """The study that a candidate of this one is, without candidates; `document` stays as it is.

    Entries of maps are replaced as a whole, those that are null removed; then `set` fixes values, and `free` says
    which parameters are estimated.

    Raises:
        ValueError: it changes what is not there; the message begins with the key.
    """
    change = document[CANDIDATES][name] or {}
    own = {key: value for key, value in document.items() if key != CANDIDATES}
    for key in _ENTRIES:
        if change.get(key):
            own[key] = _joined(key, own.get(key) or {}, change[key])
    if change.get("connections") is not None:
        own["connections"] = change["connections"]
    for variable, value in (change.get("set") or {}).items():
        own = _with_value(own, variable, value)
    if change.get("free") is not None:
        own["parameters"] = _freed(own.get("parameters") or {}, change["free"])
    return own


def _joined(key: str, known: Mapping[str, Any], change: Mapping[str, Any]) -> RawMap:
    """The entries with those of a change in the place of their own."""
    for name, entry in change.items():
        if entry is None and name not in known:
            raise ValueError(f"{key}.{name}: is not there to be removed; there are {', '.join(known) or 'none'}")
    return {name: entry for name, entry in {**known, **change}.items() if entry is not None}


def _with_value(own: RawMap, name: str, value: Any) -> RawMap:
    """The study with a value that is not estimated."""
    if name in (own.get("parameters") or {}):
        return {**own, "parameters": {**own["parameters"], name: {"start": value, "fixed": True}}}
    if name in (own.get("initial") or {}):
        raise ValueError(f"set.{name}: is read off the recordings; write `initial: {{{name}: null}}` beside it")
    component, dot, variable = name.partition(".")
    components = own["components"]
    if not dot or component not in components:
        raise ValueError(f"set.{name}: there is no component '{component}'; there are {', '.join(components)}")
    block = components[component]
    values = {**(block.get("parameters") or {}), variable: value}
    return {**own, "components": {**components, component: {**block, "parameters": values}}}


def _freed(parameters: Mapping[str, Any], free: Sequence[str]) -> RawMap:
    """The parameters of which only these are estimated; others stay where they start, tied ones tied."""
    for name in free:
        if name not in parameters:
            raise ValueError(f"free: '{name}' is no parameter; there are {', '.join(parameters)}")
    made: RawMap = {}
    for name, entry in parameters.items():
        kept = {key: value for key, value in entry.items() if key != "fixed"}
        held = {key: value for key, value in kept.items() if key != "prior"} | {"fixed": True}
        made[name] = kept if name in free or entry.get("tied") is not None else held
    return made
