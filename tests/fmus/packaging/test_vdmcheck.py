"""Descriptions of FMI 2.0 before VDMCheck2, the static checker of INTO-CPS; it needs Java and Maven, and a download."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.fmus.natives import NAMES
from tests.support.simulation.fused import fused, many_rates
from tests.support.tools import maven


def unpacked(folder: Path) -> Path:
    """The checker's files side by side, as it expects them."""
    shutil.copytree(maven.jars(maven.VDMCHECK), folder)
    for jar in ("rule-model", "static-model", "vdmcheck2"):
        with zipfile.ZipFile(folder / f"{jar}.jar") as archive:
            archive.extractall(folder, [name for name in archive.namelist() if name.startswith("fmi2")])
    return folder


def complaints(folder: Path, fmu: Path) -> str:
    """What the checker says where it finds fault."""
    done = subprocess.run(
        ["java", *maven.BRIEF, "-jar", "vdmcheck2.jar", str(fmu)],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    return "" if done.stdout.strip() == "No errors found." else done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.shipped
@pytest.mark.needs("java")
def test_vdmcheck_finds_no_errors(native_fmu: Callable[[str, int], Path], tmp_path: Path) -> None:
    if maven.problem(maven.VDMCHECK):
        pytest.skip(maven.problem(maven.VDMCHECK))
    folder = unpacked(tmp_path / "vdmcheck")
    for fmu in [fused(many_rates(tmp_path), tmp_path), *(native_fmu(name, 2) for name in NAMES)]:
        assert complaints(folder, fmu) == "", fmu
