"""Processes that work side by side for this one and end with it: when it is done, by an interrupt, or its death.

They are forked from a server that has loaded the modules they need, once for all pools of a command.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import pickle
import shutil
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from multiprocessing import parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import BaseContext
from multiprocessing.util import Finalize, get_temp_dir
from pathlib import Path
from time import monotonic, sleep
from types import ModuleType, TracebackType
from typing import Any, Generic, Self, TypeVar

from fmus.errors import InputError
from orchestrator import last_words
from orchestrator.interrupts import Interrupts, whole
from orchestrator.last_words import LastWords, culprits

LOG = logging.getLogger("servotwin.processes")
T = TypeVar("T")
A = TypeVar("A")

_PATIENCE = 5.0  # with a process that is to end by itself [s]
_LONGEST = 70  # of a temporary folder's path; a socket's has some 35 bytes more, and 104 at most
_WORDS = "last words"  # file in the folder of a process
_CLEANING = 15.0  # with one that was interrupted and cleans up [s]
_LONG = 60.0  # without any answer [s]
_LOOK = 0.05  # between two looks at what processes do [s]
_STARTING = 120.0  # with one that has still to make its worker [s]


def processors() -> int:
    """How many processes to use: one a processor."""
    return os.cpu_count() or 1


@dataclass(frozen=True)
class Died:
    """What is there instead of an answer: the process that worked on the task died, or was killed.

    Attributes:
        ending: how, in words: "died (SIGSEGV)", "died (exit code 1)", "gave no answer for 60 s".
        seconds: wall time since it was given the task [s].
        fmus: those that it had loaded, in words; empty where there were none.
        part, part_seconds: the part of its work that it was at, where it has said so, and for how long [s].
        ended_by_us: whether it was killed for what it did, or did not.
    """

    ending: str
    seconds: float
    fmus: str = ""
    part: int | None = None
    part_seconds: float = 0.0
    ended_by_us: bool = False


Watch = Callable[[int, int, LastWords, float], str]
"""Why a process is to be killed, "" where it may go on: given the number of its task, its id, what it says, and since
when it has the task, by the monotonic clock [s]."""


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
        fresh: whether each task gets a process of its own.
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
        fresh: bool = False,
        patience: float | None = None,
        silence: str = "",
        watch: Watch | None = None,
    ) -> None:
        self._make, self._count, self._fresh, self._patience = make, count, fresh, patience
        self._silence, self._watch = silence, watch
        self._context = _context(modules)
        self._processes: list[_Child] = []

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
        busy: dict[_Child, int] = {}
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
                if answer is _Ready:
                    continue
                if self._fresh or isinstance(answer, Died):
                    process.dismiss()
                    process.stop(_PATIENCE)
                    self._processes.remove(process)
                    if not self._fresh:
                        self._start()
                yield busy.pop(process), answer

    def _start(self) -> _Child:
        with whole():  # one that is not in the list would be left
            self._processes.append(_Child(self._context, self._make))
        return self._processes[-1]

    def __enter__(self) -> Self:
        try:
            while not self._fresh and len(self._processes) < self._count:
                self._start()
        except BaseException:
            self._stop(patience=0.0)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop(_PATIENCE if kind is None else 0.0)

    def _stop(self, patience: float) -> None:
        for process in self._processes:
            process.dismiss()
            if not patience:
                process.interrupt()
        end = monotonic() + patience + min(_CLEANING, self._patience or _CLEANING)  # one that hangs never cleans up
        for process in self._processes:
            process.stop(patience, max(0.0, end - monotonic()))
        self._processes = []


class _Child:
    """One process, the connection to it, and the folder for its temporary files."""

    def __init__(self, context: BaseContext, make: Callable[[], Callable[[Any], Any]]) -> None:
        self._folder = tempfile.mkdtemp(prefix="servotwin-")
        self.connection, theirs = context.Pipe()
        self._process: Any = context.Process(  # type: ignore[attr-defined]
            target=_serve, args=(theirs, _life()[0], make, self._folder, _litter(), dict(os.environ)), daemon=False
        )
        self._begun, self._ready, self._silent = 0.0, False, ""
        self._words: LastWords | None = None
        try:
            with _uninterrupted(), _without_main(make):
                self._process.start()
        except BaseException:
            if self.pid is not None:
                self.interrupt()
                self.stop(patience=0.0)
            shutil.rmtree(self._folder, ignore_errors=True)
            raise
        theirs.close()

    @property
    def pid(self) -> int | None:
        pid: int | None = self._process.pid
        return pid

    @property
    def alive(self) -> bool:
        return bool(self._process.is_alive())

    def send(self, task: Any) -> None:
        """Hand over a task; a process that is gone is noticed when its answer is read."""
        self._begun = monotonic()
        with contextlib.suppress(OSError):
            self.connection.send(task)

    def answer(self) -> Any:
        """The answer to the task."""
        try:
            answer = self.connection.recv()
        except (EOFError, OSError):
            words = LastWords(Path(self._folder, _WORDS))
            fmus, part = culprits(words), words.part
            self.stop(_PATIENCE)
            code = self._process.exitcode
            ending = signal.Signals(-code).name if code is not None and code < 0 else f"exit code {code}"
            seconds = monotonic() - self._begun
            at_part = monotonic() - (words.part_since or self._begun)
            return Died(self._silent or f"died ({ending})", seconds, fmus, part, at_part, bool(self._silent))
        if answer is _Ready:
            self._begun, self._ready = monotonic(), True
        if isinstance(answer, _Raised):
            answer.error.add_note(answer.trace)
            raise answer.error
        return answer

    def left(self, patience: float) -> float:
        """How long its answer may still take [s]."""
        return self._begun + (patience if self._ready else _STARTING) - monotonic()

    def give_up(self, reason: str = "") -> None:
        """Kill it: it owes an answer, and may be where nothing else ends it."""
        self._silent = reason or f"gave no answer for {monotonic() - self._begun:.3g} s"
        self._process.kill()

    def look_after(self, watch: Watch, task: int) -> None:
        """Kill it where `watch` has a reason."""
        if self._ready and self.pid is not None and not self._silent:
            self._words = self._words or LastWords(Path(self._folder, _WORDS))
            if reason := watch(task, self.pid, self._words, self._begun):
                self.give_up(reason)

    def dismiss(self) -> None:
        """Ask it to close its worker and end."""
        with contextlib.suppress(OSError):
            self.connection.send(None)

    def interrupt(self) -> None:
        """Ask it to end at once; it cleans up."""
        if self.alive:
            self._process.terminate()

    def stop(self, patience: float, cleaning: float = _CLEANING) -> None:
        """See that it ends: after `patience` [s] it is interrupted, and killed where that does not help [s]."""
        if patience:
            self._process.join(patience)
            self.interrupt()
        self._process.join(cleaning)
        if self.alive:
            self._process.kill()
            self._process.join()
        self.connection.close()
        shutil.rmtree(self._folder, ignore_errors=True)


class _Ready:
    """What a process says when its worker is made."""


@dataclass(frozen=True)
class _Raised:
    """An error on its way from a process."""

    error: BaseException
    trace: str


@cache
def _life() -> tuple[Connection, Connection]:
    """A pipe that this process closes by its end only, however that comes."""
    return multiprocessing.Pipe(duplex=False)


def _litter() -> str:
    """Folder with the server's socket, which nobody would remove if this process were killed; nothing below it."""
    return get_temp_dir() if parent_process() is None else ""


