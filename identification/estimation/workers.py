"""Simulating many windows, here or in processes that each have a simulator of their own.

Failures come back as values; a worker that dies costs one simulation, is named and replaced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Protocol, Self, runtime_checkable

from fmus.errors import FmuError, IdentificationError, TangentsMissing, WiringError
from orchestrator.fmi.isolation import Isolation
from orchestrator.fmi.said import kept, kept_in
from orchestrator.processes.child import Died
from orchestrator.processes.pool import Processes
from orchestrator.trace import FloatArray

MAX_RESTARTS = 50


class Simulator(Protocol):
    """Runs windows of the traces; holds handles, belongs to one process, is used again and again."""

    def simulate(self, window: int, values: Mapping[str, float]) -> FloatArray:
        """(K, m) outputs of a window at its measured instants; depends on nothing but the arguments.

        Raises:
            FmuError: the run failed.
        """

    def close(self) -> None:
        """Free everything."""


@runtime_checkable
class Differentiable(Protocol):
    """A simulator that also knows exact derivatives."""

    def sensitivities(self, window: int, values: Mapping[str, float], by: Sequence[str]) -> FloatArray:
        """(K, m, 1 + d) outputs, and behind them their derivatives by d of the values.

        Raises:
            TangentsMissing: they are not to be had.
            FmuError: the run failed, or a derivative is not finite.
        """


Factory = Callable[[], Simulator]


@dataclass(frozen=True)
class SimulationTask:
    """One simulation.

    Attributes:
        values: name -> value of all parameters and of the window's initial states.
        group: of simulations that are worthless once one of them has failed; None where it stands for itself.
        by: names of the values whose derivatives are wanted beside the outputs.
    """

    window: int
    values: Mapping[str, float]
    group: int | None = None
    by: tuple[str, ...] = ()


Simulated = FloatArray | FmuError


class Pool(Protocol):
    """Something that simulates many tasks; a context manager that leaves nothing behind."""

    def run(self, tasks: Sequence[SimulationTask]) -> list[Simulated | None]:
        """The outcome of every task, in their order; None for those not begun, as one of their group had failed."""

    def __enter__(self) -> Self: ...

    def __exit__(self, kind: type | None, /, *_: object) -> None: ...


def open_pool(factory: Factory, processes: int, isolation: Isolation | None = None) -> Pool:
    """A pool of that many processes; with 1 everything runs in this one and nothing is pickled.

    Args:
        isolation: how long a simulation may take; all of them run in other processes then.

    Raises:
        IdentificationError: fewer than one process.
    """
    if processes < 1:
        raise IdentificationError("processes", f"{processes} is too few", "use 1 or more")
    if processes == 1 and isolation is None:
        return LocalPool(factory)
    return ProcessPool(factory, processes, isolation)


class LocalPool:
    """Simulates in this process: no start-up, no protection from a simulator that crashes."""

    def __init__(self, factory: Factory) -> None:
        self._simulator = factory()

    def run(self, tasks: Sequence[SimulationTask]) -> list[Simulated | None]:
        """See `Pool`."""
        wanted = _Wanted(tasks)
        return wanted.outcomes((number, _simulated(self._simulator, task)) for number, task in enumerate(wanted))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._simulator.close()


class ProcessPool:
    """Simulates in `processes` processes, which live until the pool is left.

    A process that dies while it simulates (a crash in native code) or takes longer than the isolation's patience (a
    hang) makes that outcome an FmuError naming the window and is replaced, at most `MAX_RESTARTS` times in the
    pool's life.
    """

    def __init__(self, factory: Factory, processes: int, isolation: Isolation | None = None) -> None:
        self._processes: Processes[SimulationTask, Simulated] = Processes(
            partial(_Simulating, factory, kept_in()),
            processes,
            [type(factory).__module__],
            patience=isolation.patience if isolation else None,
            silence=""
            if isolation
            else "no simulation has come back for 60 s; --isolate counts one that hangs as failed",
        )
        self.restarts = 0

    def __enter__(self) -> Self:
        self._processes.__enter__()
        return self

    def __exit__(self, kind: type | None, *_: object) -> None:
        self._processes.__exit__(kind)

    @property
    def pids(self) -> list[int | None]:
        """Process ids of the workers alive now."""
        return self._processes.pids

    def run(self, tasks: Sequence[SimulationTask]) -> list[Simulated | None]:
        """See `Pool`.

        Raises:
            FmuError: workers kept dying.
            Exception: what the factory, or the simulator beside FmuError, raised in a worker.
        """
        wanted = _Wanted(tasks)
        return wanted.outcomes(
            (place, self._lost(wanted.task(place), answer) if isinstance(answer, Died) else answer)
            for place, answer in self._processes.answers(wanted)
        )

    def _lost(self, task: SimulationTask, died: Died) -> FmuError:
        place, problem = (
            f"window {task.window}",
            f"the simulating process {died.ending}{f', {died.fmus}' if died.fmus else ''}",
        )
        if self.restarts >= MAX_RESTARTS:
            raise FmuError(
                place, f"{problem}, after {self.restarts} others were lost", "mend the FMUs, or narrow `min` and `max`"
            )
        self.restarts += 1
        return FmuError(place, problem, "an FMU crashes or hangs with these values")


class _Wanted:
    """Tasks that are handed out one by one, but for those of a group in which one has failed."""

    def __init__(self, tasks: Sequence[SimulationTask]) -> None:
        self._tasks, self._failed = tasks, set[int]()
        self._numbers: list[int] = []  # of those that were handed out

    def __iter__(self) -> Iterator[SimulationTask]:
        for number, task in enumerate(self._tasks):
            if task.group not in self._failed:
                self._numbers.append(number)
                yield task

    def task(self, place: int) -> SimulationTask:
        """The one that was handed out so many others after the first."""
        return self._tasks[self._numbers[place]]

    def outcomes(self, answers: Iterable[tuple[int, Simulated]]) -> list[Simulated | None]:
        """The answers in the order of the tasks; None for those that were not handed out."""
        outcomes: list[Simulated | None] = [None] * len(self._tasks)
        for place, outcome in answers:
            number = self._numbers[place]
            outcomes[number] = outcome
            group = self._tasks[number].group
            if group is not None and isinstance(outcome, FmuError):
                self._failed.add(group)
        return outcomes


class _Simulating:
    """A simulator in a process of its own; what its FMUs say goes into the file, if any, to be told by the main one."""

    def __init__(self, factory: Factory, log: Path | None) -> None:
        self._stack = ExitStack()
        self._stack.enter_context(kept(log, shown=False))
        self._simulator = factory()
        self._stack.callback(self._simulator.close)

    def __call__(self, task: SimulationTask) -> Simulated:
        return _simulated(self._simulator, task)

    def close(self) -> None:
        self._stack.close()


def _simulated(simulator: Simulator, task: SimulationTask) -> Simulated:
    try:
        if not task.by:
            return simulator.simulate(task.window, task.values)
        if isinstance(simulator, Differentiable):
            return simulator.sensitivities(task.window, task.values, task.by)
        return TangentsMissing("simulator", "knows no derivatives")
    except FmuError as error:
        return error
    except WiringError as error:  # a trial outside the bounds that an FMU declares
        return FmuError(error.place, error.problem)
