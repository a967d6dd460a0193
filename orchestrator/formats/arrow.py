"""Columns of numbers to Arrow and back over the same memory, and texts with the numbers that stand for them.

Arrow's own ways would import pandas where it is there.
"""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from orchestrator.trace import FloatArray, Trace


def arrays(trace: Trace) -> list[pa.Array]:
    """The stamps, then a column a signal, float64 and bit for bit, or text."""
    return [_floats(trace.time), *(_column(trace, name) for name in trace.names)]


def _column(trace: Trace, name: str) -> pa.Array:
    if name not in trace.texts:
        return _floats(trace[name])
    missing = np.isnan(trace[name])
    places = pa.array(np.where(missing, 0, trace[name]).astype(np.int32), mask=missing)
    return pa.DictionaryArray.from_arrays(places, pa.array(trace.texts[name], pa.string())).dictionary_decode()


def _floats(values: FloatArray) -> pa.Array:
    array = np.ascontiguousarray(values)
    return pa.Array.from_buffers(pa.float64(), len(array), [None, pa.py_buffer(array)])


def is_text(kind: pa.DataType) -> bool:
    """Whether a column holds text."""
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def texts(column: pa.ChunkedArray) -> tuple[FloatArray, tuple[str, ...]]:
    """Numbers for a column of text, NaN where one is missing, and the texts that they stand for."""
    plain = pa.chunked_array([*column.cast(pa.string()).chunks, pa.array([], pa.string())]).combine_chunks()
    coded = plain.dictionary_encode()
    return numbers(pa.chunked_array([coded.indices])), tuple(coded.dictionary.to_pylist())


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
