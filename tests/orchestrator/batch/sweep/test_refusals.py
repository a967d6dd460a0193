"""What cannot be run is told before anything runs, with its place and what to do."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from fmus.errors import ServotwinError
from orchestrator.batch.sweep.sweep import sweep
from tests.support.commands import servotwin
from tests.support.sweeping import DRAWN as VARIED
from tests.support.sweeping import FALLING, Here, study

DRAWN = {"by": "monte-carlo", "samples": 5, "seed": 1}
MANY = {"between": [0.1, 0.2], "count": 10_000}
NORMAL = {"normal": 0.1, "std": 0.01}
WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "too many points": (
        {
            "vary": {
                f"hand.{n}": {"between": [0.1, 0.2], "count": 10_000} for n in ("inertia", "added_mass", "added_length")
            },
            "design": {"by": "grid"},
        },
        r"study\.yaml: design: asks for 1,000,000,000,000 runs, .*; 100,000,000 are the most; take fewer levels",
    ),
    "an unknown name": (
        {"vary": {"hand.added_mas": {"between": [0.1, 0.2]}}, "design": DRAWN},
        r"study\.yaml: vary\.hand\.added_mas: no variable 'added_mas' in 'hand'; .*added_mass",
    ),
    "another quantity": (
        {"vary": {"hand.added_mass": {"between": ["1 m", "2 m"]}}, "design": DRAWN},
        r"study\.yaml: vary\.hand\.added_mass: .*m .*kg",
    ),
    "outside the bounds": (
        {"vary": {"hand.added_mass": {"between": [-0.1, 0.2]}}, "design": DRAWN},
        r"study\.yaml: vary\.hand\.added_mass: is -0\.1, outside its bounds",
    ),
    "no logarithm": (
        {"vary": {"hand.added_mass": {"between": [0, 0.2], "scale": "log"}}, "design": DRAWN},
        r"vary\.hand\.added_mass: has no logarithm at 0; begin above 0",
    ),
    "a grid without a count": (
        {"vary": {"hand.added_mass": {"between": [0.1, 0.2]}}, "design": {"by": "grid"}},
        r"study\.yaml:\d+: `vary\.hand\.added_mass` needs `count` in a grid$",
    ),
    "no interval": (
        {"vary": {"hand.added_mass": {"between": [0.3, 0.2]}}, "design": DRAWN},
        r"vary\.hand\.added_mass: `between` 0\.3 and 0\.2 is no interval",
    ),
    "no spread": (
        {"vary": {"hand.added_mass": {"normal": 0.3, "std": 0}}, "design": DRAWN},
        r"vary\.hand\.added_mass: has a standard deviation of 0",
    ),
    "no such scenario": ({"sweep": "rising.yaml"}, r"rising\.yaml: no such file"),
    "no such case": ({"cases": ["walk"]}, r"study\.yaml: cases: there is no case 'walk'"),
    "no noise": ({"noise": ["hand"]}, r"study\.yaml: noise: hand: no variable 'seed' in 'hand'; name components"),
    "no power of two": (
        {"design": {"by": "sobol-indices", "samples": 100, "seed": 1}},
        r"design\.samples: 100 is no power of two; give 128",
    ),
    "no ends": (
        {
            "vary": {"hand.added_mass": {"normal": 0.1, "std": 0.01}},
            "design": {"by": "morris", "trajectories": 4, "seed": 1},
        },
        r"vary\.hand\.added_mass: has no ends, .*give it `between`",
    ),
    "between steps": (
        {"traces": {"signals": ["hand.angle"], "every": 0.015}},
        r"study\.yaml: traces\.every: ",
    ),
    "no such signal": ({"traces": {"signals": ["hand.angel"]}}, r"traces\.signals: hand\.angel: .*angle"),
    "points that differ": (
        {"vary": None, "design": {"by": "list", "points": [{"hand.added_mass": 0.1}, {"hand.added_length": 0.1}]}},
        r"design\.points\.1: has hand\.added_length, not hand\.added_mass as the first",
    ),
    "a measure with the name of a column": (
        {"measures": {"passed": {"signal": "hand.angle", "peak": {"at_most": 9}}}},
        r"study\.yaml: measures\.passed: would be 2 columns of the rows; give the measure another name",
    ),
    "a measure with the name of an expectation's verdict": (
        {"measures": {"e1_held": {"signal": "hand.angle", "peak": {"at_most": 9}}}},
        r"study\.yaml: measures\.e1_held: would be 2 columns",
    ),
    "a trace of what varies": (
        {
            "vary": {"hand.torque": {"between": [0.0, 0.01]}},
            "design": DRAWN,
            "traces": {"signals": ["hand.torque", "hand.angle"]},
        },
        r"study\.yaml: hand\.torque: would be 2 columns of the rows; .*ask for it once",
    ),
    "a grid of draws": (
        {"vary": {"hand.added_mass": {"normal": 0.1, "std": 0.01}}, "design": {"by": "grid"}},
        r"study\.yaml:1: .*is drawn, which a grid does not do",
    ),
    "no covariance": (
        {"calibration": {"folder": "none"}},
        r"none/summary\.json: is not there; give the folder of a calibration",
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_study_that_cannot_be_run_is_told_and_leaves_nothing(what: str, tmp_path: Path) -> None:
    changes, problem = WRONG[what]
    with pytest.raises(ServotwinError, match=problem):
        sweep(study(tmp_path, **changes), tmp_path / "out", Here())
    assert not (tmp_path / "out").exists()


TWO: dict[str, Any] = FALLING | {
    "components": {**FALLING["components"], "other": {"model": "pendulum", "parameters": {"angle_start": 0.5}}},  # type: ignore[dict-item]
    "stimuli": {"hand.torque": {"constant": 0}, "other.torque": {"constant": 0}},
}
OTHER: dict[str, Any] = {"vary": {"other.added_mass": [0.1, 0.2]}, "design": {"by": "grid"}, "traces": None}


def test_files_of_one_name_in_two_folders_are_told_apart(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "x.csv").write_text("time,torque\n0,0\n1,0.01\n")
    vary = {"hand.torque": {"files": ["a/x.csv", "b/x.csv"], "signal": "torque"}}
    file = study(tmp_path, vary=vary, design={"by": "grid"})
    sweep(file, tmp_path / "out", Here())
    (tmp_path / "a" / "x.csv").write_text("time,torque\n0,0\n1,0.02\n")
    with pytest.raises(ServotwinError, match=r"holds another study: .*a/x\.csv"):
        sweep(file, tmp_path / "out", Here())


def test_what_nothing_can_see_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ServotwinError, match=r"other\.added_mass: no expectation, measure or trace can see it"):
        sweep(study(tmp_path, TWO, **OTHER), tmp_path / "out", Here())


def test_what_the_system_of_one_case_can_see_is_varied_in_all(tmp_path: Path) -> None:
    looked_at = {"signal": "other.speed", "peak": {"at_most": 4.0}}
    seen = {"name": "seen", "components": {"hand": FALLING["components"]["hand"]}, "expect": [looked_at]}  # type: ignore[index]
    found = sweep(study(tmp_path, TWO | {"cases": [{"name": "not"}, seen]}, **OTHER), tmp_path / "out", Here())
    assert found.document["runs"] == 4 and found.document["failed"] == 0


@pytest.mark.parametrize("of_one", [["--run", "3"], ["--scheduler", "tcp://127.0.0.1:1"]])
@pytest.mark.parametrize("option", ["--jobs", "--time-limit", "--memory-limit"])
def test_an_option_that_nothing_would_keep_is_refused(of_one: list[str], option: str, tmp_path: Path) -> None:
    answer = servotwin("sweep", str(study(tmp_path)), "--out", str(tmp_path / "out"), option, "2", *of_one)
    assert answer.exit_code == 2 and f"{option}: is " in answer.stderr and "leave" in answer.stderr
    assert not (tmp_path / "out").exists()


def test_a_disk_that_is_full_is_told_and_what_was_done_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, real, left = study(tmp_path), Path.open, [4]

    def full(path: Path, mode: str = "r", *args: Any, **kwargs: Any) -> Any:
        if mode == "xb" and "pending" in str(path):
            left[0] -= 1
            if left[0] < 0:
                raise OSError(28, "No space left on device", str(path))
        return real(path, mode, *args, **kwargs)

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(ServotwinError, match=r"pending/.*cannot be written \(No space left on device\)"):
        sweep(file, tmp_path / "out", Here())
    left[0] = 1 << 30
    runs: list[int] = []
    sweep(file, tmp_path / "out", Here(told=lambda task: runs.extend(task.runs.tolist())))
    lines = [json.loads(line) for line in (tmp_path / "out" / "manifest.jsonl").read_text().splitlines()]
    stretches = [one for line in lines for one in line.get("runs", [])]
    assert 0 < len(runs) < 20 and sum(last - first + 1 for first, last in stretches) == 20


def test_values_that_no_point_varies_are_checked_before_any_runs(tmp_path: Path) -> None:
    """What would fail at all points is bad input; of what is varied the scenario's own value plays no part."""
    path = study(tmp_path, VARIED)
    falling = {**FALLING, "parameters": "list.csv"}
    (tmp_path / "falling.yaml").write_text(json.dumps(falling))
    (tmp_path / "list.csv").write_text("name,value\nhand.added_mass,-1\nhand.inertia,-1\n")
    with pytest.raises(ServotwinError, match=r"falling\.yaml: .*list\.csv:3: hand\.inertia: is -1, outside its"):
        sweep(path, tmp_path / "out", Here())
    assert not (tmp_path / "out").exists()
    (tmp_path / "list.csv").write_text("name,value\nhand.added_mass,-1\n")
    assert sweep(path, tmp_path / "out", Here()).document["failed"] == 0
