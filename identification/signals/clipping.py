"""Where a signal stops at an end of its range while what it shows goes on: a sensor, or its converter, at its limit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from identification.signals.resolution import resolution
from orchestrator.marks import runs
from orchestrator.trace import FloatArray

_LONG = 3  # samples of one value, from which it rests there
_SUDDEN = 4.0  # counts in a sample just before; a swing turns with fewer
_OFTEN = 2


@dataclass(frozen=True)
class Clipped:
    """A value that is never passed and that a signal keeps, coming to it in full motion.

    Attributes:
        value: [unit of the signal].
        highest: whether it is the highest value, otherwise the lowest.
        stretches: first sample, and the first after it, of each time that it comes to it so.
        share: of the samples that have the value.
    """

    value: float
    highest: bool
    stretches: tuple[tuple[int, int], ...]
    share: float


def clipped(values: FloatArray) -> Iterator[Clipped]:
    """The ends of its range at which a signal (K,) stops."""
    for value, highest in ((float(values.max()), True), (float(values.min()), False)):
        rests = [(first, after) for first, after in runs(values == value) if after - first >= _LONG and first >= 2]
        if len(rests) < _OFTEN:
            continue
        least = _SUDDEN * resolution(values)
        found = tuple(rest for rest in rests if abs(values[rest[0] - 1] - values[rest[0] - 2]) > least)
        if len(found) >= _OFTEN:
            yield Clipped(value, highest, found, float(np.mean(values == value)))
