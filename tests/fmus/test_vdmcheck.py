"""Descriptions of FMI 2.0 before VDMCheck2, the static checker of INTO-CPS; it needs Java and Maven, and a download."""

from __future__ import annotations

import functools
import shutil
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from natives import NAMES

CACHE = Path(__file__).parents[2] / ".cache" / "vdmcheck2"
POM = """<project xmlns="http://maven.apache.org/POM/4.0.0">
  <modelVersion>4.0.0</modelVersion><groupId>local</groupId><artifactId>local</artifactId><version>1</version>
  <dependencies><dependency>
    <groupId>org.into-cps.vdmcheck.fmi2</groupId><artifactId>vdmcheck2</artifactId><version>1.1.3</version>
  </dependency></dependencies>
</project>
"""


@functools.cache
def problem() -> str:
    """Why the checker cannot be run here, nothing when it can."""
    if shutil.which("java") is None:
        return "no Java here"
    if (CACHE / "fmi2schema").is_dir():
        return ""
    return _download() if shutil.which("mvn") else "no Maven here to fetch VDMCheck2 with"


def _download() -> str:
    """The checker's files side by side, as it expects them."""
    CACHE.mkdir(parents=True, exist_ok=True)
    (CACHE / "pom.xml").write_text(POM)
    command = ["mvn", "-q", "-B", "dependency:copy-dependencies", "-DoutputDirectory=.", "-Dmdep.stripVersion=true"]
    try:
        done = subprocess.run(command, cwd=CACHE, capture_output=True, text=True, timeout=240, check=False)
    except subprocess.TimeoutExpired:
        return "Maven takes too long"
    if not (CACHE / "vdmcheck2.jar").is_file():
        return f"VDMCheck2 cannot be fetched: {(done.stdout.strip().splitlines() or ['no reason'])[0]}"
    for jar in ("rule-model", "static-model", "vdmcheck2"):
        with zipfile.ZipFile(CACHE / f"{jar}.jar") as archive:
            archive.extractall(CACHE, [name for name in archive.namelist() if name.startswith("fmi2")])
    return ""


@pytest.mark.slow
def test_vdmcheck_finds_no_errors(native_fmu: Callable[[str, int], Path]) -> None:
    if problem():
        pytest.skip(problem())
    for name in NAMES:
        done = subprocess.run(
            ["java", "-jar", "vdmcheck2.jar", str(native_fmu(name, 2))], cwd=CACHE, capture_output=True, text=True,
            timeout=120, check=False,
        )  # fmt: skip
        assert done.stdout.strip() == "No errors found.", (name, done.stdout, done.stderr)
