"""Runs in processes of this machine; an FMU that crashes or hangs costs its run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial

from orchestrator.batch.limits import CaseLimits
from orchestrator.batch.sweep.runs.queue import Queue
from orchestrator.batch.sweep.runs.setup import Chunk, ChunkResult, Setup
from orchestrator.batch.sweep.runs.worker import Worker
from orchestrator.processes.child import Died
from orchestrator.processes.last_words import LastWords
from orchestrator.processes.pool import Processes, processors

AHEAD = ["orchestrator.batch.ahead", "orchestrator.batch.sweep.runs.worker"]
FIX = "narrow what varies, or mend the FMU"


@dataclass(frozen=True)
class Local:
    """Processes of this machine.

    Attributes:
        slots: how many.
        limits: what a run may take before its process is killed.
    """

    slots: int = field(default_factory=processors)
    limits: CaseLimits | None = None

    def check(self) -> None:
        """It is always there."""

    def outcomes(self, queue: Queue, setup: Setup) -> Iterator[tuple[Chunk, ChunkResult]]:
        """See `Runner`.

        Raises:
            ServotwinError: a process cannot open the systems.
        """
        queue.slots = self.slots
        handed, watch = _Handed(queue), self._watched if self.limits else None
        with Processes[Chunk, ChunkResult](partial(Worker, setup), self.slots, AHEAD, watch=watch) as pool:
            for number, answer in pool.answers(handed):
                task = handed.tasks.pop(number)
                if isinstance(answer, Died):
                    yield from queue.lost(task, answer.part, _reason(answer), answer.ended_by_us)
                else:
                    queue.answered(task, answer)
                    yield task, answer

    def _watched(self, number: int, pid: int, words: LastWords, begun: float) -> str:
        assert self.limits is not None
        return self.limits.exceeded(pid, words, begun)


class _Handed(Iterator[Chunk]):
    """Tasks on their way to a process, by the number in which they went."""

    def __init__(self, queue: Queue) -> None:
        self._queue, self._count = queue, 0
        self.tasks: dict[int, Chunk] = {}

    def __next__(self) -> Chunk:
        task = next(self._queue)
        self.tasks[self._count] = task
        self._count += 1
        return task


def _reason(died: Died) -> str:
    if died.ended_by_us:
        return died.ending
    return f"{died.fmus or 'an FMU'} crashed the process that ran it, which {died.ending}; {FIX}"
