"""Binaries for other platforms, built with ziglang and run under wine and qemu: the numbers of this machine's.

They need `pip install 'servotwin[cross]'`, and of Debian's packages wine and wine64, qemu-user and libc6-arm64-cross.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import quote

import fmpy
import numpy as np
import pytest

from fmus import library
from fmus.modelling.model import Table
from fmus.packaging.native import build as native
from fmus.packaging.native import compiler
from orchestrator.trace import FloatArray
from tests import support
from tests.support.fmus.moving import moving
from tests.support.fmus.natives import NAMES, VERSIONS

PLAYER = Path(support.__file__).parent / "fmus" / "player.c"
HEADERS = Path(str(fmpy.__file__)).parent / "c-code"
AARCH64_ROOT = Path("/usr/aarch64-linux-gnu")
STEP, COUNT = 0.01, 40
PLAYED = Table("playback", (0.0, 0.1, 0.3, 0.5), (0.0, 1.0, -0.7, 0.2))


@dataclass(frozen=True)
class Machine:
    """What runs programs of a platform here: the command before theirs, and what it calls the root of all files."""

    platform: compiler.Platform
    command: tuple[str, ...] = ()
    root: str = "/"
    environment: Mapping[str, str] = field(default_factory=dict)


@contextmanager
def wine() -> Iterator[Machine]:
    """Windows, with a disk of its own that is gone at the end."""
    program = shutil.which("wine64") or shutil.which("wine")
    if program is None:
        pytest.skip("no wine here")
    with tempfile.TemporaryDirectory(prefix="servotwin-wine-", ignore_cleanup_errors=True) as disk:
        environment = {
            "WINEPREFIX": disk,
            "WINEDEBUG": "-all",
            "WINEDLLOVERRIDES": "mscoree,mshtml=",
            "LC_ALL": "C.UTF-8",
        }
        yield Machine(compiler.PLATFORMS["x86_64-windows"], (program,), "Z:/", environment)
        server = shutil.which("wineserver") or shutil.which("wineserver-stable") or "wineserver"
        subprocess.run([server, "-k"], env=os.environ | environment, check=False, timeout=60)


@contextmanager
def qemu() -> Iterator[Machine]:
    """Linux on aarch64."""
    program = shutil.which("qemu-aarch64") or shutil.which("qemu-aarch64-static")
    if program is None:
        pytest.skip("no qemu-aarch64 here")
    if not AARCH64_ROOT.is_dir():
        pytest.skip("no C library for aarch64 here (Debian's libc6-arm64-cross)")
    yield Machine(compiler.PLATFORMS["aarch64-linux"], (program, "-L", str(AARCH64_ROOT)))


def player(machine: Machine, folder: Path, fmi: int) -> Path:
    """The program that steps FMUs, built for a machine."""
    program = folder / f"player-{machine.platform.name}.exe"
    libraries = [] if machine.platform.suffix == ".dll" else ["-ldl"]
    command = [*compiler.command_for(machine.platform), "-std=c99", "-O2", "-s", f"-DFMI={fmi}", f"-I{HEADERS}"]
    subprocess.run([*command, str(PLAYER), "-o", str(program), *libraries], check=True, timeout=3 * compiler.TIME_LIMIT)
    return program


def played(machine: Machine, program: Path, fmu: Path, folder: Path) -> FloatArray:
    """(COUNT, outputs) the outputs of an unpacked FMU after each step."""
    about = fmpy.read_model_description(str(fmu))
    old = about.fmiVersion == "2.0"
    place = machine.root + str(folder / "resources").lstrip("/")
    library_path = f"binaries/{machine.platform.folder2 if old else machine.platform.name}/{about.modelName}"
    references = [str(v.valueReference) for v in about.modelVariables if v.causality == "output"]
    done = subprocess.run(
        [
            *machine.command,
            str(program),
            library_path + machine.platform.suffix,
            about.guid,
            str(STEP),
            str(COUNT),
            *references,
        ],
        cwd=folder,
        input=f"file:///{quote(place.lstrip('/'), safe='/:')}" if old else place,
        capture_output=True,
        encoding="utf-8",
        env=os.environ | machine.environment,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, (fmu.name, done.stderr)
    return np.array([[float.fromhex(value) for value in line.split()] for line in done.stdout.splitlines()])


def unpacked(fmu: Path) -> Path:
    """The files of an FMU, below a folder whose name has more than letters."""
    folder = fmu.parent / "a b%20c" / "häß" / fmu.stem
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder)
    return folder


@pytest.mark.slow
@pytest.mark.skipif(not compiler.available(), reason="no C compiler here")
@pytest.mark.needs("cross")
@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("emulator", [wine, qemu])
def test_binaries_of_other_platforms_give_the_numbers_of_this_one(
    tmp_path: Path, emulator: Callable[[], AbstractContextManager[Machine]], fmi: int
) -> None:
    here = Machine(compiler.host())
    with emulator() as there:
        players = [player(machine, tmp_path, fmi) for machine in (here, there)]
        for name in NAMES:
            model = library.find(name)
            values = moving(name) | ({"shape": 8} if name == "excitation" else {})
            tables = dict.fromkeys(model.tables, PLAYED)
            fmu = native.build(model, tmp_path / f"{name}.fmu", values, tables, fmi, ("host", there.platform.name))
            folder = unpacked(fmu)
            expected, found = (played(*pair, fmu, folder) for pair in zip((here, there), players, strict=True))
            assert expected.shape == (COUNT, len(model.of("output")))
            assert found == pytest.approx(expected, rel=1e-12, abs=1e-14), name