def _shorten_folder() -> None:
    """Have the server's socket in /tmp where the path of the usual folder is too long for a socket's."""
    usual = tempfile.tempdir
    if len(os.fsencode(tempfile.gettempdir())) > _LONGEST and Path("/tmp").is_dir():
        tempfile.tempdir = "/tmp"
        get_temp_dir()
        tempfile.tempdir = usual


def _context(modules: Sequence[str]) -> BaseContext:
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    _shorten_folder()
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["__main__", *modules])  # nothing where the server runs already
    return context


def _speaking(busy: Mapping[_Child, int], patience: float | None, watch: Watch | None) -> list[_Child]:
    """Those with an answer or an end to read, at least one; those that are silent for too long get an end."""
    known = {process.connection: process for process in busy}
    while True:
        left = None if patience is None else max(0.0, min(process.left(patience) for process in known.values()))
        if watch is not None:
            left = _LOOK if left is None else min(left, _LOOK)
        if speaking := wait(list(known), left):
            return [known[connection] for connection in speaking if isinstance(connection, Connection)]
        for process in known.values():
            if watch is not None:
                process.look_after(watch, busy[process])
            if patience is not None and process.left(patience) <= 0:
                process.give_up()


@contextlib.contextmanager
def _without_main(make: Callable[[], Any]) -> Iterator[None]:
    """A process started here does not run the main script again, unless it makes what is defined there.

    A script that does not keep its work under `if __name__ == "__main__"` would start processes without end.

    Raises:
        InputError: it makes what is defined in a script that does not, or in a notebook.
    """
    main = sys.modules["__main__"]
    if b"__main__" not in pickle.dumps(make):
        sys.modules["__main__"] = ModuleType("__main__")
    elif not _guarded(main):
        raise InputError(
            getattr(main, "__file__", "__main__"),
            "defines what other processes need, but they cannot run it again",
            'keep its work under `if __name__ == "__main__":`, or move what it defines into a module, or use 1 process',
        )
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _guarded(main: ModuleType) -> bool:
    """Whether another process can run the main script for what it defines, and nothing more happens."""
    file = Path(getattr(main, "__file__", None) or "")
    return file.is_file() and "__name__" in file.read_text(encoding="utf-8", errors="replace")


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """A process started here never sees SIGINT: a terminal sends it to all, and only we shall answer."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # it would unblock the signal when it is started along with the first process
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(
    connection: Connection,
    life: Connection,
    make: Callable[[], Any],
    folder: str,
    litter: str,
    environment: Mapping[str, str],
) -> None:
    """The life of a process: one worker, tasks until None or until the other side is gone.

    The main process interrupts it by SIGTERM, and so does its end; what a terminal sends is for that to answer.
    """
    for number in (signal.SIGINT, getattr(signal, "SIGHUP", signal.SIGINT)):
        signal.signal(number, signal.SIG_IGN)
    tempfile.tempdir = folder
    Finalize(None, shutil.rmtree, (folder, True), exitpriority=1)  # where the main process is killed, nobody else does
    os.environ.clear()
    os.environ.update(environment)
    interrupts = Interrupts(signal.SIGTERM)
    try:
        interrupts.__enter__()  # to the end of this process
        last_words.begin(LastWords(Path(folder, _WORDS)))
        if hasattr(signal, "pthread_sigmask"):  # for those that are started from here
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
            threading.Thread(target=_await_end, args=[life, litter, folder], daemon=True).start()
        _work(connection, make)
    except BaseException as end:
        if not (interrupts.requested or isinstance(end, EOFError | OSError)):  # whatever the interrupt came out as
            raise
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)


def _work(connection: Connection, make: Callable[[], Any]) -> None:
    """Answer tasks."""
    try:
        worker = make()
    except Exception as error:
        _complain(connection, error)
        return
    connection.send(_Ready)
    with contextlib.closing(worker) if hasattr(worker, "close") else contextlib.nullcontext():
        while (task := connection.recv()) is not None:
            try:
                connection.send(worker(task))
            except Exception as error:
                _complain(connection, error)


def _await_end(life: Connection, litter: str, folder: str) -> None:
    """Interrupt this process when the main one is gone, and remove what that left; kill it where that does not help."""
    with contextlib.suppress(EOFError, OSError):
        life.recv()
    if litter:
        shutil.rmtree(litter, ignore_errors=True)
    main_thread = threading.main_thread().ident
    assert main_thread is not None
    signal.pthread_kill(main_thread, signal.SIGTERM)
    sleep(_CLEANING)
    shutil.rmtree(folder, ignore_errors=True)
    os.kill(os.getpid(), signal.SIGKILL)


def _complain(connection: Connection, error: Exception) -> None:
    trace = traceback.format_exc()
    try:
        pickle.loads(pickle.dumps(error))
        connection.send(_Raised(error, trace))
    except Exception:
        connection.send(_Raised(RuntimeError(f"{type(error).__name__}: {error}"), trace))
