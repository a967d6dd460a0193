"""Java programs that tests run FMUs in, fetched with Maven into `.cache` once for all tests."""

from __future__ import annotations

import fcntl
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

CACHE = Path(__file__).parents[3] / ".cache"
FMI4J = "info.laht.fmi4j:fmi-import:0.38.0"
VDMCHECK = "org.into-cps.vdmcheck.fmi2:vdmcheck2:1.1.3"
BRIEF = ("-XX:TieredStopAtLevel=1", "-XX:+UseSerialGC")  # for programs that end before better code would pay
POM = """<project xmlns="http://maven.apache.org/POM/4.0.0">
  <modelVersion>4.0.0</modelVersion><groupId>local</groupId><artifactId>local</artifactId><version>1</version>
  <dependencies><dependency>
    <groupId>{}</groupId><artifactId>{}</artifactId><version>{}</version>
  </dependency></dependencies>
</project>
"""


def jars(artifact: str) -> Path:
    """The folder of a program's jars and all that it depends on, named without their versions."""
    return CACHE / artifact.replace(":", "_")


@cache
def problem(artifact: str) -> str:
    """Why a program cannot be run here, nothing when it can; fetches it where it is not there yet."""
    if shutil.which("javac") is None:
        return "no Java development kit here"
    CACHE.mkdir(exist_ok=True)
    with (CACHE / "maven.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # tests run side by side
        if jars(artifact).is_dir():
            return ""
        return _fetch(artifact) if shutil.which("mvn") else f"no Maven here to fetch {artifact} with"


def _fetch(artifact: str) -> str:
    with tempfile.TemporaryDirectory(dir=CACHE) as folder:
        (Path(folder) / "pom.xml").write_text(POM.format(*artifact.split(":")))
        command = [
            "mvn",
            "-q",
            "-B",
            "dependency:copy-dependencies",
            "-DoutputDirectory=jars",
            "-Dmdep.stripVersion=true",
        ]
        try:
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=240, check=False)
        except subprocess.TimeoutExpired:
            return f"Maven takes too long to fetch {artifact}"
        if done.returncode:
            return f"{artifact} cannot be fetched: {(done.stdout.strip().splitlines() or ['no reason'])[0]}"
        (Path(folder) / "jars").rename(jars(artifact))
        return ""
