"""The libraries of FMUs that tests write in C, by whatever compiler is here."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import fmpy
import pytest

HEADERS = Path(str(fmpy.__file__)).parent / "c-code"


def compiled(library: Path, *sources: Path, options: tuple[str, ...] = ()) -> bytes:
    """The library, which is left there, too; the test is skipped where there is no C compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("there is no C compiler to build the FMU with")
    command = [compiler, "-w", "-shared", "-fPIC", "-O1", *options, f"-I{HEADERS}", *map(str, sources)]
    subprocess.run([*command, "-o", str(library), "-lm"], check=True)
    return library.read_bytes()
