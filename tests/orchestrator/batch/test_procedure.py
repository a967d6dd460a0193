"""Procedures: what several commands give together, and what is said when one fails."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fmus.errors import ScenarioError
from identification.cli import app
from orchestrator.batch import procedure
from orchestrator.batch.procedure import outputs_of, run_procedure

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work

TRACE = "time [s],angle [rad]\n0,1\n1,2\n"


def written(folder: Path, steps: str) -> Path:
    (folder / "a b.csv").write_text(TRACE)
    file = folder / "procedure.yaml"
    file.write_text(f"title: some commands\nprocedure:\n{steps}")
    return file


def test_commands_find_the_folders_and_pass_files_on(tmp_path: Path) -> None:
    steps = """
  - run: ["trace convert '{here}/a b.csv' '{out}/c.csv'"]
  - run: ["trace info '{out}/c.csv'", "trace info '{here}/a b.csv' --json"]
"""
    found = run_procedure(written(tmp_path, steps), tmp_path / "out")
    assert found["passed"]
    assert [case["name"].split()[1] for case in found["cases"]] == ["convert", "info", "info"]
    assert json.loads(found["cases"][2]["output"])["traces"][0]["samples"] == 2
    assert (tmp_path / "out" / "c.csv").is_file()
    assert "$ servotwin trace convert" in outputs_of(found)
    assert json.loads((tmp_path / "out" / "manifest.json").read_text())["passed"]


def test_the_first_command_that_fails_ends_it_and_says_why(tmp_path: Path) -> None:
    file = written(tmp_path, '  - run: ["info {here}/none.csv"]\n  - run: ["trace info {here}/a.csv"]\n')
    answer = CliRunner().invoke(app, ["test", str(file), "--out", str(tmp_path / "out"), "--json"])
    (verdict,) = json.loads(answer.stdout)["scenarios"]
    assert answer.exit_code == 1
    (case,) = verdict["result"]["cases"]
    assert case["error"].startswith("exit code 2: servotwin: ") and "none.csv" in case["error"]


def test_a_command_that_is_to_run_beside_others_but_ends_at_once_fails_the_procedure(tmp_path: Path) -> None:
    file = written(tmp_path, '  - {beside: ["info {here}/none.csv"], run: ["trace info \'{here}/a b.csv\'"]}\n')
    found = run_procedure(file, tmp_path / "out")
    assert [case["passed"] for case in found["cases"]] == [True, False]


def test_a_command_that_never_ends_is_ended_and_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(procedure, "RUN_TIME", 0.05)
    with pytest.raises(ScenarioError, match=r"trace info .* has not ended after 0.05 s"):
        run_procedure(written(tmp_path, "  - run: [\"trace info '{here}/a b.csv'\"]\n"), tmp_path / "out")


@pytest.mark.parametrize(
    ("steps", "complaint"),
    [
        ("  - {beside: [info a]}\n", "run"),
        ("  - {run: []}\n", "at least 1"),
        ("  - {run: [' ']}\n", "empty command"),
        ('  - {run: ["info \'a"]}\n', "No closing quotation|no closing quotation"),
    ],
)
def test_steps_that_do_not_fit_are_refused(tmp_path: Path, steps: str, complaint: str) -> None:
    with pytest.raises(ScenarioError, match=complaint):
        run_procedure(written(tmp_path, steps), tmp_path / "out")
    assert not (tmp_path / "out").exists()
