"""Values in memory that two processes share: one writes, one reads, and neither waits."""

from __future__ import annotations

import mmap

import numpy as np

from orchestrator.trace import FloatArray

_TRIES = 1000  # to read values that are not just being written


class Board:
    """(width,) values and flags."""

    def __init__(self, width: int) -> None:
        memory = mmap.mmap(-1, 8 * (2 + width))
        self._head = np.frombuffer(memory, np.int64, 2)  # number of writings, odd while there is one; flags
        self._values = np.frombuffer(memory, np.float64, width, 16)
        self._latest = self._values.copy()

    @property
    def flags(self) -> int:
        """Those that were written last."""
        return int(self._head[1])

    @property
    def writings(self) -> int:
        """A number that grows while the writer lives."""
        return int(self._head[0])

    def write(self, values: FloatArray, flags: int) -> None:
        """(width,) values and flags in place of those before."""
        self._head[0] += 1
        self._values[:] = values
        self._head[1] = flags
        self._head[0] += 1

    def read(self) -> FloatArray:
        """(width,) values as they were at one time; the last ones where the writer died while it wrote."""
        for _ in range(_TRIES):
            number = self._head[0]
            values = self._values.copy()
            if number % 2 == 0 and self._head[0] == number:
                self._latest = values
                break
        return self._latest
