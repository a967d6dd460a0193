"""Differences between traces as plain values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NotRequired

from typing_extensions import TypedDict

from orchestrator.measures import Parting


class PartingDocument(TypedDict):
    """How a signal of two traces differs; numbers that JSON cannot hold are None.

    Attributes:
        times: the largest difference in tolerances.
        first, by: when the difference is beyond the tolerance for the first time, and the difference then.
        texts: what the two say then, of a signal that holds text.
    """

    signal: str
    unit: str
    tolerance: float
    largest: float | None
    at: float
    times: float | None
    beyond: bool
    first: float | None
    by: float | None
    texts: NotRequired[list[str | None]]


def documents_of(found: Sequence[Parting]) -> list[PartingDocument]:
    """Each in plain values."""
    return [_document(one) for one in found]


def _document(one: Parting) -> PartingDocument:
    document: PartingDocument = {
        "signal": one.signal,
        "unit": one.unit,
        "tolerance": one.tolerance,
        "largest": _number(one.largest),
        "at": one.at,
        "times": _number(one.times),
        "beyond": one.beyond,
        "first": one.first,
        "by": None if one.first is None else _number(one.by),
    }
    if one.texts is not None:
        document["texts"] = [*one.texts]
    return document


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
