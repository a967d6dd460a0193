"""Columns of numbers to Arrow and back over the same memory. Arrow's own ways would import pandas where it is there."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from orchestrator.trace import FloatArray, Trace


def arrays(trace: Trace) -> list[pa.Array]:
    """The stamps, then a column a signal, float64 and bit for bit."""
    values = map(np.ascontiguousarray, (trace.time, *trace.signals.values()))
    return [pa.Array.from_buffers(pa.float64(), len(array), [None, pa.py_buffer(array)]) for array in values]


def numbers(column: pa.ChunkedArray) -> FloatArray:
    """The values of a column of numbers as float64, NaN where one is missing."""
    if column.type != pa.float64():
        column = column.cast(pa.float64(), safe=False)
    return np.concatenate([np.empty(0), *map(_chunk, column.chunks)])


def _chunk(array: pa.Array) -> FloatArray:
    valid, content = array.buffers()
    end = array.offset + len(array)
    values = np.frombuffer(content, dtype=float, count=end)[array.offset :]
    if array.null_count == 0:
        return values
    known = np.unpackbits(np.frombuffer(valid, dtype=np.uint8), count=end, bitorder="little")[array.offset :]
    return np.where(known, values, np.nan)
