"""Scenarios whose values have other units than their system: converted, refused, and told."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from fmus.errors import WiringError
from orchestrator.crossing import Basis
from orchestrator.scenario.report import report
from orchestrator.scenario.results import document_of
from orchestrator.scenario.run import ScenarioResult, run_scenario
from tests.support.commands import servotwin

SCENARIO = """
title: units
components:
  hand: {{model: pendulum, parameters: {{inertia: 400 g.cm2, angle_start: {start}}}}}
stimuli:
  hand.torque: {stimulus}
run: {{stop: 0.1, step: 0.01}}
record: [hand.torque, hand.angle]
expect: [{expect}]
"""
RECORDING = "time [s],torque [mNm],angle [deg],level [A_rms],count\n0,300,90,1,1\n1,300,90,1,1\n"


def run(
    folder: Path,
    stimulus: str = "{constant: 0}",
    expect: str = "{signal: hand.angle, below: 1 rev}",
    start: str = "90 deg",
    **values: str,
) -> ScenarioResult:
    (folder / "recorded.csv").write_text(RECORDING)
    (folder / "units.yaml").write_text(SCENARIO.format(stimulus=stimulus, expect=expect, start=start))
    return run_scenario(folder / "units.yaml", {f"hand.{name}": value for name, value in values.items()})


def from_file(signal: str, more: str = "") -> str:
    return f"{{file: recorded.csv, signal: {signal}{more}}}"


def test_a_recording_drives_an_input_in_the_unit_of_the_input_and_that_is_told(tmp_path: Path) -> None:
    result = run(tmp_path, from_file("torque"))
    assert result.cases[0].trace["hand.torque"] == pytest.approx(0.3, rel=1e-12)
    (told,) = document_of(result, {}, tmp_path)["units"]
    assert told["text"] == "hand.torque from torque: mNm to N.m, times 0.001"
    report(result).write(tmp_path / "report.html")
    assert told["text"] in (tmp_path / "report.html").read_text()


def test_a_factor_and_an_offset_stand_over_the_unit(tmp_path: Path) -> None:
    result = run(tmp_path, from_file("torque", ", factor: 0.002, offset: -0.1"))
    assert result.cases[0].trace["hand.torque"] == pytest.approx(0.5, rel=1e-12)
    assert [(crossed.basis, crossed.doubtful) for crossed in result.crossings] == [(Basis.GIVEN, True)]


def test_other_quantities_are_refused_and_unknown_units_taken_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(WiringError, match=r"units\.yaml: hand\.torque from angle: deg does not fit N\.m"):
        run(tmp_path, from_file("angle"))
    result = run(tmp_path, from_file("level"))
    assert result.cases[0].trace["hand.torque"] == pytest.approx(1.0)
    assert "hand.torque from level: A_rms is taken for N.m as it is, by factor 1" in caplog.text
    assert not run(tmp_path, from_file("count")).crossings


def test_numbers_whose_units_leave_out_radians_are_told_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    run(tmp_path, expect="{signal: hand.angle, near: 0.1 rev, within: 500 %}", start="157 %")
    assert "expect hand.angle: % is taken for rad times 0.01, radians left out" in caplog.text
    assert caplog.text.count("hand.angle_start: % is taken for rad times 0.01, radians left out") == 1


def test_references_and_numbers_are_compared_in_the_unit_of_the_signal(tmp_path: Path) -> None:
    follows = f"{{signal: hand.angle, reference: {from_file('angle')}, within: 60 deg}}"
    near = "{signal: hand.angle, near: 90 deg, within: 60 deg}"
    above = "{signal: hand.angle, above: 30 deg}"
    texts = [check.text for check in run(tmp_path, expect=", ".join((follows, near, above))).cases[0].checks]
    assert texts == [
        "hand.angle follows angle of recorded.csv within 1.0472 rad",
        "hand.angle is 1.5708 rad within 1.0472 rad",
        "hand.angle stays above 0.523599 rad",
    ]


def test_values_of_parameters_and_overrides_may_have_units(tmp_path: Path) -> None:
    assert run(tmp_path).cases[0].trace["hand.angle"][0] == pytest.approx(math.pi / 2, rel=1e-12)
    over = run(tmp_path, angle_start="100 mrad", inertia="1 kg.m2").cases[0].trace["hand.angle"]
    assert over[0] == pytest.approx(0.1, rel=1e-12)
    with pytest.raises(WiringError, match=r"hand\.inertia: kg does not fit kg\.m2"):
        run(tmp_path, inertia="1 kg")
    with pytest.raises(WiringError, match=r"\.yaml: --set: hand\.inertia: cannot be '1 furlong': 'furlong' is no unit"):
        run(tmp_path, inertia="1 furlong")


def test_the_command_notes_conversions_on_stderr_and_in_its_document(tmp_path: Path) -> None:
    run(tmp_path, from_file("torque"))
    command = f"run {tmp_path}/units.yaml --out {tmp_path}/out --json --set".split()
    answer = servotwin(*command, "hand.inertia=2 kg.m2")
    assert "note: hand.torque from torque: mNm to N.m, times 0.001" in answer.stderr
    (told,) = json.loads(answer.stdout)["units"]
    assert (told["factor"], told["basis"], told["doubtful"]) == (0.001, "units", False)
