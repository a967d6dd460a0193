"""The life of a process that works for another: one worker, a task at a time, and its end when the other is gone."""

from __future__ import annotations

import contextlib
import os
import pickle
import shutil
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.util import Finalize
from pathlib import Path
from time import sleep
from typing import Any

from orchestrator.processes import last_words
from orchestrator.processes.interrupts import Interrupts
from orchestrator.processes.last_words import LastWords

WORDS = "last words"  # file in the folder of a process
CLEANING = 15.0  # with one that was interrupted and cleans up [s]


class Ready:
    """What a process says when its worker is made."""


@dataclass(frozen=True)
class Raised:
    """An error on its way from a process."""

    error: BaseException
    trace: str


def serve(
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
        last_words.begin(LastWords(Path(folder, WORDS)))
        if sys.platform != "win32":  # for those that are started from here
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
    connection.send(Ready)
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
    if sys.platform == "win32":
        os._exit(1)
    main_thread = threading.main_thread().ident
    assert main_thread is not None
    signal.pthread_kill(main_thread, signal.SIGTERM)
    sleep(CLEANING)
    shutil.rmtree(folder, ignore_errors=True)
    os.kill(os.getpid(), signal.SIGKILL)


def _complain(connection: Connection, error: Exception) -> None:
    trace = traceback.format_exc()
    try:
        pickle.loads(pickle.dumps(error))
        connection.send(Raised(error, trace))
    except Exception:
        connection.send(Raised(RuntimeError(f"{type(error).__name__}: {error}"), trace))
