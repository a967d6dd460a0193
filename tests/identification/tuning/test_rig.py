"""A design judged on a scenario before it is written back: with its FMU, or with its gains in another controller."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from fmus.errors import InputError
from identification.calibrate import study_without_data
from identification.tuning.summary import TuningSummary
from orchestrator.progress import silent
from tests.support.commands import servotwin
from tests.support.identification.tuning_study import study, write


def rig(folder: Path, at_least: float) -> None:
    """A scenario in which the gain itself is seen: the first command after a step of 1 V."""
    (folder / "rig.yaml").write_text(f"""
title: The first command after a step
components:
  source: {{model: excitation, parameters: {{shape: square, frequency: 0.01, amplitude: 1}}}}
  servo: {{model: pi, parameters: {{sample_time: 0.01, ki: 0, kp: 0.1}}}}
connections: [source.signal -> servo.reference]
run: {{stop: 0.1, step: 0.01}}
expect:
  - {{signal: servo.voltage, after: 0.02, above: {at_least}}}
""")


def tuned(folder: Path, **block: Any) -> TuningSummary:
    judged = [{"scenario": "rig.yaml", "component": "servo", **block}]
    return study_without_data("tune", write(folder, study(judged_on=judged)), folder / "out", silent)  # type: ignore[return-value]


@pytest.mark.slow
@pytest.mark.parametrize("gains_only", [False, True])
def test_a_design_holds_a_scenario_that_the_component_there_does_not(gains_only: bool, tmp_path: Path) -> None:
    rig(tmp_path, at_least=1.0)
    found = tuned(tmp_path, gains_only=gains_only)
    [judged] = found["rigs"]
    assert judged["held"] and judged["scenario"] == "rig.yaml"
    [case] = judged["cases"]
    gain = found["parameters"]["controller.kp"]["value"]
    assert case["checks"][0]["margin"] == pytest.approx(gain - 1, rel=1e-9)
    assert found["verdict"]["held"] and "the case on the rig is held" in found["verdict"]["said"]


@pytest.mark.slow
def test_values_of_the_rig_stand_over_the_files(tmp_path: Path) -> None:
    rig(tmp_path, at_least=1.0)
    found = tuned(tmp_path, set={"source.amplitude": 0.1})
    assert not found["rigs"][0]["held"]


@pytest.mark.slow
def test_the_command_leaves_with_1_where_the_rig_does_not_bear_a_design_out(tmp_path: Path) -> None:
    rig(tmp_path, at_least=1e3)
    judged = [{"scenario": "rig.yaml", "component": "servo"}]
    file = write(tmp_path, study(judged_on=judged))
    left = servotwin("tune", file, "--out", tmp_path / "out")
    assert left.exit_code == 1
    assert "MISSED in 1 of 1 cases on the rig: rig.yaml" in left.stdout
    assert "servo.voltage stays above 1000" in left.stdout


def test_a_component_that_is_not_there_is_refused_before_anything_is_sought(tmp_path: Path) -> None:
    rig(tmp_path, at_least=1.0)
    with pytest.raises(InputError, match=r"judged_on\.0\.component: 'motor' is no component of rig\.yaml; there are"):
        tuned(tmp_path, component="motor")


def test_a_scenario_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"rig\.yaml"):
        tuned(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("gains_only", [False, True])
def test_references_of_the_scenarios_own_controller_do_not_judge_another(gains_only: bool, tmp_path: Path) -> None:
    rig(tmp_path, at_least=0.01)
    file = tmp_path / "rig.yaml"
    file.write_text(f"{file.read_text()}  - {{signal: servo.voltage, reference: accepted, within: 1.0e-6}}\n")
    accepted = servotwin("accept", file, "--out", tmp_path / "accept")
    assert accepted.exit_code == 0, accepted.output
    found = tuned(tmp_path, gains_only=gains_only)
    assert found["verdict"]["held"] and len(found["rigs"][0]["cases"][0]["checks"]) == 1
