"""Processes that work side by side for this one and end with it: when it is done, by an interrupt, or its death.

They are forked from a server that has loaded the modules they need, once for all pools of a command.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from multiprocessing.connection import wait
from time import monotonic
from typing import Any, Generic, Self, TypeVar

from orchestrator.processes.child import PATIENCE, Child, Died, Watch, context_of
from orchestrator.processes.interrupts import whole
from orchestrator.processes.worker import CLEANING, Ready

LOG = logging.getLogger("servotwin.processes")
T = TypeVar("T")
A = TypeVar("A")

_LONG = 60.0  # without any answer [s]
_LOOK = 0.05  # between two looks at what processes do [s]


_AT_MOST: ContextVar[int | None] = ContextVar("at_most", default=None)


def processors() -> int:
    """How many processes to use: one a processor, or what `at_most` says."""
    return _AT_MOST.get() or os.cpu_count() or 1


@contextmanager
def at_most(processes: int | None) -> Iterator[None]:
    """Meanwhile so many processes are used where there would be one a processor; None changes nothing."""
    token = _AT_MOST.set(processes or _AT_MOST.get())
    try:
        yield
    finally:
        _AT_MOST.reset(token)


def calling() -> Callable[[Callable[[], Any]], Any]:
    """A worker whose tasks are functions: it calls them."""
    return _called


def _called(task: Callable[[], A]) -> A:
    return task()


class Processes(Generic[T, A]):
    """Processes that each have a worker of their own; a context manager that leaves neither them nor files behind.

    Args:
        make: called in each process; what it gives answers tasks, and is closed in the end where it has a `close`.
        count: how many work at the same time.
        modules: what they need, to be loaded ahead.
        spent: whether a process that has given this answer takes no more tasks, of which another one then begins
            when there is one for it; None has all of them go on.
        patience: how long an answer may take before its process is killed [s]; None waits for ever.
        silence: what is logged once where it waits for ever, and nothing has come for a minute.
        watch: asked all the time about those that work.
    """

    def __init__(
        self,
        make: Callable[[], Callable[[T], A]],
        count: int,
        modules: Sequence[str] = (),
        *,
        spent: Callable[[A], bool] | None = None,
        patience: float | None = None,
        silence: str = "",
        watch: Watch | None = None,
    ) -> None:
        self._make, self._count, self._spent, self._patience = make, count, spent, patience
        self._silence, self._watch = silence, watch
        self._context = context_of(modules)
        self._processes: list[Child] = []

    @property
    def pids(self) -> list[int | None]:
        """Process ids of those alive now."""
        return [process.pid for process in self._processes if process.alive]

    def answers(self, tasks: Iterable[T]) -> Iterator[tuple[int, A | Died]]:
        """(number of the task, its answer), as they come; tasks are taken when a process is free for them.

        Raises:
            Exception: what `make` or a worker raised; as a note it has where.
        """
        waiting = enumerate(tasks)
        busy: dict[Child, int] = {}
        while True:
            while len(busy) < self._count and (following := next(waiting, None)):
                process = next((idle for idle in self._processes if idle not in busy), None) or self._start()
                busy[process], task = following
                process.send(task)
            if not busy:
                return
            if self._silence and not wait([process.connection for process in busy], _LONG):
                LOG.warning("%s", self._silence)
                self._silence = ""
            for process in _speaking(busy, self._patience, self._watch):
                answer = process.answer()
                if answer is Ready:
                    continue
                if isinstance(answer, Died) or (self._spent is not None and self._spent(answer)):
                    process.dismiss()
                    process.stop(PATIENCE)
                    self._processes.remove(process)
                    if self._spent is None:
                        self._start()
                yield busy.pop(process), answer

    def _start(self) -> Child:
        with whole():  # one that is not in the list would be left
            self._processes.append(Child(self._context, self._make))
        return self._processes[-1]

    def __enter__(self) -> Self:
        try:
            while self._spent is None and len(self._processes) < self._count:
                self._start()
        except BaseException:
            self._stop(patience=0.0)
            raise
        return self

    def __exit__(self, kind: type | None, *_: object) -> None:
        self._stop(PATIENCE if kind is None else 0.0)

    def _stop(self, patience: float) -> None:
        for process in self._processes:
            process.dismiss()
            if not patience:
                process.interrupt()
        end = monotonic() + patience + min(CLEANING, self._patience or CLEANING)  # one that hangs never cleans up
        for process in self._processes:
            process.stop(patience, max(0.0, end - monotonic()))
        self._processes = []


def _speaking(busy: Mapping[Child, int], patience: float | None, watch: Watch | None) -> list[Child]:
    """Those with an answer or an end to read, at least one; those that are silent for too long get an end."""
    known = {process.connection: process for process in busy}
    while True:
        left = None if patience is None else max(0.0, min(process.left(patience) for process in known.values()))
        if watch is not None:
            left = _LOOK if left is None else min(left, _LOOK)
        if speaking := wait(list(known), left):
            return [process for connection, process in known.items() if connection in speaking]
        for process in known.values():
            if watch is not None:
                process.look_after(watch, busy[process])
            if patience is not None and process.left(patience) <= 0:
                process.give_up()
