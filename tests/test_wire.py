"""The project end to end over real serial lines: rigs, recorders and controllers as processes, then calibration."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from orchestrator.batch.procedure import run_procedure

SCENARIOS = Path(__file__).parents[1] / "scenarios"


def assert_near_the_truth(summary: dict[str, Any]) -> None:
    """Of seven intervals of 95 % rarely all hold, and how well a computer kept its deadlines is different each time."""
    found = {name: each for name, each in summary["parameters"].items() if each.get("truth") is not None}
    half = {name: (each["ci95"][1] - each["ci95"][0]) / 2 for name, each in found.items()}
    off = {name: abs(each["value"] - each["truth"]) / half[name] for name, each in found.items()}
    assert len(off) == 7
    assert sum(distance < 1 for distance in off.values()) >= 4
    assert max(off.values()) < 3


@pytest.mark.slow
def test_what_is_recorded_on_the_bus_calibrates_the_rig_behind_it(tmp_path: Path) -> None:
    done = run_procedure(SCENARIOS / "butterfly" / "bus" / "procedure.yaml", tmp_path / "out")
    assert [case["error"] for case in done["cases"] if not case["passed"]] == []
    summary = json.loads((tmp_path / "out" / "calibrated" / "summary.json").read_text())
    assert_near_the_truth(summary)
    assert json.loads((tmp_path / "out" / "calibrated" / "validation" / "summary.json").read_text())["held"]


@pytest.mark.slow
def test_an_arm_in_one_process_follows_a_controller_in_another(tmp_path: Path) -> None:
    done = run_procedure(SCENARIOS / "flexible_arm" / "bus" / "procedure.yaml", tmp_path / "out")
    assert [case["error"] for case in done["cases"] if not case["passed"]] == []
    manifest = json.loads((tmp_path / "out" / "controller" / "manifest.json").read_text())
    assert manifest["passed"]
