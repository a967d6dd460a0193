"""Every function of native FMUs called, well and badly, under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

import os
import shutil
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import pytest

from tests import support
from tests.support.fmus.natives import NAMES, VERSIONS

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work

HARNESS = Path(support.__file__).parent / "fmus" / "harness.c"
FLAGS = ("-std=c99", "-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-Wall", "-Wextra")


def sanitized(folder: Path, fmi: int) -> Path:
    """The harness and an FMU's sources as one program; skips where the compiler has no sanitizers."""
    sources = [*sorted((folder / "sources").glob("*.c")), HARNESS]
    command = [shutil.which("cc") or "cc", *FLAGS, f"-DFMI={fmi}", f"-I{folder / 'sources'}", *map(str, sources)]
    program = folder / "harness"
    try:
        done = subprocess.run([*command, "-o", str(program), "-lm"], capture_output=True, text=True, check=False)
    except OSError as error:
        pytest.skip(f"no C compiler here ({error})")
    if "asan" in done.stderr or "unrecognized" in done.stderr:
        pytest.skip(f"the compiler has no sanitizers: {done.stderr.splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    return program


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", NAMES)
def test_no_call_leaves_memory_behind_or_its_bounds(
    native_fmu: Callable[[str, int], Path], tmp_path: Path, name: str, fmi: int
) -> None:
    with zipfile.ZipFile(native_fmu(name, fmi)) as archive:
        archive.extractall(tmp_path)
    token = fmpy.read_model_description(str(native_fmu(name, fmi))).guid
    resources = tmp_path / "resources"
    place = resources.as_uri() if fmi == 2 else str(resources)
    done = subprocess.run(
        [str(sanitized(tmp_path, fmi)), token, place],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env=os.environ | {"ASAN_OPTIONS": "detect_leaks=1"},
    )
    assert (done.returncode, done.stderr) == (0, "")
