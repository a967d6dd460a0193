"""Recalibrate, retune, run again: what `scenarios/butterfly/motion/procedure.yaml` does, in one process."""

from __future__ import annotations

from pathlib import Path

import pytest

from identification.calibrate import calibrate
from orchestrator.scenario.results import write_run
from orchestrator.scenario.run import run_scenario
from orchestrator.scenario.schema import load_scenario

SCENARIOS = Path(__file__).parents[3] / "scenarios" / "butterfly" / "motion"
ROUNDS = 4


@pytest.mark.slow
@pytest.mark.shipped
def test_rounds_come_to_a_fixed_point_where_the_orbit_is_the_wanted_one(tmp_path: Path) -> None:
    controller: dict[str, Path] = {}
    off, models = [], []
    for number in range(ROUNDS):
        write_run(run_scenario(load_scenario(SCENARIOS / "rig.yaml", fmus=controller)), {}, tmp_path / f"run_{number}")
        found = calibrate(SCENARIOS / "recalibration.yaml", tmp_path / f"run_{number}")
        folder = found.write(tmp_path / f"model_{number}")
        controller = {"controller": folder / "fmus" / "controller.fmu"}
        off.append(abs(found.summary["orbit"]["off"]))  # type: ignore[typeddict-item]
        models.append({name: found.parameters[name]["value"] for name in found.parameters})
    assert off[0] > 0.15
    assert off[1] < 0.03
    assert off[2] < 0.01
    assert off[3] < 0.005
    assert models[3] == pytest.approx(models[2], rel=5e-3)
