"""Where the rows of a run go: straight into columns that are kept, or into a block that is passed to a sink when full.

A block is small, so that a run whose record goes to a sink needs little memory however long it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from orchestrator.processes.interrupts import whole
from orchestrator.processes.memory import PLENTY, require
from orchestrator.rational import TickTimes
from orchestrator.trace import FloatArray, Trace

Sink = Callable[[Trace], None]
ROWS, VALUES = 4096, 1 << 15  # most rows and values of a block


class RecordColumns:
    """What is recorded.

    Args:
        names: component.variable of the columns as the loop writes them.
        chosen: the same as the trace has them.
        texts: of those that hold text, the texts that their numbers stand for by now.

    Attributes:
        places: name -> column, in the trace's order.
        units: name -> unit.
    """

    def __init__(
        self,
        names: Sequence[str],
        chosen: Sequence[str],
        units: Mapping[str, str],
        texts: Callable[[], Mapping[str, tuple[str, ...]]] = dict,
    ) -> None:
        self.texts = texts
        columns = {name: column for column, name in enumerate(names)}
        self.places = {name: columns[name] for name in chosen}
        self.units = units
        self.order = list(self.places.values())
        self.in_order = self.order == sorted(self.order)


class Recorder:
    """Takes the rows of a run.

    Args:
        clock: time of a tick.
        every: ticks between two rows.
        count: rows of the whole run.
        sink: is given the record in pieces; without one it is kept.

    Attributes:
        rows: (b, n) memory for some rows, to be filled from the first on.
        base: number of the row that belongs into rows[0].
    """

    def __init__(self, columns: RecordColumns, clock: TickTimes, every: int, count: int, sink: Sink | None) -> None:
        self.every, self.base = every, 0
        width = len(columns.places)
        size = min(count, ROWS, max(1, VALUES // max(1, width))) if sink else count + 1  # never full
        self._memory = _spread(width, size)
        self.rows = self._memory.T
        self._columns, self._clock, self._sink, self._kept = columns, clock, sink, 0

    def row(self, number: int) -> FloatArray:
        """(n,) the memory of a row."""
        row: FloatArray = self.rows[number - self.base]
        return row

    def full(self, number: int) -> bool:
        """Whether the row of this number has no place until the block is emptied."""
        return number - self.base == len(self.rows)

    def empty(self, recorded: int) -> None:
        """Pass the rows on up to this number of rows since the beginning."""
        if self._sink is None:
            self._kept = recorded
        elif recorded > self.base:
            with whole():  # interrupted in between, rows would be passed on twice
                self._sink(self._trace(self._memory[:, : recorded - self.base]))  # a trace copies what is used again
                self.base = recorded

    def trace(self) -> Trace:
        """What was kept, where it was written; no row can be written from now on."""
        owner = self._memory.base
        assert owner is not None
        owner.flags.writeable = self._memory.flags.writeable = False
        return self._trace(self._memory[:, : self._kept])

    def kept(self) -> FloatArray:
        """(K, n) the same as a matrix."""
        return self.rows[: self._kept] if self._columns.in_order else self.rows[: self._kept, self._columns.order]

    def _trace(self, memory: FloatArray) -> Trace:
        time = self._clock.times(self.base * self.every, memory.shape[1], self.every)
        signals = {name: memory[place] for name, place in self._columns.places.items()}
        return Trace(time, signals, self._columns.units, "simulation", self._columns.texts())


def require_room(rows: int, columns: int) -> None:
    """See that so many numbers find room in the computer's memory.

    Raises:
        InputError: they do not.
    """
    size = 8 * rows * max(columns, 1)
    if size > PLENTY:
        fix = "lengthen its `step`, keep fewer rows with --stride, or write them while running with --stream"
        require("run", f"{rows:,} rows of {columns} values to keep", size, fix)


def _spread(count: int, size: int) -> FloatArray:
    """(count, size) memory, an odd number of cache lines from row to row: were it a power of two, the values of one
    column would push each other out of the cache."""
    lines = -(-size // 8) | 1
    return np.empty((count, 8 * lines))[:, :size]
