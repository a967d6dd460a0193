"""Runs on a Dask cluster: rows come back as they are made, and no more is on its way than is worked on soon.

A worker that cannot run anything is told of and left alone; a scheduler that goes is waited for, and gets again what
was on its way.
"""

from __future__ import annotations

import logging
import socket
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any

from fmus.errors import InputError
from fmus.words import complaint
from orchestrator.batch.sweep.runs.package import Unable, WorkerPackage, WorkerPlatform
from orchestrator.batch.sweep.runs.queue import Queue
from orchestrator.batch.sweep.runs.setup import Chunk, ChunkResult, Setup

if TYPE_CHECKING:
    from distributed import Client, Future

LOG = logging.getLogger("servotwin.sweep")
AHEAD = 2  # tasks on their way for each thread of a worker
CONNECTING = 10.0  # patience with who answers [s]
LOOK = 0.005  # between two looks at what has come [s]
COUNTING = 5.0  # between two counts of workers [s]
SILENT = 5  # connections in a row without any answer
FORGETFUL = 100  # times that a worker has not what it was given, until it is left alone
LONELY = 30.0  # without any worker, until that is said [s]


@dataclass(frozen=True)
class Cluster:
    """A Dask cluster.

    Attributes:
        address: of its scheduler.
        patience: with a scheduler that is gone [s].
    """

    address: str
    patience: float = 60.0

    def check(self) -> None:
        """See that there is a scheduler, and that the workers that it has now are fit.

        Raises:
            InputError: there is none, a worker is not, or Dask is not installed.
        """
        with _connected(self.address, 0.0) as client:
            wanted = WorkerPlatform.here()
            for worker, found in client.run(_probe()).items():
                if problem := WorkerPlatform(*found).unfit(wanted):
                    what, _, fix = problem.partition("; ")
                    raise InputError(f"worker {worker}", what, fix)

    def outcomes(self, queue: Queue, setup: Setup) -> Iterator[tuple[Chunk, ChunkResult]]:
        """See `Runner`.

        Raises:
            InputError: the scheduler is gone for longer than the patience, or no worker can run anything.
        """
        package, unable, silent = WorkerPackage.of(setup), dict[str, str](), 0
        while silent < SILENT:
            silent += 1
            with _connected(self.address, self.patience) as client:
                session = _SchedulerSession(client, package, queue, unable)
                for outcome in session.outcomes():
                    silent = 0
                    yield outcome
            if session.finished:
                return
            LOG.warning("%s: the scheduler is gone; waiting for it, at most %g s", self.address, self.patience)
        problem = f"gave no answer over {SILENT} connections"
        raise InputError(f"--scheduler {self.address}", problem, "look at its log and those of its workers")


