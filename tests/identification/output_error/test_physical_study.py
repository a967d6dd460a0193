"""The physical parameters of the flexible arm, found again from its closed-loop records by output error."""

from __future__ import annotations

from pathlib import Path

import pytest

from identification.calibrate import calibrate_study
from identification.output_error import calibration
from identification.results import covariance_in, read_summary
from orchestrator.scenario.results import write_run
from orchestrator.scenario.run import run_scenario

SCENARIOS = Path(__file__).parents[3] / "scenarios" / "flexible_arm"


@pytest.fixture
def records(tmp_path: Path) -> Path:
    """Folder with the closed-loop experiments, of which the study takes three."""
    write_run(run_scenario(SCENARIOS / "closed_loop.yaml"), {}, tmp_path / "records")
    return tmp_path / "records"


@pytest.mark.slow
def test_hub_stiffness_payload_friction_and_drive_lie_inside_narrow_intervals_as_sweeps_draw_them(
    records: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calibration, "processors", lambda: 1)
    document = calibrate_study(SCENARIOS / "physical.yaml", records, tmp_path / "out", lambda fraction, remark: None)
    assert len(document["parameters"]) == 5
    for name, entry in document["parameters"].items():
        low, high = entry["ci95"]
        assert low <= entry["truth"] <= high, name
        assert high - low < 0.03 * entry["truth"], name
        assert abs(entry["start"] / entry["truth"] - 1) > 0.2, name
    assert document["fit"]["validation"]["median"] > 0.9
    kept = read_summary(SCENARIOS / "calibrated" / "arm")
    for name, entry in kept["parameters"].items():
        assert entry["value"] == pytest.approx(document["parameters"][name]["value"], rel=1e-4), name
    found, covariance = covariance_in(tmp_path / "out"), covariance_in(SCENARIOS / "calibrated" / "arm")
    assert found is not None and covariance is not None and found[0] == covariance[0]
    assert covariance[1] == pytest.approx(found[1], rel=0.02)
