"""The command `run`: its answer and its folder, values given over the file, what it never replaces."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from orchestrator import formats
from tests.support.commands import only_json, servotwin
from tests.support.simulation.swing import SCENARIO, write_scenario

pytestmark = pytest.mark.usefixtures("here")


def test_run_answers_with_what_its_folder_holds(scenario: Path, tmp_path: Path) -> None:
    document = only_json(servotwin("run", scenario, "--out", tmp_path / "out", "--json"))
    assert document == json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert document["passed"] and document["cases"][0]["checks"][0]["held"]


def test_run_has_exit_code_1_when_an_expectation_fails_and_still_leaves_its_folder(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, expect=[{"signal": "hand.angle", "below": 0.4}])
    assert only_json(servotwin("run", scenario, "--out", tmp_path / "out", "--json"), code=1)["passed"] is False
    answer = servotwin("run", scenario, "--out", tmp_path / "out")
    assert answer.exit_code == 1 and "NO" in answer.stdout and "largest 0.5 rad" in answer.stdout
    assert (tmp_path / "out" / "run.parquet").is_file()


def test_set_goes_over_the_file(scenario: Path, tmp_path: Path) -> None:
    answer = servotwin(
        "run",
        scenario,
        "--out",
        tmp_path / "out",
        "--set",
        "hand.angle_start=0.25",
        "--set",
        "hand.inertia=4e-3",
        "--json",
    )
    assert only_json(answer)["overrides"] == {"hand.angle_start": 0.25, "hand.inertia": 0.004}
    assert formats.read(tmp_path / "out" / "run.parquet").trace["hand.angle"][0] == 0.25


@pytest.mark.parametrize(
    ("override", "problem"),
    [
        ("hand.angel_start=1", "no variable 'angel_start' in 'hand'; did you mean 'angle_start'?"),
        ("hnad.angle_start=1", "no component 'hnad'; did you mean 'hand'?"),
        ("hand.inertia=-1", "hand.inertia: is -1, outside its bounds [0, inf)"),
        ("hand.inertia=nan", "hand.inertia: is nan; give a finite number"),
        ("hand.angle_start", "--set hand.angle_start: has no value; write component.variable=value"),
        ("hand.angle=1", "hand.angle: is an output and cannot be set"),
    ],
)
def test_a_set_that_does_not_fit_is_refused_in_one_line(
    scenario: Path, tmp_path: Path, override: str, problem: str
) -> None:
    answer = servotwin("run", scenario, "--out", tmp_path / "out", "--set", override, "--json")
    failed = json.loads(answer.stdout)["error"]
    assert answer.exit_code == failed["exit_code"] == 2 and set(failed) == {"place", "problem", "fix", "exit_code"}
    (line,) = answer.stderr.splitlines()
    assert problem in line and not (tmp_path / "out").exists()


def test_a_variable_that_is_set_twice_is_refused(scenario: Path, tmp_path: Path) -> None:
    both = ("--set", "hand.inertia=4e-3", "--set", "hand.inertia=5e-3")
    answer = servotwin("run", scenario, "--out", tmp_path / "out", *both)
    problem = "--set hand.inertia=5e-3: is the second --set of 'hand.inertia'; leave out one of them"
    assert answer.exit_code == 2 and problem in answer.stderr


@pytest.mark.slow
def test_running_twice_gives_the_same_bytes_in_every_trace(tmp_path: Path) -> None:
    cases = [{"name": "low"}, {"name": "high", "set": {"hand.angle_start": 0.55}}]
    drive = {"drive": {"model": "excitation", "parameters": {"shape": "random", "seed": 4, "amplitude": 0.01}}}
    scenario = write_scenario(
        tmp_path, cases=cases, components=SCENARIO["components"] | drive, connections=["drive.signal -> hand.torque"]
    )
    for name in ("one", "two"):
        assert servotwin("run", scenario, "--out", tmp_path / name, "-q").exit_code in (0, 1)
    for name in ("low.parquet", "high.parquet"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    assert np.ptp(formats.read(tmp_path / "one" / "low.parquet").trace["drive.signal"]) > 0


def test_verbose_shows_whose_time_it_was_over_all_cases(tmp_path: Path) -> None:
    scenario = write_scenario(tmp_path, cases=[{"name": "one"}, {"name": "two"}])
    answer = servotwin("run", scenario, "--out", tmp_path / "out", "-v", "--stride", "5")
    rows = {line.split("│")[1].strip(): line.split("│") for line in answer.stdout.splitlines() if line.count("│") == 6}
    assert rows["hand"][2].strip() == rows["(the loop itself)"][2].strip() == "40"
    assert float(rows["hand"][5]) + float(rows["(the loop itself)"][5]) == pytest.approx(100, abs=0.11)
    assert "40 steps of 0.01 s in " in answer.stdout and "recorded every 5 steps" in answer.stdout


def test_results_never_replace_what_is_no_result(scenario: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "precious.txt").write_text("mine")
    answer = servotwin("run", scenario, "--out", tmp_path / "out")
    assert answer.exit_code == 2 and "is not empty and holds no result; give another --out" in answer.stderr
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["precious.txt"]
    assert servotwin("run", scenario, "--out", tmp_path / "out", "--force").exit_code == 0
    (tmp_path / "out" / "notes.txt").write_text("mine")
    answer = servotwin("run", scenario, "--out", tmp_path / "out")
    assert answer.exit_code == 2 and "holds notes.txt, which no command of ours wrote" in answer.stderr
    answer = servotwin("run", scenario, "--out", tmp_path, "--force")
    assert answer.exit_code == 2 and "is or contains the working folder; give another --out" in answer.stderr
    assert scenario.is_file() and (tmp_path / "out" / "notes.txt").is_file()


def test_results_go_to_out_by_default(scenario: Path, tmp_path: Path) -> None:
    assert servotwin("run", scenario, "-q").exit_code == 0
    assert (tmp_path / "out" / "swing" / "manifest.json").is_file()
