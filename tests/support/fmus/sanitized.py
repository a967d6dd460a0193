"""Every function that an FMU exports called, well and badly, under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import os
import shutil
import subprocess
import zipfile
from pathlib import Path

import fmpy
import pytest

HARNESS = Path(__file__).parent / "harness.c"
FLAGS = ("-std=c99", "-g", "-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")  # all is done as written


def harnessed(path: Path, folder: Path, fmi: int) -> tuple[int, str]:
    """Exit code and complaints of a program of the harness and an FMU's sources, which are unpacked into a folder.

    It skips where the compiler has no sanitizers.
    """
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    resources = folder / "resources"
    token, place = fmpy.read_model_description(str(path)).guid, resources.as_uri() if fmi == 2 else str(resources)
    done = subprocess.run(
        [str(_program(folder, fmi)), token, place],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env=os.environ | {"ASAN_OPTIONS": "detect_leaks=1"},
    )
    return done.returncode, done.stderr


def _program(folder: Path, fmi: int) -> Path:
    """The harness and the sources, compiled."""
    sources = [*sorted((folder / "sources").glob("*.c")), HARNESS]
    defined = [f"-DFMI={fmi}", *(["-DNESTED"] if (folder / "sources" / "nested.c").is_file() else [])]
    command = [shutil.which("cc") or "cc", *FLAGS, *defined, f"-I{folder / 'sources'}", *map(str, sources)]
    program = folder / "harness"
    try:
        done = subprocess.run(
            [*command, "-o", str(program), "-lm", "-ldl"], capture_output=True, text=True, check=False
        )
    except OSError as error:
        pytest.skip(f"no C compiler here ({error})")
    if "asan" in done.stderr or "unrecognized" in done.stderr:
        pytest.skip(f"the compiler has no sanitizers: {done.stderr.splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    return program
