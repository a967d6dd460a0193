"""What comes out of a file: a trace, and what is to be known about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from fmus.words import listed
from orchestrator.marks import Mark
from orchestrator.stamps import StampReport
from orchestrator.trace import FloatArray, Trace

if TYPE_CHECKING:
    from orchestrator.formats.layout import Layout

_WHOLE, _LONGEST = 2.0**53, 2.0**64  # from where doubles leave whole numbers out; beyond those of files


@dataclass(frozen=True)
class Recording:
    """A trace and where it is from.

    Attributes:
        trace: the samples, stamps strictly increasing.
        stamps: what had to be done to the stamps.
        path: the file.
        sha256: hexadecimal hash of the file.
        notes: what else was found in it, a line each.
        start: POSIX time of the trace's time 0 [s], where the file knows it.
        found: the notes' figures, as plain values.
        layout: how the file was read, with what was seen in it.
        marks: stretches that are not to be trusted.
    """

    trace: Trace
    stamps: StampReport
    path: Path
    sha256: str
    notes: tuple[str, ...] = ()
    start: float | None = None
    found: Mapping[str, object] = field(default_factory=dict)
    layout: Layout | None = None
    marks: tuple[Mark, ...] = ()


def coarse(largest: Mapping[str, float]) -> tuple[str, ...]:
    """A line about signals with whole numbers that doubles do not tell apart, by what their magnitudes reach."""
    kept = [f"'{name}' to {np.spacing(one):g}" for name, one in largest.items() if _WHOLE <= one <= _LONGEST]
    return (f"whole numbers beyond 2^53 are rounded, as doubles are: {listed(kept)}",) if kept else ()


def largest(trace: Trace, before: Mapping[str, float] = MappingProxyType({})) -> dict[str, float]:
    """What the magnitudes of the signals reach below those beyond 64 bits, here and in the pieces before."""
    return {name: max(before.get(name, 0.0), _largest(values)) for name, values in trace.signals.items()}


def _largest(values: FloatArray) -> float:
    reached = float(np.fmax(np.fmax.reduce(values, initial=0.0), -np.fmin.reduce(values, initial=0.0)))
    if reached <= _LONGEST:
        return reached
    return _largest(values[np.abs(values) <= _LONGEST])
