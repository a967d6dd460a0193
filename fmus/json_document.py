"""Documents from values of ours: what a dataclass is in JSON, in one way wherever a document is written."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from datetime import datetime
from fractions import Fraction
from operator import attrgetter
from pathlib import PurePath
from typing import Any, TypeAlias

Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"


def as_json(value: object) -> Json:
    """A value as JSON has it: arrays as lists, sets and counts in order, paths, dates and enums as text, null for a
    number that is none.

    A dataclass, or what has `KEYS`, becomes a map; see `document_of`.

    Raises:
        TypeError: JSON has nothing like it.
    """
    if hasattr(value, "tolist"):  # of NumPy, which need not be loaded
        value = value.tolist()
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float | Fraction):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, str | PurePath | datetime):
        return value.isoformat() if isinstance(value, datetime) else str(value)
    if isinstance(value, Mapping):
        entries = sorted(value.items()) if isinstance(value, Counter) else value.items()
        return {str(key): as_json(entry) for key, entry in entries}
    if hasattr(value, "KEYS") or is_dataclass(value):
        return document_of(value)
    if isinstance(value, Iterable):
        return [as_json(entry) for entry in (sorted(value) if isinstance(value, set) else value)]
    raise TypeError(f"{type(value).__name__} is nothing that JSON has")


def json_text(document: object, *, ascii_alone: bool = True) -> str:
    """A document as its file has it: floats with every bit; a NaN that is in no dataclass is refused."""
    return json.dumps(document, indent=2, allow_nan=False, default=as_json, ensure_ascii=ascii_alone) + "\n"


def document_of(value: Any) -> dict[str, Json]:
    """The map of its fields; or of the attributes that its `KEYS` names, `KEYS = ("name", "took=seconds", "bus.rate",
    "note?")`: under another name, of an attribute by its own name, with a question mark only where there is something.
    """
    found: dict[str, Json] = {}
    for key in getattr(value, "KEYS", None) or [field.name for field in fields(value)]:
        name, _, path = key.removesuffix("?").rpartition("=")
        entry = as_json(attrgetter(path)(value))
        if entry or not key.endswith("?"):
            found[name or path.rpartition(".")[2]] = entry
    return found
