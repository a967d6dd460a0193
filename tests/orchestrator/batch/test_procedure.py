"""Procedures: what several commands give together, and what is said when one fails."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fmus.errors import ScenarioError
from orchestrator.batch.procedure import EndedCommand, outputs_of, run_procedure
from tests.support.commands import servotwin

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
    answer = servotwin("test", file, "--out", tmp_path / "out", "--json")
    (verdict,) = json.loads(answer.stdout)["scenarios"]
    assert answer.exit_code == 1
    (case,) = verdict["result"]["cases"]
    assert case["error"].startswith("exit code 2: servotwin: ") and "none.csv" in case["error"]


def test_a_command_beside_that_fails_ends_the_procedure_and_is_named_first(tmp_path: Path) -> None:
    endless = "can record --interface virtual --channel idle --out {out}/idle"
    file = written(tmp_path, f'  - {{beside: ["info {{here}}/none.csv"], run: ["{endless}"]}}\n')
    answer = servotwin("test", file, "--out", tmp_path / "out", "--json")
    (verdict,) = json.loads(answer.stdout)["scenarios"]
    first, *others = verdict["result"]["cases"]
    assert answer.exit_code == 1 and first["name"].startswith("info") and first["seconds"] > 0
    assert first["error"].startswith("ended before it was told to, with exit code 2: servotwin: ")
    assert all(case["name"].startswith("can record") for case in others)
    shown = servotwin("test", file, "--out", tmp_path / "again", env={"COLUMNS": "200"})
    assert "ended before" in shown.stdout


def test_a_command_beside_that_ends_before_it_is_told_to_has_failed_unless_it_may(tmp_path: Path) -> None:
    steps = "  - {%s beside: [\"trace info '{here}/a b.csv'\"], run: [\"trace info '{here}/a b.csv'\"]}\n"
    found = run_procedure(written(tmp_path, steps % ""), tmp_path / "out")
    assert not found["passed"] and "with exit code 0" in str(found["cases"][0]["error"])
    assert run_procedure(written(tmp_path, steps % "may_end: true,"), tmp_path / "other")["passed"]


def test_a_command_beside_that_says_nothing_is_known_to_be_ready(tmp_path: Path) -> None:
    quiet = "can record --interface virtual --channel quiet --out {out}/quiet -q"
    steps = f'  - {{ready_within: 100, beside: ["{quiet}"], run: ["trace info \'{{here}}/a b.csv\'"]}}\n'
    found = run_procedure(written(tmp_path, steps), tmp_path / "out")
    assert found["passed"] and [case["output"] == "" for case in found["cases"]] == [False, True]
    assert (tmp_path / "out" / "quiet" / "manifest.json").exists()


@pytest.mark.parametrize(
    ("key", "side", "complaint"), [("run_within", "run", "has not ended"), ("ready_within", "beside", "is not ready")]
)
def test_a_command_that_takes_too_long_is_ended_and_named(tmp_path: Path, key: str, side: str, complaint: str) -> None:
    commands = {"run": '"info x"'} | {side: "\"trace info '{here}/a b.csv'\""}
    lists = ", ".join(f"{name}: [{command}]" for name, command in commands.items())
    with pytest.raises(ScenarioError, match=rf"trace info .* {complaint} after 0.05 s"):
        run_procedure(written(tmp_path, f"  - {{{key}: 0.05, {lists}}}\n"), tmp_path / "out")


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


@pytest.mark.parametrize(
    ("output", "why"),
    [
        ("", "nothing said"),
        ("one\n└──┘\n", "one"),
        ("servotwin: a.yaml: is odd; mend it\nresults in out\n", "servotwin: a.yaml: is odd; mend it"),
    ],
)
def test_the_reason_of_a_failure_is_its_error_or_its_last_words(output: str, why: str) -> None:
    assert EndedCommand("run a.yaml", 2, 0.0, output).problem == f"exit code 2: {why}"
