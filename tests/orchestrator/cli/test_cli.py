"""The command line: documents for machines, silence on demand, exit codes, and an end when asked for one."""

from __future__ import annotations

import json
import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from typer.main import get_command

from fmus.packaging import targets
from identification.cli import app
from orchestrator.engine import compiled
from tests.support.commands import only_json, process, servotwin
from tests.support.simulation.swing import write_scenario

pytestmark = pytest.mark.usefixtures("here")


def commands() -> list[list[str]]:
    """Every command, those of groups with their group."""
    top = get_command(app).commands  # type: ignore[attr-defined]
    return [[name] for name in top] + [[name, sub] for name in top for sub in getattr(top[name], "commands", {})]


@pytest.mark.parametrize("command", commands(), ids=" ".join)
def test_every_command_explains_itself(command: list[str]) -> None:
    answer = servotwin(*command, "--help")
    assert answer.exit_code == 0 and answer.stderr == ""
    if not any(other[:-1] == command for other in commands()):  # no group
        assert all(option in answer.stdout for option in ("--json", "--quiet", "--verbose"))


def test_the_commands_that_scripts_depend_on_are_there() -> None:
    assert {" ".join(command) for command in commands()} >= {
        "build",
        "run",
        "calibrate",
        "validate",
        "info",
        "trace info",
        "trace convert",
        "trace plot",
    }


@pytest.mark.parametrize(
    "arguments", [["--frobnicate"], ["run", "--frobnicate"], ["frobnicate"], ["run"], ["validate", "x"]]
)
def test_a_command_line_that_is_none_has_exit_code_2(arguments: list[str]) -> None:
    answer = servotwin(*arguments)
    assert answer.exit_code == 2 and answer.stdout == "" and "Traceback" not in answer.stderr


def test_the_version_is_one_line_and_with_v_what_a_report_of_a_fault_needs() -> None:
    assert servotwin("--version").stdout == f"servotwin {version('servotwin')}\n"
    answer = servotwin("--version", "-v")
    told = dict(line.split(": ", 1) for line in answer.stdout.splitlines())
    assert answer.exit_code == 0 and answer.stderr == ""
    assert set(told) >= {
        "servotwin",
        "Python",
        "platform",
        "compiler",
        "stepping loop",
        "cache of FMUs",
        "numpy",
        "fmpy",
        "typer",
    }
    assert told["numpy"] == np.__version__ and told["Python"].startswith(platform.python_version())
    assert told["stepping loop"].startswith("compiled") == compiled.available()


def test_the_only_option_before_a_command_is_version() -> None:
    for arguments in (["-v"], ["-v", "info", "x"]):
        answer = servotwin(*arguments)
        assert answer.exit_code == 2 and "-v goes after it" in answer.stderr


def test_build_makes_valid_fmus_and_names_them(tmp_path: Path) -> None:
    document = only_json(servotwin("build", "pendulum", "daq", "--target", "python", "--out", tmp_path / "f", "--json"))
    assert set(document["fmus"]) == {"pendulum", "daq"} and document["target"] == "python"
    for file in document["fmus"].values():
        assert validate_fmu(file) == []


def test_build_refuses_a_model_that_is_not_there_with_those_there_are(tmp_path: Path) -> None:
    answer = servotwin("build", "pendulom", "--out", tmp_path / "f")
    assert answer.exit_code == 2 and "model 'pendulom': is not in the library; choose one of" in answer.stderr
    assert "pendulum" in answer.stderr and not (tmp_path / "f").exists()


def test_square_brackets_are_shown_as_they_are(tmp_path: Path) -> None:
    """They stand in units and paths, and would be markup to the library that prints."""
    folder = tmp_path / "[" / "bold] [red]"
    folder.mkdir(parents=True)
    scenario = write_scenario(folder, title="[/i] in [rad]")
    answer = servotwin("run", scenario, "--out", folder / "out")
    assert answer.exit_code == 0, answer.stderr
    assert "[/i] in [rad]" in answer.stdout and f"results in {folder / 'out'}" in answer.stdout
    answer = servotwin("run", folder / "none[red].yaml")
    assert answer.exit_code == 2 and "none[red].yaml: no such file" in answer.stderr
    assert (
        "virtual:a:"
        in servotwin(
            "can", "replay", folder / "no.log", "--interface", "virtual", "--channel", "a", "--data-bitrate", 1
        ).stderr
    )


def test_a_terminal_obeys_no_name_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time [s],\x1b[31mred\x1b]0;own\x07\x9b2J\u202etxt [V]\n0,1\n1,2\n")
    told = servotwin("info", tmp_path / "a.csv").stdout
    assert "\\x1b[31mred\\x1b]0;own\\x07\\x9b2J\\u202etxt" in told
    refused = servotwin("trace", "convert", tmp_path / "a.csv", tmp_path / "\x1b[2J.xyz").stderr
    assert not {"\x1b", "\x07", "\x9b", "\u202e"} & {*told, *refused} and len(refused.splitlines()) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="needs pipes with names")
@pytest.mark.parametrize("name", ["a.csv", "a.yaml", "a.fmu", "a.blf", "a.log", "a.mat", "a.parquet"])
def test_a_pipe_is_no_file(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    for command in (["info"], ["run"], ["calibrate"], ["trace", "info"], ["trace", "plot"]):
        answer = servotwin(*command, tmp_path / name)
        assert answer.exit_code == 2 and len(answer.stderr.splitlines()) == 1, answer.stderr


def test_what_nobody_foresaw_is_one_line_and_a_code_of_its_own(scenario: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise KeyError("no such thing")

    monkeypatch.setattr("orchestrator.scenario.run.run_scenario", broken)
    answer = servotwin("run", scenario)
    assert answer.exit_code == 4 and answer.stdout == ""
    assert answer.stderr == (
        "servotwin: a fault of servotwin: KeyError: 'no such thing'; run with -vv and report what that says\n"
    )
    assert "Traceback" in servotwin("run", scenario, "-vv").stderr


def test_a_place_that_cannot_be_written_is_one_line(scenario: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    answer = servotwin("run", scenario, "--out", tmp_path / "file" / "out")
    assert answer.exit_code == 2 and "Traceback" not in answer.stderr and len(answer.stderr.splitlines()) == 1


CHATTY = '''"""Prints whenever it is asked, from Python and from the C library."""
import ctypes
from .model import Model, State, output, parameter

def derivatives(t, x, u, p):
    print("here I am")
    ctypes.CDLL(None).puts(b"and here, too")
    return {"y": p.rate}

MODEL = Model("chatty", "Chatty", (output("y", "1", "Output"), parameter("rate", "1/s", 1.0, "Rate")),
              states=(State("y"),), derivatives=derivatives, solver_step=lambda p: 0.1)
'''


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="calls the C library by its POSIX name")
def test_what_fmus_print_does_not_mix_with_the_document(tmp_path: Path) -> None:
    (tmp_path / "chatty.py").write_text(CHATTY)
    targets.build(tmp_path / "chatty.py", tmp_path / "chatty.fmu", target="python")
    scenario = write_scenario(tmp_path, components={"c": {"fmu": "chatty.fmu"}}, expect=[])
    stdout, stderr = process("run", scenario, "--out", tmp_path / "out", "--json").communicate(timeout=60)
    assert json.loads(stdout)["passed"] is True
    assert "here I am" in stderr and "and here, too" in stderr
