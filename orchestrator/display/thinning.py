"""Fewer points of a curve without losing its peaks, so that a report stays small."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Samples = NDArray[np.float64]


def thin(time: Samples, values: Samples, limit: int = 2000) -> tuple[Samples, Samples]:
    """At most `limit` of the points (K,): both ends, and of every stretch the lowest and the highest.

    A NaN survives where a whole stretch consists of them, so that a gap in the curve stays a gap.
    """
    count = len(values)
    if count <= limit:
        return time, values
    width = -(-count // ((limit - 2) // 2))
    rows = np.arange(-(-count // width) * width).reshape(-1, width).clip(max=count - 1)
    stretches = values[rows]
    missing = np.isnan(stretches)
    lowest = np.argmin(np.where(missing, np.inf, stretches), axis=1)
    highest = np.argmax(np.where(missing, -np.inf, stretches), axis=1)
    stretch = np.arange(len(rows))
    kept = np.unique(np.concatenate([[0], rows[stretch, lowest], rows[stretch, highest], [count - 1]]))
    return time[kept], values[kept]
