"""What is given away: the same bytes from the same files, whole, and of one version."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("fmus", "orchestrator", "identification")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def tracked() -> list[str]:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("this is no checkout")
    return [name for name in listed.stdout.splitlines() if (ROOT / name).is_file()]


def copy_of_the_tree(folder: Path) -> Path:
    for name in tracked():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name)
    return folder


def packed(tree: Path, kind: str) -> Path:
    words = [sys.executable, "-m", "build", "--no-isolation", f"--{kind}", "--outdir", "dist", "."]
    subprocess.run(
        words, cwd=tree, check=True, capture_output=True, env={**os.environ, "SOURCE_DATE_EPOCH": "1700000000"}
    )
    return next((tree / "dist").iterdir())


@pytest.mark.needs("dist")
@pytest.mark.slow
def test_sources_have_the_same_bytes_wherever_and_whenever_they_are_packed(tmp_path: Path) -> None:
    first, second = copy_of_the_tree(tmp_path / "a"), copy_of_the_tree(tmp_path / "much" / "deeper")
    for file in second.rglob("*.py"):
        os.utime(file, (1, 1e9))
        file.chmod(0o664)
    archives = [packed(tree, "sdist") for tree in (first, second)]
    assert archives[0].read_bytes() == archives[1].read_bytes()
    with tarfile.open(archives[0]) as archive:
        assert {member.mtime for member in archive} == {1700000000}


@pytest.mark.needs("dist")
@pytest.mark.slow
def test_a_wheel_holds_every_file_of_the_packages(tmp_path: Path) -> None:
    wheel = packed(copy_of_the_tree(tmp_path), "wheel")
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
    assert {name for name in tracked() if name.startswith(tuple(f"{one}/" for one in PACKAGES))} <= held
    assert not [name for name in held if name.startswith("tests")]


def test_the_version_is_that_of_the_citation_and_of_the_changelog() -> None:
    cited = re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    newest = re.search(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert cited and newest and cited[1] == newest[1] == PROJECT["version"]


def test_everything_that_an_extra_brings_is_pinned() -> None:
    pinned = {
        line.split("==")[0].lower().replace("_", "-") for line in (ROOT / "constraints.txt").read_text().splitlines()
    }
    wanted = [*PROJECT["dependencies"], *(one for extra in PROJECT["optional-dependencies"].values() for one in extra)]
    names = {re.match(r"[\w.-]+", one)[0].lower().replace("_", "-") for one in wanted}  # type: ignore[index]
    assert names <= pinned


def test_the_guide_names_every_extra_that_users_install() -> None:
    text = (ROOT / "docs" / "guides" / "install.md").read_text()
    of_developers = {"dev", "bench", "browser", "fuzz", "dist"}
    assert {f"`{extra}`" for extra in PROJECT["optional-dependencies"].keys() - of_developers} <= set(
        re.findall(r"^\| (`\w+`) \|", text, re.MULTILINE)
    )
