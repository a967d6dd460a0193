"""Linear recursions over long records, without a loop over samples.

The samples are cut into blocks that advance side by side: two passes of as many small matrix products as a block has
samples, whatever the record's length.
"""

from __future__ import annotations

import math

import numpy as np

from orchestrator.trace import FloatArray

_LONGEST_BLOCK = 512


def recursion(a: FloatArray, force: FloatArray, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """States x[0..K-1] (K, c, n) of c systems x[k+1] = A x[k] + f[k] side by side, and x[K] (c, n).

    Args:
        a: (n, n).
        force: (K, c, n).
        start: (c, n), x[0].

    States of an unstable A that overflow are inf or nan.
    """
    count, systems, order = force.shape
    if not count:
        return force, start
    block = max(1, min(math.isqrt(count), _LONGEST_BLOCK))
    blocks = -(-count // block)
    padded = np.zeros((blocks * block, systems, order))
    padded[:count] = force
    f = np.ascontiguousarray(padded.reshape(blocks, block, systems, order).swapaxes(0, 1))
    f = f.reshape(block, blocks * systems, order)
    with np.errstate(over="ignore", invalid="ignore"):
        x = _block_starts(a, f, start).reshape(-1, order)
        for i in range(block):
            f[i], x = x, x @ a.T + f[i]
        states = f.reshape(block, blocks, systems, order).swapaxes(0, 1).reshape(blocks * block, systems, order)
        return states[:count], np.asarray(states[count - 1] @ a.T + force[-1])


def _block_starts(a: FloatArray, f: FloatArray, start: FloatArray) -> FloatArray:
    """(blocks, c, n) states at which the blocks begin; f is (block, blocks c, n)."""
    end = f[0]
    for force in f[1:]:
        end = end @ a.T + force
    end = end.reshape(-1, *start.shape)
    across = np.linalg.matrix_power(a, len(f)).T
    begin = np.empty_like(end)
    begin[0] = start
    for j in range(1, len(begin)):
        begin[j] = begin[j - 1] @ across + end[j - 1]
    return np.asarray(begin)
