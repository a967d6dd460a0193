"""What a worker of a cluster needs of a sweep: its setup with the FMUs, which are known by their hash."""

from __future__ import annotations

import hashlib
import pickle
import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fmus.files import sha256
from orchestrator.batch.sweep.runs.setup import Setup
from orchestrator.results import version_of


@dataclass(frozen=True)
class Unable:
    """What a worker says that cannot run a task.

    Attributes:
        bare: whether it only was not given what it needs.
    """

    worker: str
    problem: str
    bare: bool = False


@dataclass(frozen=True)
class WorkerPlatform:
    """What runs can depend on, of a worker.

    Attributes:
        version: of servotwin, None where it is not installed.
        machine: operating system and processor, which decide what binaries of an FMU run.
    """

    version: str | None
    machine: str

    @classmethod
    def here(cls) -> WorkerPlatform:
        """That of this process."""
        return cls(version_of("servotwin"), f"{sys.platform} {platform.machine()}")

    def unfit(self, wanted: WorkerPlatform) -> str:
        """Why it is none where another one is wanted; "" where it is as that one."""
        if self.version is None:
            return f"has no servotwin; install {wanted.version} there"
        if self.version != wanted.version:
            return f"has servotwin {self.version}, not {wanted.version}; install that there"
        if self.machine != wanted.machine:
            return f"is {self.machine}, and the FMUs are for {wanted.machine}; start the sweep on a machine like it"
        return ""


@dataclass(frozen=True)
class WorkerPackage:
    """What a worker needs.

    Attributes:
        setup: whose FMUs are files by their hash.
        files: name -> content.
        platform: what the worker has to be.
        key: a hash, by which workers know it; made once, for an equal object can be pickled to other bytes.
    """

    setup: Setup
    files: Mapping[str, bytes]
    platform: WorkerPlatform
    key: str

    @classmethod
    def of(cls, setup: Setup) -> WorkerPackage:
        """A setup with its FMUs."""
        places = {file: Path(f"{sha256(file)}.fmu") for variant in setup.variants for file in variant.files}
        content = {place.name: file.read_bytes() for file, place in places.items()}
        moved, here = setup.moved(places), WorkerPlatform.here()
        key = hashlib.sha256(pickle.dumps((moved, sorted(content), here))).hexdigest()[:16]
        return cls(moved, content, here, key)
