"""The container file says what the project says, and what it does as nobody special works without a container, too."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "Containerfile").read_text(encoding="utf-8")
STEPS = [line.partition(" ")[::2] for line in TEXT.replace("\\\n", "").splitlines() if line and line[0] not in "# "]
"""Word and rest of each instruction."""
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PLACE = "/opt/servotwin"


def steps(word: str) -> list[str]:
    return [rest for found, rest in STEPS if found == word]


def test_it_builds_and_runs_with_one_python_of_those_that_wheels_are_made_for() -> None:
    (build, run) = (re.match(r"python:(3)\.(\d+)-slim\b", image) for image in steps("FROM"))
    assert build and run and build.groups() == run.groups(), "an environment runs with the Python that has made it"
    assert f"cp{''.join(build.groups())}-*" in PROJECT["tool"]["cibuildwheel"]["build"].split()


def test_an_environment_lies_where_it_was_made_and_its_commands_are_found_there() -> None:
    assert f"--from=build {PLACE} {PLACE}" in steps("COPY") and steps("ENV") == [f"PATH={PLACE}/bin:$PATH"]
    (entry,) = steps("ENTRYPOINT")
    assert json.loads(entry)[0] in PROJECT["project"]["scripts"]
    assert all("gcc libc6-dev" in line for line in steps("RUN") if "apt-get" in line) and "USER servotwin" in TEXT


def test_its_extras_are_the_projects_and_its_commands_those_of_the_guide() -> None:
    (wanted,) = re.findall(r"/source\[([\w,]+)\]", TEXT)
    assert set(wanted.split(",")) <= PROJECT["project"]["optional-dependencies"].keys()
    guide = (ROOT / "docs" / "guides" / "install.md").read_text(encoding="utf-8")
    build, run = (line.removeprefix("#").strip() for line in TEXT.splitlines() if line.startswith("#   docker "))
    assert build in guide and run.endswith("servotwin test scenarios")


@pytest.mark.slow
@pytest.mark.shipped
def test_its_environment_is_made_and_runs_scenarios(tmp_path: Path) -> None:
    left_out = (ROOT / ".dockerignore").read_text(encoding="utf-8").split()
    ignored = shutil.ignore_patterns(*(name.removeprefix("**/") for name in left_out))
    source, place, work = tmp_path / "source", tmp_path / "opt", tmp_path / "work"
    shutil.copytree(ROOT, source, ignore=ignored)
    shutil.copytree(ROOT / "scenarios" / "butterfly", work / "scenarios" / "butterfly")
    (making,) = (line for line in steps("RUN") if "apt-get" not in line)
    command = making.replace(PLACE, str(place)).replace("/source", str(source))
    assert command.startswith("python ")
    subprocess.run(command.replace("python ", f"{shlex.quote(sys.executable)} ", 1), shell=True, check=True)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    environment["PATH"] = f"{place / 'bin'}:{environment['PATH']}"
    words = ["servotwin", "test", "scenarios/butterfly/energy_control.yaml"]
    done = subprocess.run(words, cwd=work, env=environment, check=False, text=True, capture_output=True)
    assert done.returncode == 0, done.stdout + done.stderr
