"""Arrays that a file gives as a whole, in nested lists: their elements by name, and the shape to be checked."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Annotated, Any

from pydantic import AfterValidator
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from fmus.errors import WiringError
from fmus.modelling.model import element_names
from orchestrator.fmi.interface import Value, Written
from orchestrator.system import Endpoint, System

Shape = tuple[int, ...]


def elements(given: Mapping[str, Value | list[Any]]) -> dict[str, Value]:
    """Name -> value; of an array each element under its own, `A[1,2]`, over what stands before it."""
    values: dict[str, Value] = {}
    for name, value in given.items():
        if isinstance(value, list):
            values |= zip(element_names(name, _shape(name, value)), _flat(value), strict=True)
        else:
            values[name] = value
    return values


def shapes(given: Mapping[str, Value | list[Any]]) -> dict[str, Shape]:
    """Name -> shape of the arrays among them."""
    return {name: _shape(name, value) for name, value in given.items() if isinstance(value, list)}


def written(name: str, text: str) -> list[Any]:
    """An array as text, `[[1, 2], [3, 4]]`, its elements as they are written.

    Raises:
        ValueError: it is none.
    """
    try:
        nested = YAML(typ="base", pure=True).load(text)
    except (YAMLError, RecursionError):
        nested = None
    if not isinstance(nested, list) or not nested:
        raise ValueError(f"'{text}' is no array of anything")
    _shape(name, nested)
    return _written(nested)


def _written(nested: list[Any]) -> list[Any]:
    return [_written(entry) if isinstance(entry, list) else Written(entry) for entry in nested]


def all_elements(system: System, names: Iterable[str]) -> tuple[str, ...]:
    """The names, those of whole arrays as the names of all their elements."""
    found: list[str] = []
    for name in names:
        end = Endpoint.parse(name)
        shape = system.shape(end)
        found += (
            [name] if shape is None else (str(replace(end, variable=e)) for e in element_names(end.variable, shape))
        )
    return tuple(found)


def check_shapes(system: System, given: Mapping[str, Shape]) -> None:
    """See that arrays, named `component.array`, have the shapes in which they are given.

    Raises:
        WiringError: there is no such array, or its shape is another.
    """
    for name, shape in given.items():
        component, _, variable = name.partition(".")
        there = system.parts[component].interface.shape(variable) if component in system.parts else None
        if there is None and math.prod(shape) > 0:
            raise WiringError(name, "is no array", "give a number, or see `servotwin info`")
        if there is not None and there != shape:
            raise WiringError(name, f"is given as {_words(shape)} and is {_words(there)}", "give all its elements")


def _words(shape: Shape) -> str:
    return " x ".join(map(str, shape)) + (" elements" if len(shape) == 1 else "")


def _shape(name: str, nested: list[Any]) -> Shape:
    shape: list[int] = []
    level: list[Any] = [nested]
    while level and isinstance(level[0], list):
        if {type(row) for row in level} != {list} or len({len(row) for row in level}) != 1:
            raise ValueError(f"the rows of '{name}' differ in length")
        shape.append(len(level[0]))
        level = [entry for row in level for entry in row]
    if any(isinstance(entry, list) for entry in level):
        raise ValueError(f"the rows of '{name}' differ in length")
    return tuple(shape)


def _flat(nested: list[Any]) -> list[Value]:
    return [value for entry in nested for value in (_flat(entry) if isinstance(entry, list) else [entry])]


def _plain(name: str, given: Any) -> Any:
    """The value without what a YAML reader keeps about it."""
    for kind in (bool, int, float, str):
        if isinstance(given, kind):
            return kind(given)
    if isinstance(given, list):
        return [_plain(name, entry) for entry in given]
    raise ValueError(f"'{name}' holds something that is neither a number nor text")


def _checked(given: dict[str, Value | list[Any]]) -> dict[str, Value | list[Any]]:
    plain = {name: _plain(name, value) if isinstance(value, list) else value for name, value in given.items()}
    shapes(plain)
    return plain


Values = Annotated[dict[str, Value | list[Any]], AfterValidator(_checked)]
"""Values in a file: each a number, true or false, text, or an array of these in nested lists."""
