"""Simulating many windows, here or in processes that each have a simulator of their own.

Failures come back as values; a worker that dies costs one simulation, is named and replaced.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Protocol, Self

from fmus.errors import FmuError, IdentificationError
from orchestrator.processes import Died, Processes
from orchestrator.trace import FloatArray

MAX_RESTARTS = 10


class Simulator(Protocol):
    """Runs windows of the traces; holds handles, belongs to one process, is used again and again."""

    def simulate(self, window: int, values: Mapping[str, float]) -> FloatArray:
        """(K, m) outputs of a window at its measured instants; depends on nothing but the arguments.

        Raises:
            FmuError: the run failed.
        """

    def close(self) -> None:
        """Free everything."""


Factory = Callable[[], Simulator]


@dataclass(frozen=True)
class Task:
    """One simulation: which window, and name -> value of all parameters and its initial states."""

    window: int
    values: Mapping[str, float]


Simulated = FloatArray | FmuError


class Pool(Protocol):
    """Something that simulates many tasks; a context manager that leaves nothing behind."""

    def run(self, tasks: Sequence[Task]) -> list[Simulated]:
        """The outcome of every task, in their order."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def open_pool(factory: Factory, processes: int) -> Pool:
    """A pool of that many processes; with 1 everything runs in this one and nothing is pickled.

    Raises:
        IdentificationError: fewer than one process.
    """
    if processes < 1:
        raise IdentificationError("processes", f"{processes} is too few", "use 1 or more")
    return LocalPool(factory) if processes == 1 else ProcessPool(factory, processes)


class LocalPool:
    """Simulates in this process: no start-up, no protection from a simulator that crashes."""

    def __init__(self, factory: Factory) -> None:
        self._simulator = factory()

    def run(self, tasks: Sequence[Task]) -> list[Simulated]:
        """The outcome of every task, in their order."""
        return [_simulated(self._simulator, task) for task in tasks]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._simulator.close()


class ProcessPool:
    """Simulates in `processes` processes, which live until the pool is left.

    A process that dies while it simulates (a crash in native code) makes that outcome an FmuError naming the
    window and is replaced, at most `MAX_RESTARTS` times in the pool's life.
    """

    def __init__(self, factory: Factory, processes: int) -> None:
        self._processes: Processes[Task, Simulated] = Processes(
            partial(_Simulating, factory), processes, [type(factory).__module__]
        )
        self.restarts = 0

    def __enter__(self) -> Self:
        self._processes.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._processes.__exit__(kind, error, trace)

    @property
    def pids(self) -> list[int | None]:
        """Process ids of the workers alive now."""
        return self._processes.pids

    def run(self, tasks: Sequence[Task]) -> list[Simulated]:
        """The outcome of every task, in their order.

        Raises:
            FmuError: workers kept dying.
            Exception: what the factory, or the simulator beside FmuError, raised in a worker.
        """
        outcomes: dict[int, Simulated] = {}
        for number, answer in self._processes.answers(tasks):
            outcomes[number] = self._crash(tasks[number], answer) if isinstance(answer, Died) else answer
        return [outcomes[number] for number in range(len(tasks))]

    def _crash(self, task: Task, died: Died) -> FmuError:
        place, problem = f"window {task.window}", f"the simulating process died ({died.ending})"
        if self.restarts >= MAX_RESTARTS:
            raise FmuError(place, f"{problem}, after {self.restarts} others", "look for a crash in the FMUs")
        self.restarts += 1
        return FmuError(place, problem, "look for a crash in the FMUs")


class _Simulating:
    """A simulator in a process of its own."""

    def __init__(self, factory: Factory) -> None:
        self._simulator = factory()

    def __call__(self, task: Task) -> Simulated:
        return _simulated(self._simulator, task)

    def close(self) -> None:
        self._simulator.close()


def _simulated(simulator: Simulator, task: Task) -> Simulated:
    try:
        return simulator.simulate(task.window, task.values)
    except FmuError as error:
        return error
