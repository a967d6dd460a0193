"""What a change touches is run: models, YAML files, recordings and references by their content."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from fmus.errors import InputError
from orchestrator import formats
from orchestrator.batch.changes import changes
from orchestrator.batch.dependencies import dependencies
from orchestrator.trace import Trace

SCENARIO = """
title: It's a scenario
components:
  own: {model: own.py}
  known: {model: pendulum}
stimuli:
  own.u: {file: data/drive.csv, signal: u}
run: {stop: 1, step: 0.1}
"""
PROCEDURE = "title: both\nprocedure:\n  - run: [\"run {here}/a.yaml --out '{out}/a'\"]\n"


def git(folder: Path, *arguments: str) -> None:
    identity = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
    subprocess.run(["git", "-C", str(folder), *identity, *arguments], check=True, capture_output=True)


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    tmp_path = tmp_path / "repository"
    (tmp_path / "data").mkdir(parents=True)
    formats.write(Trace(np.array([0.0, 1.0]), {"u": np.zeros(2)}), tmp_path / "data" / "drive.csv")
    (tmp_path / "a.yaml").write_text(SCENARIO)
    (tmp_path / "b.yaml").write_text(SCENARIO.replace("own.py", "dc_motor"))
    (tmp_path / "p.yaml").write_text(PROCEDURE)
    (tmp_path / "own.py").write_text("MODEL = None\n")
    (tmp_path / "references" / "b").mkdir(parents=True)
    (tmp_path / "references" / "b" / "run.parquet").write_bytes(b"1")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-q", "-m", "begin")
    return tmp_path


def touched(tree: Path, revision: str = "HEAD") -> dict[str, list[str]]:
    found = changes(revision, tree)
    names = {name: found.touching(tree / f"{name}.yaml") for name in "abp"}
    return {name: [str(file.relative_to(tree)) for file in files] for name, files in names.items() if files}


def test_a_file_depends_on_all_that_it_names_and_on_what_that_names(tree: Path) -> None:
    names = {file.name for file in dependencies(tree / "p.yaml")}
    assert names == {"p.yaml", "a.yaml", "own.py", "pendulum.py", "drive.csv"}
    assert {file.name for file in dependencies(tree / "b.yaml")} == {
        "b.yaml",
        "dc_motor.py",
        "pendulum.py",
        "drive.csv",
    }


def test_nothing_is_touched_where_nothing_differs_also_when_files_are_written_again(tree: Path) -> None:
    (tree / "a.yaml").write_text(SCENARIO)
    assert touched(tree) == {}


@pytest.mark.parametrize(
    ("file", "expected"),
    [
        ("a.yaml", {"a", "p"}),
        ("own.py", {"a", "p"}),
        ("data/drive.csv", {"a", "b", "p"}),
        ("references/b/run.parquet", {"b"}),
        ("p.yaml", {"p"}),
    ],
)
@pytest.mark.parametrize("how", ["changed", "committed", "removed"])
def test_a_change_touches_those_that_depend_on_it(tree: Path, file: str, expected: set[str], how: str) -> None:
    if how == "removed":
        if file.endswith(".yaml"):
            pytest.skip("a file of the suite that is gone is not run")
        (tree / file).unlink()
    else:
        with (tree / file).open("ab") as target:
            target.write(b"\n# x\n")
    if how == "committed":
        git(tree, "commit", "-q", "-a", "-m", "change")
        assert touched(tree) == {}
    found = touched(tree, "HEAD~1" if how == "committed" else "HEAD")
    assert set(found) == expected and all(file in files for files in found.values())


def test_a_new_reference_touches_its_scenario_and_a_file_outside_of_git_always_does(tree: Path) -> None:
    (tree / "references" / "a").mkdir()
    (tree / "references" / "a" / "run.parquet").write_bytes(b"1")
    assert set(touched(tree)) == {"a"}
    outside = tree.parent / "outside.csv"
    outside.write_text("time [s],u\n0,1\n1,1\n")
    (tree / "b.yaml").write_text((tree / "b.yaml").read_text().replace("data/drive.csv", "../outside.csv"))
    git(tree, "commit", "-q", "-a", "-m", "outside")
    assert set(changes("HEAD", tree).touching(tree / "b.yaml")) == {outside.resolve()}


def test_a_revision_that_is_not_there_or_an_option_in_its_place_is_refused(
    tree: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    for revision in ("no-such-thing", "--output=x", ""):
        with pytest.raises(InputError, match="git says"):
            changes(revision, tree)
    with pytest.raises(InputError, match="not a git repository"):
        changes("HEAD", tree.parent)
