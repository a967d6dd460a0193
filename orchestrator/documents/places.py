"""Where in a file stands what an error is about: the key that its place names, or the value of the variable."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from orchestrator.documents.parts import SourceLine, place_of

_VARIANTS = ("cases", "matrix", "sets")  # what gives some cases other values
Keys = tuple[Any, ...]


def line_of(document: Mapping[str, Any], path: Path, place: str) -> SourceLine | None:
    """Where it stands; None where no key is named, or several could be meant.

    Args:
        path: the file of the document.
        place: of an error, `case fast: motor.resistance` or `plants.heavy: set.arm.payload`.
    """
    words = place.split(": ")
    key = max((_followed(document, words[first:]) for first in range(len(words))), key=len)
    scope = _under(document, key)
    expected = [one.get("signal") if isinstance(one, Mapping) else None for one in document.get("expect") or ()]
    found: list[Keys] = [("expect", n) for n, signal in enumerate(expected) if f"expect {signal}" in words]
    for name in (word.partition("[")[0] for word in words):
        found += [key + keys for keys in _values(scope, name)]
    meant = [keys for keys in found if "set" in keys] or found if key else _of_the_case(document, found, words)
    keys = meant[0] if len(meant) == 1 else key
    return place_of(document, path, keys) if keys else None


def _followed(document: Any, words: list[str]) -> Keys:
    """The keys that words name one after the other, `plants.heavy`, `set`, as far as whole words do."""
    found: Keys = ()
    for word in words:
        keys = _spelt(_under(document, found), word)
        if keys is None:
            break
        found += keys
    return found


def _spelt(node: Any, word: str) -> Keys | None:
    """The keys that a word with dots is made of."""
    for key in node if isinstance(node, Mapping) else ():
        if word == str(key):
            return (key,)
        if word.startswith(f"{key}.") and (rest := _spelt(node[key], word.removeprefix(f"{key}."))):
            return (key, *rest)
    return None


def _under(node: Any, keys: Keys) -> Any:
    for key in keys:
        node = node[key]
    return node


def _values(node: Any, name: str) -> Iterator[Keys]:
    """Where component.variable is given a value: under that key, or among the parameters of the component."""
    entries = node.items() if isinstance(node, Mapping) else enumerate(node) if isinstance(node, list) else ()
    for key, value in entries:
        component, _, variable = name.partition(".")
        if key == name and variable:
            yield (key,)
        elif key == "components" and variable and _spelt(value, f"{component}.parameters.{variable}"):
            yield (key, component, "parameters", variable)
        else:
            yield from ((key, *keys) for keys in _values(value, name))


def _of_the_case(document: Mapping[str, Any], found: list[Keys], words: list[str]) -> list[Keys]:
    """Of the places of a value those that count in the case that is named, or in the only one."""
    cases = [one for one in document.get("cases") or () if isinstance(one, Mapping)]
    alone = len(cases) == 1 and "matrix" not in document
    number = next((n for n, one in enumerate(cases) if alone or f"case {one.get('name')}" in words), None)
    common = [keys for keys in found if keys[0] not in _VARIANTS]
    if number is None:
        return found
    own = [keys for keys in found if keys[:2] == ("cases", number)]
    used = [("sets", name) for name in reversed(cases[number].get("use") or ())]
    return own or next(([keys] for of in used for keys in found if keys[:2] == of), common)
