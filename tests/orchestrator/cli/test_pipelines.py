"""Pipelines of GitHub and GitLab do what they say, with the commands that stand in them: on a suite that fails, they
fail, and leave what they hand to whoever looks."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from ruamel.yaml import YAML

from tests.support.commands import servotwin

ROOT = Path(__file__).parents[3]
ACTION = ROOT / ".github" / "actions" / "test" / "action.yml"
SCENARIO = """title: swing
components: {hand: {model: pendulum, parameters: {angle_start: 0.5}}}
run: {stop: 0.1, step: 0.01}
expect: [{signal: hand.angle, below: LIMIT}]
"""


def contents(file: Path) -> Any:
    return YAML(typ="safe").load(file)


def scenarios(folder: Path, limit: float) -> None:
    (folder / "scenarios").mkdir()
    (folder / "scenarios" / "swing.yaml").write_text(SCENARIO.replace("LIMIT", str(limit)))


def shell(script: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """The script as a runner does it, with the command `servotwin` of this Python."""
    command = folder / "bin" / "servotwin"
    command.parent.mkdir()
    command.write_text(f"#!{sys.executable}\nfrom identification.cli import main\nmain()\n")
    command.chmod(0o755)
    path = {"PATH": f"{command.parent}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        ["bash", "-eo", "pipefail", "-c", script],
        cwd=folder,
        env=os.environ | path | environment,
        check=False,
        capture_output=True,
        text=True,
    )


def inputs(**given: str) -> dict[str, str]:
    """The inputs of the action: those that are given, and their defaults."""
    return {name: given.get(name.replace("-", "_"), one["default"]) for name, one in contents(ACTION)["inputs"].items()}


def test_every_input_of_the_action_is_used_and_there_is_no_other() -> None:
    text = ACTION.read_text()
    assert set(re.findall(r"inputs\.([\w-]+)", text)) == set(contents(ACTION)["inputs"])
    scripts = [step["run"] for step in contents(ACTION)["runs"]["steps"] if "run" in step]
    assert not any("${{" in script for script in scripts)  # what a pull request brings would be run as a script


def test_the_action_installs_what_it_is_of(tmp_path: Path) -> None:
    (step,) = [step for step in contents(ACTION)["runs"]["steps"] if step.get("name") == "Install"]
    assert (ACTION.parent / ".." / ".." / "..").resolve() == ROOT
    script = step["run"].replace("python -m pip", "echo")
    assert (
        shell(script, tmp_path, HERE=str(ACTION.parent), INSTALL="").stdout.split()[-1] == f"{ACTION.parent}/../../.."
    )
    (tmp_path / "again").mkdir()
    again = shell(script, tmp_path / "again", HERE=".", INSTALL="servotwin[mf4]==1.0 -c limits.txt")
    assert again.stdout.split()[-3:] == ["servotwin[mf4]==1.0", "-c", "limits.txt"]


@pytest.mark.slow
@pytest.mark.parametrize(("limit", "code"), [(1.0, 0), (0.1, 1)])
def test_the_action_fails_as_the_suite_does_and_tells_github(limit: float, code: int, tmp_path: Path) -> None:
    scenarios(tmp_path, limit)
    (step,) = [step for step in contents(ACTION)["runs"]["steps"] if step.get("name") == "Test"]
    known = {f"${{{{ inputs.{name} }}}}": value for name, value in inputs(memory_limit="4000").items()}
    environment = {name: known[value] for name, value in step["env"].items()}
    page = tmp_path / "page.md"
    done = shell(step["run"], tmp_path, **environment, GITHUB_STEP_SUMMARY=str(page), GITHUB_WORKSPACE=str(tmp_path))
    assert done.returncode == code, done.stderr
    assert ("::error file=scenarios/swing.yaml,title=run::" in done.stderr) == bool(code)
    assert "of 1 file" in page.read_text()
    assert ET.parse(tmp_path / "out" / "test" / "junit.xml").getroot().get("failures") == str(code)


@pytest.mark.slow
def test_the_template_for_gitlab_leaves_what_it_hands_on(tmp_path: Path) -> None:
    assert servotwin("init", "gitlab-ci", "--out", tmp_path).exit_code == 0
    job = contents(tmp_path / ".gitlab-ci.yml")["scenarios"]
    scenarios(tmp_path, 0.1)
    done = shell("\n".join(job["script"]), tmp_path)
    assert done.returncode == 1, done.stderr
    assert (tmp_path / job["artifacts"]["reports"]["junit"]).is_file()
    assert all((tmp_path / path).is_dir() for path in job["artifacts"]["paths"])
    assert "0 of 1 file" in (tmp_path / "out" / "summary.md").read_text()


def test_the_workflow_for_github_tests_and_keeps_the_reports_whatever_comes(tmp_path: Path) -> None:
    assert servotwin("init", "ci", "--out", tmp_path).exit_code == 0
    steps = contents(tmp_path / ".github/workflows/scenarios.yaml")["jobs"]["scenarios"]["steps"]
    assert any(step.get("run", "").startswith("servotwin test scenarios ") for step in steps)
    assert steps[-1]["if"] == "always()" and steps[-1]["uses"].startswith("actions/upload-artifact@")


@pytest.mark.skipif(sys.platform == "win32", reason="needs pipes")
@pytest.mark.parametrize("option", ["--junit", "--summary"])
def test_a_place_that_cannot_be_written_is_refused_before_the_suite_runs(tmp_path: Path, option: str) -> None:
    scenarios(tmp_path, 1.0)
    os.mkfifo(tmp_path / "pipe")
    for place in (tmp_path, tmp_path / "scenarios" / "swing.yaml" / "below", tmp_path / "pipe"):
        answer = servotwin("test", tmp_path / "scenarios", option, place, "--out", tmp_path / "out")
        assert answer.exit_code == 2
        assert str(place) in answer.stderr
        assert not (tmp_path / "out").exists()
    assert (tmp_path / "pipe").is_fifo()