class _SchedulerSession:
    """One connection to a scheduler.

    Attributes:
        finished: whether all tasks have been done.

    It ends, too, when an answer that there was does not come: the scheduler may be another one than before.
    """

    def __init__(self, client: Client, package: WorkerPackage, queue: Queue, unable: dict[str, str]) -> None:
        from distributed import as_completed  # noqa: PLC0415 (an extra)

        self._client, self._package, self._queue, self._unable = client, package, queue, unable
        self._name = f"servotwin-{package.key}"
        self._active: dict[str, tuple[Future, Chunk]] = {}
        self._completed = as_completed(loop=client.loop)
        self._counted = self._seen = self._searched = -1e9
        self._numbered, self._bare = 0, Counter[str]()
        self._broken = self.finished = False

    def outcomes(self) -> Iterator[tuple[Chunk, ChunkResult]]:
        """What came of tasks, until all are done or the scheduler is gone; then those on their way are put back."""
        from orchestrator.batch.sweep.runs.equipment import Equipment  # noqa: PLC0415 (see above)

        try:
            with _going(self):
                self._client.register_plugin(Equipment(self._package))
            while self._there():
                self._fill()
                if not self._active:
                    self._finish()
                    return
                futures = self._completed.next_batch(block=False)
                if not futures:
                    sleep(LOOK)
                for future in [*futures, *self._forgotten()]:
                    if self._there():
                        yield from self._come(future)
        finally:
            self._queue.back([task for _, task in self._active.values()])
            self._active.clear()

    def _forgotten(self) -> list[Future]:
        """Those that a scheduler which came again does not know of; looked for now and then."""
        now = monotonic()
        if now - self._searched < COUNTING:
            return []
        self._searched = now
        return [future for future, _ in self._active.values() if future.status in ("cancelled", "lost")]

    def _there(self) -> bool:
        return bool(self._client.status == "running") and not self._broken

    def _finish(self) -> None:
        self.finished = True
        with suppress(Exception):  # that it could not be taken away harms nobody
            self._client.unregister_worker_plugin(self._name)

    def _fill(self) -> None:
        """Have as many tasks on their way as are worked on soon, by workers that can."""
        from orchestrator.batch.sweep.runs.equipment import work  # noqa: PLC0415 (see above)

        self._count()
        while len(self._active) < AHEAD * self._queue.slots and (task := next(self._queue, None)) is not None:
            self._numbered += 1
            key = f"{self._name}-{self._client.id}-{self._numbered}"
            future = self._client.submit(work, self._name, task, key=key, pure=False, workers=self._able or None)
            self._active[key] = future, task
            self._completed.add(future)

    def _count(self) -> None:
        """Look, now and then, how many workers there are."""
        now = monotonic()
        if now - self._counted < COUNTING:
            return
        self._counted = now
        threads = {}
        with suppress(Exception):  # the scheduler is gone, which is noticed
            threads = self._client.sync(self._client.scheduler.ncores, workers=None, callback_timeout=CONNECTING)
        able = {worker: count for worker, count in threads.items() if worker not in self._unable}
        if threads and not able:
            worker, problem = next(iter(self._unable.items()))
            raise InputError(f"worker {worker}", problem.partition("; ")[0], "mend that; no other worker is left")
        self._able = list(able) if self._unable else []
        self._queue.slots = max(1, sum(able.values()))
        if able:
            self._seen = now
        elif now - self._seen > LONELY:
            LOG.warning("%s has no workers; waiting for some: dask worker ADDRESS", self._client.scheduler.address)
            self._seen = now

    def _come(self, future: Future) -> Iterator[tuple[Chunk, ChunkResult]]:
        """A task that is done, or comes again."""
        from distributed import KilledWorker  # noqa: PLC0415 (see above)

        known = self._active.pop(future.key, None)
        if known is None:
            return
        task = known[1]
        error = None
        try:
            answer = future.result(timeout=CONNECTING) if future.status == "finished" else None
            error = future.exception(timeout=CONNECTING) if future.status == "error" else None
        except Exception as gone:  # who had the answer is gone before it came
            LOG.info("%s comes again: %s", future.key, gone)
            answer, self._broken = None, True
        future.release()
        if isinstance(error, KilledWorker):
            reason = "crashed the workers that ran it; narrow what varies, or mend the FMU"
            yield from self._queue.lost(task, 0 if len(task.runs) == 1 else None, reason, final=len(task.runs) == 1)
        elif error is not None:
            raise error
        elif isinstance(answer, ChunkResult):
            self._queue.answered(task, answer)
            yield task, answer
        else:
            if isinstance(answer, Unable):
                self._leave(answer)
            self._queue.back([task])

    def _leave(self, unable: Unable) -> None:
        """Ask a worker no more; or give it what it needs, where that is all."""
        from orchestrator.batch.sweep.runs.equipment import equip  # noqa: PLC0415 (see above)

        self._bare[unable.worker] += unable.bare
        if unable.bare and self._bare[unable.worker] <= FORGETFUL:
            with suppress(Exception):  # it is gone, then
                run = self._client._run
                self._client.sync(run, equip, self._package, workers=[unable.worker], callback_timeout=CONNECTING)
            return
        if unable.worker not in self._unable:
            problem = unable.problem or "does not keep the FMUs that it is given"
            LOG.warning("worker %s: %s; its runs go to others", unable.worker, problem)
            self._unable[unable.worker] = problem
        self._counted = -1e9


@contextmanager
def _going(session: _SchedulerSession) -> Iterator[None]:
    """What a scheduler that goes meanwhile makes of it is no error."""
    try:
        yield
    except Exception:
        if session._there():
            raise


def _check_answers(place: str, address: str, patience: float) -> None:
    """See that somebody listens at an address, which a client would try for long."""
    host, colon, port = address.partition("://")[2].rpartition(":")
    if not (colon and port.isdecimal()):
        raise InputError(place, "is no address", "write tcp://HOST:PORT")
    end = monotonic() + patience
    while True:
        try:
            socket.create_connection((host.strip("[]"), int(port)), timeout=max(0.5, min(3.0, patience))).close()
            return
        except OSError as error:
            if monotonic() + 0.2 > end:
                problem = f"no scheduler answers there ({error.strerror or error})"
                raise InputError(place, problem, "check the address, or start one: dask scheduler") from None
            sleep(0.2)


@contextmanager
def _connected(address: str, patience: float) -> Iterator[Client]:
    """A client of the scheduler at an address."""
    place = f"--scheduler {address}"
    try:
        from distributed import Client  # noqa: PLC0415 (an extra)
    except ImportError as error:
        raise InputError(place, f"needs Dask ({error})", "pip install 'servotwin[dask]'") from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters is told here
    _check_answers(place, address, patience)
    client, end = None, monotonic() + patience
    while client is None:
        try:
            client = Client(address, timeout=CONNECTING, set_as_default=False)
        except (OSError, TimeoutError) as error:
            if monotonic() > end:
                fix = "check the address, or start one: dask scheduler"
                raise InputError(place, f"no scheduler answers there ({complaint(error, 120)})", fix) from None
            sleep(0.2)
        except ValueError as error:
            raise InputError(place, f"is no address ({error})", "write tcp://HOST:PORT") from None
    try:
        yield client
    finally:
        with suppress(Exception):  # whatever a scheduler that is gone makes of it
            client.close(timeout=2)


def _probe() -> Any:
    """What a worker is asked for its version and machine; it goes there by value, also where servotwin is not."""

    def probe() -> tuple[str | None, str]:
        import platform  # noqa: PLC0415 (there)
        import sys  # noqa: PLC0415
        from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415

        try:
            found = version("servotwin")
        except PackageNotFoundError:
            found = None
        return found, f"{sys.platform} {platform.machine()}"

    return probe
