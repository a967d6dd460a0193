"""The project end to end over real serial lines: rigs, recorders and controllers as processes, then calibration."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.batch.procedure import run_procedure

SCENARIOS = Path(__file__).parents[1] / "scenarios"


def assert_near_the_truth(summary: dict[str, Any]) -> None:
    """How far off the estimates are in halves of their 95 % intervals: by root mean square, and the worst of them.

    Errors as the intervals have them exceed an rms of 1 once in 3,000 times; the rest is room for late deadlines.
    """
    found = [entry for entry in summary["parameters"].values() if entry.get("truth") is not None]
    off = [2 * abs(entry["value"] - entry["truth"]) / (entry["ci95"][1] - entry["ci95"][0]) for entry in found]
    assert len(off) == 7
    assert np.sqrt(np.mean(np.square(off))) < 1.5, off
    assert max(off) < 3, off


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
