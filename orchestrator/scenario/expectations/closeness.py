"""How close a signal comes to a reference over a whole window: one figure and its bounds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from orchestrator.fmi.interface import Port
from orchestrator.measures import correlation_lag, fit, largest_deviation, nrmse
from orchestrator.scenario.expectations.base import ExpectationScope, Judgement
from orchestrator.scenario.expectations.figure import FigureBounds
from orchestrator.scenario.expectations.quantities import Dimension
from orchestrator.scenario.expectations.reference import Against
from orchestrator.trace import FloatArray

Measure = Callable[[FloatArray, FloatArray, FloatArray, bool], tuple[float, str]]
"""Stamps (K,) [s], values (K,), reference (K,), whether they hold -> the figure, and what is to be said besides."""


@dataclass(frozen=True)
class ClosenessKind:
    """A figure of closeness: what it is called, what it is, between which values it always lies, and how it is told."""

    words: str
    dimension: Dimension
    lowest: float
    highest: float
    measure: Measure


def _deviation(t: FloatArray, y: FloatArray, r: FloatArray, hold: bool) -> tuple[float, str]:
    deviation, when = largest_deviation(t, y, r)
    return deviation, f", at {when:.6g} s"


def _lag(t: FloatArray, y: FloatArray, r: FloatArray, hold: bool) -> tuple[float, str]:
    lag, correlation = correlation_lag(t, y, r)
    return abs(lag), f" {'later' if lag > 0 else 'earlier'}, then correlated by {correlation:.4g}"


KINDS: Mapping[str, ClosenessKind] = {
    "nrmse": ClosenessKind(
        "NRMSE", Dimension.SHARE, 0.0, float("inf"), lambda t, y, r, hold: (nrmse(t, y, r, hold), "")
    ),
    "fit": ClosenessKind("FIT", Dimension.SHARE, float("-inf"), 1.0, lambda t, y, r, hold: (fit(t, y, r, hold), "")),
    "deviation": ClosenessKind("largest deviation", Dimension.DISTANCE, 0.0, float("inf"), _deviation),
    "lag": ClosenessKind("lag", Dimension.TIME, 0.0, float("inf"), _lag),
}


@dataclass(frozen=True)
class Close(Against):
    """A figure of closeness to the reference lies between bounds.

    Attributes:
        kind: a name in `KINDS`.
    """

    kind: str
    bounds: FigureBounds

    def __str__(self) -> str:
        kind = KINDS[self.kind]
        return f"has {kind.words} {self.bounds.asked(kind.dimension)} to {self.reference.name}"

    def brought(self, place: str, port: Port, wiring: ExpectationScope) -> Self:
        bounds = self.bounds.bounds_in(place, KINDS[self.kind].dimension, port)
        return replace(super().brought(place, port, wiring), bounds=bounds)

    def compared(self, time: FloatArray, values: FloatArray, hold: bool) -> Judgement:
        kind = KINDS[self.kind]
        figure, more = kind.measure(time, values, self.reference.at(time, hold), hold)
        return self.bounds.judgement(kind.words, figure, kind.dimension, more, kind.lowest, kind.highest)

    def precision(self, values: FloatArray) -> float:
        most = 0.0 if self.bounds.at_most is None else float(self.bounds.at_most)
        size = {"nrmse": float(np.ptp(values)), "deviation": 1.0}.get(self.kind, 0.0)
        return most * size or super().precision(values)
