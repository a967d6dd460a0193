"""Packages beside servotwin add commands, formats and methods; a broken one costs a warning, none costs nothing."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from identification.study import METHODS

ROOT = Path(__file__).parents[2]
HELLO = '''
import typer
from orchestrator.cli.terminal import Answer, Terminal, command

app = typer.Typer()

@command(app)
def hello(terminal: Terminal, name: str = "rig") -> Answer:
    """Greet a rig."""
    return Answer({"greeted": name}, [f"hello {name}"])
'''
TENFOLD = """
from orchestrator.formats import csv

read = csv.read

def write(trace, file):
    file.write(b"time [s],value\\n")
    file.writelines(f"{time},{10 * value}\\n".encode() for time, value in zip(trace.time, trace["value"]))
"""

MEAN = """
from typing import Literal

from identification.method import Calibrated, Method
from identification.recordings.schema import StudyBlock
from orchestrator.report import Report
from orchestrator.results import versions

class MeanBlock(StudyBlock):
    method: Literal["mean"]
    values: list[float]

def run(study, base, data, progress, isolation):
    return sum(study.values) / len(study.values)

def summary(mean):
    same = {"title": "", "method": "mean", "parameters": {}, "fit": {}, "data": [], "warnings": []}
    return same | {"versions": versions(), "mean": mean}

METHOD = Method(MeanBlock, run, summary, lambda mean: Report("Mean"), lambda mean, folder: Calibrated({}))
"""


def install(folder: Path, entry_points: str, **modules: str) -> Path:
    """A package as pip leaves it: its modules and the folder that says what it adds."""
    information = folder / "rigs-1.0.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: rigs\nVersion: 1.0\n")
    (information / "entry_points.txt").write_text(entry_points)
    for name, text in modules.items():
        (folder / f"{name}.py").write_text(text)
    return folder


def servotwin(beside: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """The command where the package in this folder is installed."""
    return subprocess.run(
        [sys.executable, "-c", "from identification.cli import main; main()", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        cwd=beside,
        env=os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{beside}"},
    )


def test_a_command_of_another_package_is_one_of_ours(tmp_path: Path) -> None:
    rigs = install(tmp_path / "site", "[servotwin.commands]\nhello = rig_commands:app\n", rig_commands=HELLO)
    assert "hello" in servotwin(rigs, "--help").stdout
    said = servotwin(rigs, "hello", "--name", "arm", "--json")
    assert (said.returncode, json.loads(said.stdout), said.stderr) == (0, {"greeted": "arm"}, "")


def test_our_commands_are_not_replaced(tmp_path: Path) -> None:
    rigs = install(tmp_path / "site", "[servotwin.commands]\ninfo = rig_commands:app\n", rig_commands=HELLO)
    assert "What an FMU, an SSP, a trace or a result holds." in servotwin(rigs, "info", "--help").stdout


@pytest.mark.slow
def test_a_format_of_another_package_is_read_and_written(tmp_path: Path) -> None:
    rigs = install(tmp_path / "site", "[servotwin.formats]\nten = rig_format\n", rig_format=TENFOLD)
    (tmp_path / "a.csv").write_text("time [s],value\n0,1\n1,4\n")
    converted = servotwin(rigs, "trace", "convert", tmp_path / "a.csv", tmp_path / "b.ten")
    assert converted.returncode == 0, converted.stderr
    assert (tmp_path / "b.ten").read_text() == "time [s],value\n0.0,10.0\n1.0,40.0\n"
    document = json.loads(servotwin(rigs, "info", tmp_path / "b.ten", "--json").stdout)
    assert [(signal["name"], signal["max"]) for signal in document["signals"]] == [("value", 40.0)]


@pytest.mark.slow
def test_a_method_of_another_package_calibrates_and_is_in_the_schema(tmp_path: Path) -> None:
    rigs = install(tmp_path / "site", "[servotwin.methods]\nmean = rig_method:METHOD\n", rig_method=MEAN)
    (tmp_path / "study.yaml").write_text("title: Some values\nmethod: mean\nvalues: [1, 3]\n")
    done = servotwin(rigs, "calibrate", tmp_path / "study.yaml", "--out", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["mean"] == 2
    schema = json.loads(servotwin(rigs, "schema", "study").stdout)
    assert set(schema["discriminator"]["mapping"]) == {*METHODS, "mean"}


@pytest.mark.parametrize(
    ("module", "problem"),
    [
        ("raise RuntimeError('no licence')", "cannot be imported (RuntimeError: no licence)"),
        ("import sys; sys.exit(3)", "cannot be imported (SystemExit: 3)"),
        ("app = 3", "'broken:app' is nothing for servotwin.commands"),
    ],
)
def test_a_broken_one_is_one_warning_that_names_it(tmp_path: Path, module: str, problem: str) -> None:
    rigs = install(tmp_path / "site", "[servotwin.commands]\nhello = broken:app\n", broken=module)
    said = servotwin(rigs, "--help")
    assert said.returncode == 0 and "calibrate" in said.stdout
    (line,) = said.stderr.splitlines()
    assert "plug-in 'hello' of rigs" in line and problem in line


def test_help_searches_no_packages_where_none_adds_anything() -> None:
    code = "import sys; from identification.cli import main\ntry: main()\nfinally: print(sorted(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code, "--help"],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert "calibrate" in done.stdout
    for heavy in ("importlib.metadata", "rich", "numpy", "pydantic", "sympy"):
        assert f"'{heavy}'" not in done.stdout
