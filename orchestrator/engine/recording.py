"""Where the rows of a run go: into a block of memory while it steps, from there into columns or to a sink.

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

    def __init__(self, names: Sequence[str], chosen: Sequence[str], units: dict[str, str], clock: Clock,
                 every: int, count: int, sink: Sink | None) -> None:  # fmt: skip
        self.every, self.base = every, 0
        self.rows = np.empty((min(count, ROWS, max(1, VALUES // max(1, len(names)))), len(names)))
        self._order = None if list(names) == list(chosen) else [names.index(name) for name in chosen]
        self._chosen, self._units, self._clock, self._sink = tuple(chosen), units, clock, sink
        self._columns = np.empty((len(chosen), 0 if sink else count))

    def row(self, number: int) -> FloatArray:
        """(n,) the memory of a row."""
        return self.rows[number - self.base]

    def full(self, number: int) -> bool:
        """Whether the row of this number has no place until the block is emptied."""
        return number - self.base == len(self.rows)

    def empty(self, recorded: int) -> None:
        """Pass the rows on up to this number of rows since the beginning."""
        rows = self.rows[: recorded - self.base].T
        fresh = rows if self._order is None else rows[self._order]
        if self._sink is None:
            self._columns[:, self.base : recorded] = fresh
            self.base = recorded
        elif recorded > self.base:
            with whole():  # interrupted in between, rows would be passed on twice
                self._sink(self._trace(self.base, np.array(fresh)))  # a copy: the block is used again
                self.base = recorded

    def trace(self) -> Trace:
        """What was kept."""
        return self._trace(0, self._columns[:, : self.base])

    def _trace(self, first: int, columns: FloatArray) -> Trace:
        time = self._clock.times(first * self.every, columns.shape[1], self.every)
        return Trace(time, dict(zip(self._chosen, columns, strict=True)), self._units, "simulation")
