"""Which runs are handed out next, and how many at once: as many as take a while, and fewer towards the end."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from orchestrator.batch.sweep.points.designs import PointDesign
from orchestrator.batch.sweep.runs import rows
from orchestrator.batch.sweep.runs.folder import Folder
from orchestrator.batch.sweep.runs.rows import Row
from orchestrator.batch.sweep.runs.setup import Chunk, ChunkResult, Numbers, Setup

LONG = 0.5  # that a task takes about [s]
GROWTH = 4  # of a task over the one before, at most
DEATHS = 3  # of processes at a run, after which it is a failed one


class Runner(Protocol):
    """Runs tasks somewhere."""

    def check(self) -> None:
        """See, before anything is built, that it is there.

        Raises:
            InputError: it is not.
        """

    def outcomes(self, queue: Queue, setup: Setup) -> Iterator[tuple[Chunk, ChunkResult]]:
        """What came of all tasks of the queue, as it comes; it is told what it has to know of them."""


class Queue(Iterator[Chunk]):
    """Tasks of the runs that have no row yet; runs that were lost with their process come again.

    Attributes:
        slots: tasks that are worked on at the same time; whoever runs them says.
    """

    def __init__(self, setup: Setup, design: PointDesign, folder: Folder) -> None:
        self._setup, self._design, self.slots = setup, design, 1
        self._left = folder.left
        self._parts = folder.missing()
        self._of_part: Numbers = np.zeros(0, dtype=int)
        self._again: deque[Chunk] = deque()
        self._deaths: Counter[int] = Counter()
        self._size = 1

    def __next__(self) -> Chunk:
        if self._again:
            return self._again.popleft()
        if not len(self._of_part):
            self._of_part = next(self._parts)
        share = -(-self._left // (2 * self.slots))  # so that all end together
        runs, self._of_part = np.split(self._of_part, [max(1, min(self._size, share))])
        self._left -= len(runs)
        return Chunk(runs, self._points(runs))

    def answered(self, task: Chunk, done: ChunkResult) -> None:
        """Learn from a task how many runs the next ones are to have."""
        fitting = int(LONG * len(task.runs) / max(done.seconds, 1e-6))
        self._size = max(1, min(fitting, GROWTH * max(self._size, len(task.runs))))

    def back(self, tasks: Sequence[Chunk]) -> None:
        """Put tasks back that were not done."""
        self._again.extend(tasks)

    def lost(
        self, task: Chunk, place: int | None, reason: str, final: bool = False
    ) -> Iterator[tuple[Chunk, ChunkResult]]:
        """Put a task back whose process died at the run at this place; that run with its row, where it has failed for
        good.

        Args:
            place: None where it is not known.
            final: whether it is not to be tried again.
        """
        if place is None and len(task.runs) > 1:
            middle = len(task.runs) // 2
            self._again.extend([task.part(0, middle), task.part(middle, len(task.runs))])
            return
        at = place or 0
        one, rest = task.part(at, at + 1), [task.part(0, at), task.part(at + 1, len(task.runs))]
        self._again.extend(left for left in rest if len(left.runs))
        self._deaths[int(task.runs[at])] += 1
        if not final and self._deaths[int(task.runs[at])] < DEATHS:
            self._again.append(one)
            return
        failed = [Row(rows.FAILED, reason, False, {})]
        yield one, ChunkResult(rows.packed(rows.table(self._setup, one, failed)), 1, 0.0)

    def _points(self, runs: Numbers) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        cases = len(self._setup.cases)
        first, stop = int(runs[0]) // cases, int(runs[-1]) // cases + 1
        return self._design.points(first, stop)[runs // cases - first]
