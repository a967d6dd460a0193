"""A Dask cluster on loopback: a scheduler and workers in processes of their own, which may be killed."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

PATIENT = 120.0  # [s]


class DaskCluster:
    """A scheduler, and workers of one thread each.

    Attributes:
        address: of the scheduler.
    """

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self._port = free.getsockname()[1]
        self.address = f"tcp://127.0.0.1:{self._port}"
        self._folder, self._workers = folder, list[subprocess.Popen[bytes]]()
        self._scheduler = self._started_scheduler()

    def _started_scheduler(self) -> subprocess.Popen[bytes]:
        started = _start(
            ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(self._port), "--no-dashboard"], {}
        )
        end = time.monotonic() + PATIENT
        while True:
            with suppress(OSError), socket.create_connection(("127.0.0.1", self._port), 1):
                return started
            assert started.poll() is None and time.monotonic() < end, "the scheduler does not begin"
            time.sleep(0.05)

    def add_worker(self, environment: Mapping[str, str] | None = None, prefix: str = "") -> None:
        """Start a worker, and wait until the scheduler knows it.

        Args:
            prefix: of its shell command, such as a limit.
        """
        number = len(self._workers)
        command = ["distributed.cli.dask_worker", self.address, "--nthreads", "1", "--no-dashboard"]
        command += ["--name", f"worker{number}", "--local-directory", str(self._folder / f"worker{number}")]
        self._workers.append(_start(command, environment or {}, prefix))
        self.wait_for(number + 1)

    def wait_for(self, count: int) -> None:
        """Wait until so many workers are there."""
        from distributed import Client

        with Client(self.address, timeout=PATIENT, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=PATIENT)

    def kill_a_worker(self) -> None:
        """Kill the process of one that runs tasks; its nanny starts another."""
        children = Path(f"/proc/{self._workers[0].pid}/task/{self._workers[0].pid}/children").read_text().split()
        for child in children:
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                os.kill(int(child), signal.SIGKILL)

    def restart(self) -> None:
        """Kill the scheduler, and start it and workers again, as a service manager does."""
        self._scheduler.kill()
        self._scheduler.wait()
        count = len(self._workers)
        self._end_workers()
        self._scheduler = self._started_scheduler()
        for _ in range(count):
            self.add_worker()

    def _end_workers(self) -> None:
        for worker in self._workers:
            os.killpg(worker.pid, signal.SIGKILL)
            worker.wait()
        self._workers = []

    def close(self) -> None:
        """End all of them."""
        self._end_workers()
        self._scheduler.kill()
        self._scheduler.wait()


def _start(arguments: list[str], environment: Mapping[str, str], prefix: str = "") -> subprocess.Popen[bytes]:
    root = str(Path(__file__).parents[2])
    paths = [environment.get("PYTHONPATH", ""), root, os.environ.get("PYTHONPATH", "")]
    env = {**os.environ, **environment, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    command = ["/bin/bash", "-c", f'{prefix} exec "$0" -m "$@"', sys.executable, *arguments]
    # Elsewhere, for the folder that -m puts first may hold what tells the version of this tree.
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen(command, env=env, cwd="/", start_new_session=True, **quiet)


@contextmanager
def dask_cluster(folder: Path, workers: int = 2) -> Iterator[DaskCluster]:
    """A cluster while the block lasts."""
    cluster = DaskCluster(folder)
    try:
        for _ in range(workers):
            cluster.add_worker()
        yield cluster
    finally:
        cluster.close()
