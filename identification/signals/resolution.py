"""The step in which a recorded signal was counted, as converters, encoders and CAN signals do."""

from __future__ import annotations

import math

import numpy as np

from orchestrator.trace import FloatArray

_REPEATED = 2.0  # samples for each value, at least, of a signal that was counted
_OFF = 1e-3  # of a step: by how much values may lie beside a multiple of it
_ROUNDING = 1e-12  # of the largest value
ROUNDED = 1 / math.sqrt(12)  # rms error of rounding, in steps


def resolution(values: FloatArray) -> float:
    """The step that all differences of values (K,) are multiples of [their unit]; 0 where there is none.

    A signal of which hardly any value comes twice is taken for one without steps.
    """
    distinct = np.unique(values)
    if len(distinct) < 2 or len(values) < _REPEATED * len(distinct):
        return 0.0
    gaps = np.diff(distinct)
    gaps = gaps[gaps > _ROUNDING * float(np.abs(distinct).max())]
    if not len(gaps):
        return 0.0
    counts = gaps / gaps.min()
    step = float(gaps.sum() / np.round(counts).sum())
    return step if float(np.abs(gaps / step - np.round(gaps / step)).max()) <= _OFF else 0.0
