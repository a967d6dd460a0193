"""Persistent worker processes that simulate windows, each with a simulator of its own.

Failures come back as values; a worker that dies costs one simulation, is named and replaced.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
import shutil
import signal
import tempfile
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Protocol, Self

from fmus.errors import FmuError, IdentificationError
from orchestrator.trace import FloatArray

MAX_RESTARTS = 10
_PATIENCE = 5.0


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


Outcome = FloatArray | FmuError


class Pool(Protocol):
    """Something that simulates many tasks; a context manager that leaves nothing behind."""

    def run(self, tasks: Sequence[Task]) -> list[Outcome]:
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

    def run(self, tasks: Sequence[Task]) -> list[Outcome]:
        """The outcome of every task, in their order."""
        return [_simulated(self._simulator, task) for task in tasks]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._simulator.close()


class ProcessPool:
    """Simulates in `processes` spawned processes, which live until the pool is left.

    A process that dies while it simulates (a crash in native code) makes that outcome an FmuError naming the
    window and is replaced, at most `MAX_RESTARTS` times in the pool's life. Temporary files of the processes go with
    the pool, however they ended.
    """

    def __init__(self, factory: Factory, processes: int) -> None:
        self._factory, self._processes = factory, processes
        self._workers: list[_Worker] = []
        self._folder = ""
        self.restarts = 0

    def __enter__(self) -> Self:
        try:
            self._folder = tempfile.mkdtemp(prefix="servotwin-")
            self._workers = [_Worker(self._factory, self._folder) for _ in range(self._processes)]
        except BaseException:
            self._stop(patience=0.0)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop(_PATIENCE if kind is None else 0.0)

    @property
    def pids(self) -> list[int | None]:
        """Process ids of the workers alive now."""
        return [worker.process.pid for worker in self._workers if worker.process.is_alive()]

    def run(self, tasks: Sequence[Task]) -> list[Outcome]:
        """The outcome of every task, in their order.

        Raises:
            FmuError: workers kept dying.
            Exception: what the factory, or the simulator beside FmuError, raised in a worker.
        """
        waiting, outcomes = deque(enumerate(tasks)), dict[int, Outcome]()
        busy: dict[_Worker, int] = {}
        while len(outcomes) < len(tasks):
            for worker in self._workers:
                if waiting and worker not in busy:
                    busy[worker], task = waiting.popleft()
                    worker.send(task)
            for worker in _ready(list(busy)):
                number = busy.pop(worker)
                outcomes[number] = self._received(worker, tasks[number])
        return [outcomes[number] for number in range(len(tasks))]

    def _received(self, worker: _Worker, task: Task) -> Outcome:
        try:
            answer = worker.connection.recv()
        except (EOFError, OSError):
            return self._replaced(worker, task)
        if isinstance(answer, _Raised):
            answer.error.add_note(answer.trace)
            raise answer.error
        return answer

    def _replaced(self, worker: _Worker, task: Task) -> FmuError:
        worker.stop(_PATIENCE)
        place, problem = f"window {task.window}", f"the simulating process died ({worker.ending})"
        if self.restarts >= MAX_RESTARTS:
            raise FmuError(place, f"{problem}, after {self.restarts} others", "look for a crash in the FMUs")
        self.restarts += 1
        self._workers[self._workers.index(worker)] = _Worker(self._factory, self._folder)
        return FmuError(place, problem, "look for a crash in the FMUs")

    def _stop(self, patience: float) -> None:
        for worker in self._workers:
            worker.dismiss()
        for worker in self._workers:
            worker.stop(patience)
        self._workers = []
        shutil.rmtree(self._folder, ignore_errors=True)


class _Worker:
    """One spawned process and the connection to it."""

    def __init__(self, factory: Factory, folder: str) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process: BaseProcess = context.Process(target=_serve, args=(theirs, factory, folder), daemon=True)
        with _uninterrupted():
            self.process.start()
        theirs.close()

    def send(self, task: Task) -> None:
        """Hand over a task; a worker that is gone is noticed when its answer is read."""
        with contextlib.suppress(OSError):
            self.connection.send(task)

    def dismiss(self) -> None:
        """Ask the process to free its simulator and end."""
        with contextlib.suppress(OSError):
            self.connection.send(None)

    def stop(self, patience: float) -> None:
        """End the process: after `patience` [s] by force."""
        self.process.join(patience)
        for end in (self.process.terminate, self.process.kill):
            if self.process.is_alive():
                end()
                self.process.join(_PATIENCE)
        self.connection.close()

    @property
    def ending(self) -> str:
        code = self.process.exitcode
        return signal.Signals(-code).name if code is not None and code < 0 else f"exit code {code}"


@dataclass(frozen=True)
class _Raised:
    """An error that is no failed run, on its way from a worker."""

    error: BaseException
    trace: str


def _ready(workers: list[_Worker]) -> list[_Worker]:
    """The busy workers with an answer or an end to read, at least one."""
    speaking = set(wait([worker.connection for worker in workers]))
    return [worker for worker in workers if worker.connection in speaking]


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """SIGINT waits, and a process started here never sees it: a terminal sends it to both, and only we shall answer."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # it would unblock the signal when it is started along with the first process
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(connection: Connection, factory: Factory, folder: str) -> None:
    """A worker's life: one simulator, tasks until None or until the other side is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    tempfile.tempdir = folder
    try:
        simulator = factory()
    except Exception as error:
        _complain(connection, error)
        return
    with contextlib.suppress(EOFError, OSError), contextlib.closing(simulator):
        while (task := connection.recv()) is not None:
            try:
                connection.send(_simulated(simulator, task))
            except Exception as error:
                _complain(connection, error)


def _complain(connection: Connection, error: Exception) -> None:
    trace = traceback.format_exc()
    try:
        pickle.loads(pickle.dumps(error))
        connection.send(_Raised(error, trace))
    except Exception:
        connection.send(_Raised(RuntimeError(f"{type(error).__name__}: {error}"), trace))


def _simulated(simulator: Simulator, task: Task) -> Outcome:
    try:
        return simulator.simulate(task.window, task.values)
    except FmuError as error:
        return error
