"""What a worker of a Dask cluster has of a sweep: a plugin, which the scheduler gives to those that come later, too."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from distributed import get_worker
from distributed.diagnostics.plugin import WorkerPlugin

from fmus.errors import ServotwinError
from orchestrator.batch.sweep.runs.package import Unable, WorkerPackage, WorkerPlatform
from orchestrator.batch.sweep.runs.setup import Chunk, ChunkResult
from orchestrator.batch.sweep.runs.worker import Worker


class Equipment(WorkerPlugin):
    """A plugin of a worker: its own copy of the FMUs, and the systems that each of its threads has open.

    Attributes:
        name: by which the worker knows it.
        problem: why it cannot run anything, "" where it can.
    """

    idempotent = True

    def __init__(self, package: WorkerPackage) -> None:
        self.package, self.name, self.problem = package, f"servotwin-{package.key}", ""
        self._folder = Path()

    def __reduce__(self) -> tuple[Callable[[WorkerPackage], Equipment], tuple[WorkerPackage]]:
        return Equipment, (self.package,)

    def setup(self, worker: Any) -> None:
        """Called when the worker gets it."""
        self._workers: dict[int, Worker] = {}
        self._lock = threading.Lock()
        self.problem = WorkerPlatform.here().unfit(self.package.platform)
        self._folder = Path(worker.local_directory) / self.name
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            for name, content in self.package.files.items():
                _put(self._folder / name, content)
        except OSError as error:
            self.problem = self.problem or f"cannot write {self._folder} ({error.strerror})"

    def teardown(self, worker: Any) -> None:
        """Called when the worker ends."""
        for one in self._workers.values():
            one.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def run(self, task: Chunk, worker: str) -> ChunkResult | Unable:
        """What comes of a task in this thread."""
        if self.problem:
            return Unable(worker, self.problem)
        try:
            return replace(self._worker()(task), by=worker)
        except ServotwinError as error:
            return Unable(worker, str(error))
        except OSError as error:
            return Unable(worker, f"{error.filename or 'its disk'}: {error.strerror or error}")

    def _worker(self) -> Worker:
        with self._lock:
            own = threading.get_ident()
            if own not in self._workers:
                files = {Path(name): self._folder / name for name in self.package.files}
                self._workers[own] = Worker(self.package.setup.moved(files))
            return self._workers[own]


def _put(file: Path, content: bytes) -> None:
    if not file.exists():
        part = file.with_suffix(".part")
        part.write_bytes(content)
        part.replace(file)


async def equip(package: WorkerPackage, dask_worker: Any) -> None:
    """Give a worker what it needs that came while the others were given it."""
    equipment = Equipment(package)
    if equipment.name not in dask_worker.plugins:
        await dask_worker.plugin_add(plugin=equipment, name=equipment.name)


def work(name: str, task: Chunk) -> ChunkResult | Unable:
    """What a worker does of a sweep, by the name of its equipment."""
    worker = get_worker()
    equipment = worker.plugins.get(name)
    if equipment is None:
        return Unable(worker.address, "", bare=True)
    done: ChunkResult | Unable = equipment.run(task, worker.address)
    return done
