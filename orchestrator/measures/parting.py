"""Where two traces of the same signals part: first, most, and by how many times what is tolerated."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fmus.errors import TraceError
from orchestrator.trace import BoolArray, FloatArray, Trace

ROUNDING = 1e-9  # of the duration: stamps that are not farther apart are the same


@dataclass(frozen=True)
class Parting:
    """How a signal of two traces differs.

    Attributes:
        unit: of the signal, "" where none is known.
        tolerance: a difference up to it is none [unit of the signal].
        largest: the largest difference, infinite where only one of the two is a number [unit of the signal].
        at: when that is [s].
        first: when the difference is beyond the tolerance for the first time [s], None where it never is.
        by: the difference then [unit of the signal]; NaN where it never is.
        samples: how many are beyond the tolerance, of how many that were compared.
        texts: of a signal that holds text, what both say then; such signals differ by 1 or not at all.
    """

    KEYS = ("signal", "unit", "tolerance", "largest", "at", "times", "beyond", "first", "by", "texts?")

    signal: str
    unit: str
    tolerance: float
    largest: float
    at: float
    first: float | None
    by: float
    samples: tuple[int, int]
    texts: tuple[str | None, str | None] | None = None

    @property
    def beyond(self) -> bool:
        """Whether the two part."""
        return self.first is not None

    @property
    def times(self) -> float:
        """The largest difference in tolerances; infinite where nothing is tolerated."""
        if not self.largest:
            return 0.0
        return self.largest / self.tolerance if self.tolerance else math.inf


def partings(one: Trace, other: Trace, tolerances: Mapping[str, float]) -> list[Parting]:
    """How each signal of `tolerances` [unit of the signal] differs between two traces that both hold it.

    They are compared where both have samples; where less than two stamps are in both, at the stamps of either, on lines
    between samples.

    Raises:
        TraceError: they have no time in common, or one lacks a signal.
    """
    a, b = together(one.select(tolerances), other.select(tolerances))
    return [_parting(a, b, name, tolerance) for name, tolerance in tolerances.items()]


def together(one: Trace, other: Trace) -> tuple[Trace, Trace]:
    """Both traces at the same times, within the time that both last.

    Raises:
        TraceError: there is none.
    """
    if not len(one) or not len(other):
        raise TraceError((other if len(one) else one).name, "has no samples", "choose another recording")
    start, stop = max(one.time[0], other.time[0]), min(one.time[-1], other.time[-1])
    slack = ROUNDING * max(1.0, one.duration, other.duration)
    if start > stop + slack:
        raise TraceError(one.name, f"has no time in common with {other.name}", "compare recordings of the same times")
    shared = _common(one.time, other.time, slack)
    if shared is not None:
        return one.rows(shared[0]), other.rows(shared[1])
    stamps = np.unique(np.concatenate([one.time, other.time]))
    stamps = stamps[(stamps >= start) & (stamps <= stop)]
    return one.resampled(stamps), other.resampled(stamps)


def _common(one: FloatArray, other: FloatArray, slack: float) -> tuple[BoolArray, BoolArray] | None:
    """Rows of both with the stamps that are in both; None where that are fewer than two."""
    near = np.searchsorted(other, one - slack).clip(max=len(other) - 1)
    same: BoolArray = np.abs(other[near] - one) <= slack
    if np.count_nonzero(same) < 2:
        return None
    mask = np.zeros(len(other), dtype=bool)
    mask[near[same]] = True
    return same, mask


def _parting(one: Trace, other: Trace, name: str, tolerance: float) -> Parting:
    difference = distances(one[name], other[name])
    if name in one.texts:
        difference = (difference > 0).astype(float)
    most = int(np.argmax(difference))
    beyond = np.flatnonzero(difference > tolerance)
    first = int(beyond[0]) if len(beyond) else None
    return Parting(
        name,
        one.unit(name) or "",
        tolerance,
        float(difference[most]),
        float(one.time[most]),
        None if first is None else float(one.time[first]),
        math.nan if first is None else float(difference[first]),
        (len(beyond), len(difference)),
        None if first is None or name not in one.texts else (_said(one, name, first), _said(other, name, first)),
    )


def _said(trace: Trace, name: str, row: int) -> str | None:
    number = float(trace[name][row])
    return None if math.isnan(number) else trace.texts[name][int(number)]


def distances(one: FloatArray, other: FloatArray) -> FloatArray:
    """Distances (K,); none between samples that are the same infinity or both no number, infinite to any other."""
    with np.errstate(invalid="ignore"):
        distance = np.abs(one - other)
    same = (one == other) | (np.isnan(one) & np.isnan(other))
    found: FloatArray = np.where(same, 0.0, np.where(np.isnan(distance), np.inf, distance))
    return found
