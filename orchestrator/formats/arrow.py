"""A trace's columns as Arrow arrays over the same memory. Arrow itself would import pandas to look at them."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from orchestrator.trace import Trace


def arrays(trace: Trace) -> list[pa.Array]:
    """The stamps, then a column a signal, float64 and bit for bit."""
    values = map(np.ascontiguousarray, (trace.time, *trace.signals.values()))
    return [pa.Array.from_buffers(pa.float64(), len(array), [None, pa.py_buffer(array)]) for array in values]
