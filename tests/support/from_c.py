"""The libraries of FMUs that tests write in C, by whatever compiler is here; each is compiled once a process."""

from __future__ import annotations

import re
import shutil
import subprocess
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import fmpy
import pytest

HEADERS = Path(str(fmpy.__file__)).parent / "c-code"
SUFFIX: str = fmpy.sharedLibraryExtension


@cache
def compiled(source: Path, *options: str, completed: bool = False) -> bytes:
    """The library; the test is skipped where there is no C compiler.

    Args:
        completed: with functions that fail in place of those of FMI 3.0 that FMPy wants to be there and are not.
    """
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("there is no C compiler to build the FMU with")
    with TemporaryDirectory() as folder:
        library, rest = Path(folder, f"made{SUFFIX}"), Path(folder, "rest.c")
        rest.write_text(_rest(source) if completed else "")
        command = [compiler, "-w", "-shared", "-fPIC", "-O1", *options, f"-I{HEADERS}", str(source), str(rest)]
        subprocess.run([*command, "-o", str(library), "-lm"], check=True)
        return library.read_bytes()


def _rest(source: Path) -> str:
    wanted = set(re.findall(r"define (fmi3\w+) +fmi3FullName", (HEADERS / "fmi3Functions.h").read_text()))
    there = set(re.findall(r"FMI3_Export .*?(fmi3\w+)\(", source.read_text()))
    return "".join(f"int {name}(void) {{ return 3; }}\n" for name in sorted(wanted - there))
