"""The sources of native FMUs are C++, too, for importers and tools that compile all sources as that."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from fmus.packaging import archive
from tests.support.simulation.fused import fused, many_rates, of_fmus

Built = Callable[[str, int], Path]
STRICT = ("-x", "c++", "-std=c++17", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-fsyntax-only")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("c++") is None, reason="there is no C++ compiler"),
]


def complaints(fmu: Path, folder: Path) -> str:
    """What a C++ compiler says of the sources of an FMU."""
    folder.mkdir()
    for name, text in archive.read(fmu).items():
        if name.startswith("sources/"):
            (folder / Path(name).name).write_bytes(text)
    units = map(str, sorted(folder.glob("*.c")))
    return subprocess.run(["c++", *STRICT, *units], capture_output=True, text=True, check=False).stderr


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", ["pd", "pendulum"])
def test_the_sources_of_a_model_are(name: str, fmi: int, source_fmu: Built, tmp_path: Path) -> None:
    assert complaints(source_fmu(name, fmi), tmp_path / "sources") == ""


@pytest.mark.parametrize("fmi", [2, 3])
def test_those_of_a_fused_system_are(fmi: int, tmp_path: Path) -> None:
    assert complaints(fused(many_rates(tmp_path), tmp_path, fmi, platforms=()), tmp_path / "sources") == ""


@pytest.mark.parametrize("fmi", [2, 3])
def test_those_of_a_system_with_fmus_inside_are(fmi: int, tmp_path: Path) -> None:
    file = many_rates(tmp_path, *of_fmus(tmp_path, 2, "pendulum"), *of_fmus(tmp_path, 3, "servo_drive"))
    assert complaints(fused(file, tmp_path, fmi, platforms=()), tmp_path / "sources") == ""
