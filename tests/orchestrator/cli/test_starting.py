"""Starting files run as they are, and a file that is given to the wrong command is told the right one."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from identification.cli import app
from orchestrator.cli.tables import STARTERS


def servotwin(arguments: str) -> Result:
    return CliRunner().invoke(app, shlex.split(arguments))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["scenario", "study", "design", "sweep", "model"])
def test_starting_files_do_what_their_last_lines_say(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    begun = servotwin(f"init {kind}")
    assert begun.exit_code == 0, begun.output
    for line in STARTERS[kind].commands:
        assert line in begun.output
        done = servotwin(line.removeprefix("servotwin "))
        assert done.exit_code == 0, done.output
        assert "warning" not in done.output


def test_another_folder_for_starting_files_is_named_where_the_next_commands_are(tmp_path: Path) -> None:
    assert f"next, in {tmp_path / 'new'}:" in servotwin(f"init model --out {tmp_path / 'new'}").output


def test_a_file_that_is_there_is_kept_and_nothing_else_written(tmp_path: Path) -> None:
    (tmp_path / "study.yaml").write_text("mine")
    refused = servotwin(f"init study --out {tmp_path}")
    assert refused.exit_code == 2
    assert "study.yaml: is there already" in refused.output
    assert [file.name for file in tmp_path.iterdir()] == ["study.yaml"]
    assert (tmp_path / "study.yaml").read_text() == "mine"


@pytest.mark.parametrize(
    ("kind", "arguments", "advice"),
    [
        ("study", "run study.yaml", "is a study; give it to `servotwin calibrate`"),
        ("study", "test study.yaml", "is a study; give it to `servotwin calibrate`"),
        ("scenario", "calibrate scenario.yaml", "is a scenario; give it to `servotwin run`"),
        ("study", "study.yaml", "servotwin calibrate study.yaml"),
        ("scenario", "scenario.yaml", "servotwin run scenario.yaml"),
        ("sweep", "run sweep.yaml", "is a sweep; give it to `servotwin sweep`"),
        ("sweep", "sweep.yaml", "servotwin sweep sweep.yaml"),
        ("model", "my_model.py", "servotwin build my_model.py"),
    ],
)
def test_a_file_given_to_the_wrong_command_is_told_the_right_one(
    kind: str, arguments: str, advice: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    servotwin(f"init {kind}")
    refused = servotwin(arguments)
    assert refused.exit_code == 2
    assert advice in refused.output


def test_a_tolerance_below_zero_is_refused(tmp_path: Path) -> None:
    servotwin(f"init scenario --out {tmp_path}")
    file = tmp_path / "scenario.yaml"
    file.write_text(file.read_text().replace("within: 1}", "within: -1}"))
    refused = servotwin(f"run {file} --out {tmp_path / 'out'}")
    assert refused.exit_code == 2
    assert "within" in refused.output


def test_a_shell_completes_commands() -> None:
    found = CliRunner().invoke(
        app,
        env={"_SERVOTWIN_COMPLETE": "complete_bash", "COMP_WORDS": "servotwin cali", "COMP_CWORD": "1"},
        prog_name="servotwin",
    )
    assert found.output.split() == ["calibrate"]
