"""Documents from values of ours: what a dataclass is in JSON, in one way wherever a document is written."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from fractions import Fraction
from pathlib import PurePath
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"


def as_json(value: object) -> Json:
    """A value as JSON has it: arrays as lists, paths and enums as text, null for a number that is none.

    A dataclass becomes a map; see `document_of`.

    Raises:
        TypeError: JSON has nothing like it.
    """
    if hasattr(value, "tolist"):  # of NumPy, which need not be loaded
        value = value.tolist()
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float | Fraction):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, str | PurePath):
        return str(value)
    if isinstance(value, Mapping):
        return {str(key): as_json(entry) for key, entry in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        return document_of(value)
    if isinstance(value, Iterable):
        return [as_json(entry) for entry in value]
    raise TypeError(f"{type(value).__name__} is nothing that JSON has")


def json_text(document: object, *, ascii_alone: bool = True) -> str:
    """A document as its file has it: floats with every bit; a NaN that is in no dataclass is refused."""
    return json.dumps(document, indent=2, allow_nan=False, default=as_json, ensure_ascii=ascii_alone) + "\n"


def document_of(value: DataclassInstance) -> dict[str, Json]:
    """The map of its fields; or of the attributes that its `KEYS` names, and of one with a question mark only where
    there is something: `KEYS = ("name", "seconds", "note?")`."""
    keys = getattr(value, "KEYS", None) or [field.name for field in fields(value)]
    found: dict[str, Json] = {}
    for key in keys:
        name = key.removesuffix("?")
        entry = as_json(getattr(value, name))
        if name == key or entry:
            found[name] = entry
    return found
