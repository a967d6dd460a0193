"""Where the rows of a run go: straight into columns that are kept, or into a block that is passed to a sink when full.

A block is small, so that a run whose record goes to a sink needs little memory however long it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from orchestrator.interrupts import whole
from orchestrator.rational import Clock
from orchestrator.trace import FloatArray, Trace

Sink = Callable[[Trace], None]
ROWS, VALUES = 4096, 1 << 15  # most rows and values of a block


class Recorder:
    """Takes the rows of a run.

    Args:
        names: component.variable of the columns as the loop writes them.
        chosen: the same as the trace has them.
        units: name -> unit.
        clock: time of a tick.
        every: ticks between two rows.
        count: rows of the whole run.
        sink: is given the record in pieces; without one it is kept.

    Attributes:
        rows: (b, n) memory for some rows, to be filled from the first on.
        base: number of the row that belongs into rows[0].
    """

    def __init__(
        self,
        names: Sequence[str],
        chosen: Sequence[str],
        units: dict[str, str],
        clock: Clock,
        every: int,
        count: int,
        sink: Sink | None,
    ) -> None:
        self.every, self.base = every, 0
        size = min(count, ROWS, max(1, VALUES // max(1, len(names)))) if sink else count + 1  # never full
        self._columns = _spread(len(names), size)
        self.rows = self._columns.T
        places = {name: place for place, name in enumerate(names)}
        self._places = {name: places[name] for name in chosen}
        self._units, self._clock, self._sink, self._kept = units, clock, sink, 0

    def row(self, number: int) -> FloatArray:
        """(n,) the memory of a row."""
        return self.rows[number - self.base]

    def full(self, number: int) -> bool:
        """Whether the row of this number has no place until the block is emptied."""
        return number - self.base == len(self.rows)

    def empty(self, recorded: int) -> None:
        """Pass the rows on up to this number of rows since the beginning."""
        if self._sink is None:
            self._kept = recorded
        elif recorded > self.base:
            with whole():  # interrupted in between, rows would be passed on twice
                self._sink(self._trace(self._columns[:, : recorded - self.base].copy()))  # the block is used again
                self.base = recorded

    def trace(self) -> Trace:
        """What was kept."""
        return self._trace(self._columns[:, : self._kept])

    def _trace(self, columns: FloatArray) -> Trace:
        time = self._clock.times(self.base * self.every, columns.shape[1], self.every)
        signals = {name: columns[place] for name, place in self._places.items()}
        return Trace(time, signals, self._units, "simulation")


def _spread(count: int, size: int) -> FloatArray:
    """(count, size) memory, an odd number of cache lines from row to row: were it a power of two, the values of one
    column would push each other out of the cache."""
    lines = -(-size // 8) | 1
    return np.empty((count, 8 * lines))[:, :size]
