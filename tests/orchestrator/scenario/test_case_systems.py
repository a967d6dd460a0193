"""Cases may have components of their own: each then runs as if its system stood in a file of its own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import ScenarioError, ServotwinError
from orchestrator.scenario.results import write_run
from orchestrator.scenario.run import ScenarioResult, run_scenario
from orchestrator.scenario.schema import load_scenario

PUSHED = {
    "components": {"push": {"model": "excitation", "parameters": {"amplitude": 0.01, "frequency": 1}}},
    "connections": ["push.signal -> hand.torque"],
}
CONTROLLED = {
    "components": {
        "control": {"model": "energy_controller", "parameters": {"gain": 0.02, "sample_time": 0.01}},
        "motor": {"model": "dc_motor"},
    },
    "connections": [
        "hand.angle -> control.angle",
        "hand.speed -> control.speed",
        "control.voltage -> motor.voltage",
        "hand.speed -> motor.speed",
        "motor.torque -> hand.torque",
    ],
}
STARTS = {"low": {"set": {"hand.angle_start": 0.3}}, "high": {"set": {"hand.angle_start": 0.9}}}


def document(**more: Any) -> dict[str, Any]:
    return {
        "title": "t",
        "components": {"hand": {"model": "pendulum"}},
        "run": {"stop": 0.5, "step": 0.01},
        "record": ["hand.angle"],
        "expect": [{"signal": "hand.angle", "below": 3}],
    } | more


def run(folder: Path, name: str = "own", **more: Any) -> ScenarioResult:
    (folder / f"{name}.yaml").write_text(json.dumps(document(**more)))
    return run_scenario(folder / f"{name}.yaml")


AXES = {"controller": {"pushed": PUSHED, "controlled": CONTROLLED}, "start": STARTS}


@pytest.mark.slow
def test_a_matrix_over_controllers_gives_what_a_file_for_each_gives(tmp_path: Path) -> None:
    result = run(tmp_path, matrix={"axes": AXES})
    assert [case.name for case in result.cases] == [
        "pushed, low",
        "pushed, high",
        "controlled, low",
        "controlled, high",
    ]
    assert result.passed
    for number, (variant, start) in enumerate((v, s) for v in (PUSHED, CONTROLLED) for s in STARTS.values()):
        system = {"components": {"hand": {"model": "pendulum"}, **variant["components"]}}  # type: ignore[dict-item]
        single = run(tmp_path, "single", **system, connections=variant["connections"], cases=[{"name": "only"} | start])
        assert np.array_equal(single.cases[0].trace["hand.angle"], result.cases[number].trace["hand.angle"])


@pytest.mark.slow
def test_the_folder_of_results_has_every_case_and_every_fmu(tmp_path: Path) -> None:
    write_run(run(tmp_path, matrix={"axes": AXES}), {}, tmp_path / "out")
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert [case["passed"] for case in manifest["cases"]] == [True] * 4
    assert set(manifest["fmus"]) == {"hand", "push", "control", "motor"}
    assert all((tmp_path / "out" / case["trace"]).is_file() for case in manifest["cases"])


def test_cases_that_share_a_system_are_run_with_one(tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text(json.dumps(document(matrix={"axes": AXES})))
    assert [len(group.cases) for group in load_scenario(tmp_path / "own.yaml").by_system()] == [2, 2]
    (tmp_path / "own.yaml").write_text(json.dumps(document(matrix={"axes": dict(reversed(AXES.items()))})))
    assert [len(group.cases) for group in load_scenario(tmp_path / "own.yaml").by_system()] == [1, 1, 1, 1]


def test_what_is_wrong_with_a_system_of_a_case_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"cases.0.connections.*source -> target"):
        run(tmp_path, cases=[{"name": "a", "connections": ["nothing"]}])
    with pytest.raises(ServotwinError, match="push"):
        run(tmp_path, cases=[{"name": "a", "connections": ["push.signal -> hand.torque"]}])
    can = {"database": "x.dbc", "send": {"A.b": "hand.angle"}}
    with pytest.raises(ScenarioError, match="case a has components of its own, which a scenario with `can` cannot"):
        run(tmp_path, can=can, cases=[{"name": "a", **PUSHED}])
