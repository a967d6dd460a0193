"""A process that works for this one, as this one has it: started, given tasks, asked for answers, ended."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from multiprocessing import parent_process, resource_tracker
from multiprocessing.context import BaseContext, SpawnContext
from multiprocessing.util import get_temp_dir
from pathlib import Path
from time import monotonic
from types import ModuleType
from typing import Any

from fmus.errors import InputError
from orchestrator.processes.last_words import LastWords, culprits
from orchestrator.processes.worker import CLEANING, WORDS, Raised, Ready, serve

PATIENCE = 5.0  # with a process that is to end by itself [s]
_LONGEST = 70  # of a temporary folder's path; a socket's has some 35 bytes more, and 104 at most
_STARTING = 120.0  # with one that has still to make its worker [s]

Watch = Callable[[int, int, LastWords, float], str]
"""Why a process is to be killed, "" where it may go on: given the number of its task, its id, what it says, and since
when it has the task, by the monotonic clock [s]."""


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


class Child:
    """One process, the connection to it, and the folder for its temporary files."""

    def __init__(self, context: BaseContext, make: Callable[[], Callable[[Any], Any]]) -> None:
        self._folder = tempfile.mkdtemp(prefix="servotwin-")
        self.connection, theirs = context.Pipe()
        self._process: Any = context.Process(  # type: ignore[attr-defined]
            target=serve, args=(theirs, _life()[0], make, self._folder, _litter(), dict(os.environ)), daemon=False
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
            words = LastWords(Path(self._folder, WORDS))
            fmus, part = culprits(words), words.part
            self.stop(PATIENCE)
            code = self._process.exitcode
            ending = signal.Signals(-code).name if code is not None and code < 0 else f"exit code {code}"
            seconds = monotonic() - self._begun
            at_part = monotonic() - max(words.part_since or 0.0, self._begun)
            return Died(self._silent or f"died ({ending})", seconds, fmus, part, at_part, bool(self._silent))
        if answer is Ready:
            self._begun, self._ready = monotonic(), True
        if isinstance(answer, Raised):
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
            self._words = self._words or LastWords(Path(self._folder, WORDS))
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

    def stop(self, patience: float, cleaning: float = CLEANING) -> None:
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


@cache
def _life() -> tuple[Any, Any]:
    """A pipe that this process closes by its end only, however that comes."""
    return multiprocessing.Pipe(duplex=False)


def _litter() -> str:
    """Folder with the server's socket, which nobody would remove if this process were killed; nothing below it."""
    return get_temp_dir() if parent_process() is None else ""


def context_of(modules: Sequence[str]) -> BaseContext:
    """How processes are started here, with these modules loaded ahead where that can be."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    _shorten_folder()
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["__main__", *modules])  # nothing where the server runs already
    return context


def load_ahead(modules: Sequence[str]) -> None:
    """Begin to load these modules for the processes to come, while something else is done here."""
    if isinstance(context_of(modules), SpawnContext):
        return
    from multiprocessing.forkserver import ensure_running  # noqa: PLC0415 - not to be had everywhere

    with _uninterrupted(), _without_main():
        ensure_running()


def _shorten_folder() -> None:
    """Have the server's socket in /tmp where the path of the usual folder is too long for a socket's."""
    usual = tempfile.tempdir
    if len(os.fsencode(tempfile.gettempdir())) > _LONGEST and Path("/tmp").is_dir():
        tempfile.tempdir = "/tmp"
        get_temp_dir()
        tempfile.tempdir = usual


@contextlib.contextmanager
def _without_main(make: Callable[[], Any] | None = None) -> Iterator[None]:
    """A process started here does not run the main script again, unless it makes what is defined there.

    A script that does not keep its work under `if __name__ == "__main__"` would start processes without end.
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
    if sys.platform == "win32":
        yield
        return
    resource_tracker.ensure_running()  # it would unblock the signal when it is started along with the first process
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
