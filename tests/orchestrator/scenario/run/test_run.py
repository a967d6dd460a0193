"""Scenarios: the files of the project hold; cases, stimuli, references and refusals that are expected."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fmus.errors import FmuError, ScenarioError, WiringError
from orchestrator import formats
from orchestrator.scenario.run import run_scenario
from orchestrator.trace import Trace
from tests.support.simulation.falling import FALLING, refused, run, trace_of
from tests.support.simulation.shipped import JUDGED, named

pytestmark = pytest.mark.usefixtures("scratch")


@pytest.mark.slow
@pytest.mark.parametrize("path", JUDGED, ids=named)
def test_the_scenarios_of_the_project_hold(path: Path) -> None:
    result = run_scenario(path)
    failed = [(case.name, check) for case in result.cases for check in case.checks if not check.held]
    assert failed == []
    assert result.passed


def test_one_case_runs_where_none_is_given_and_passes_without_expectations(tmp_path: Path) -> None:
    result = run(tmp_path, FALLING)
    assert [case.name for case in result.cases] == ["run"]
    assert result.passed
    assert trace_of(result).names == ("hand.angle", "hand.speed", "hand.acceleration", "hand.energy")
    assert trace_of(result).unit("hand.angle") == "rad"


def test_energy_is_conserved_without_friction(tmp_path: Path) -> None:
    trace = trace_of(run(tmp_path, FALLING, hand__angle_start=1.0))
    assert np.ptp(trace["hand.energy"]) < 1e-7 * trace["hand.energy"][0]
    assert np.ptp(trace["hand.angle"]) > 1.0


def test_cases_override_the_file_and_the_command_line_overrides_both(tmp_path: Path) -> None:
    text = FALLING + "cases: [{name: a}, {name: b, set: {hand.angle_start: 0.2, hand.speed_start: 0.1}}]"
    plain = run(tmp_path, text)
    assert [trace_of(plain, i)["hand.angle"][0] for i in (0, 1)] == [0.0, 0.2]
    over = run(tmp_path, text, hand__angle_start=0.3)
    assert [trace_of(over, i)["hand.angle"][0] for i in (0, 1)] == [0.3, 0.3]
    assert [trace_of(over, i)["hand.speed"][0] for i in (0, 1)] == [0.0, 0.1]


def test_the_order_of_cases_does_not_matter_by_one_bit(tmp_path: Path) -> None:
    cases = [
        "{name: a, set: {hand.angle_start: 0.2}}",
        "{name: b, set: {hand.inertia: 0.1, hand.gravity_torque: 1}}",
        "{name: c, set: {hand.speed_start: 5}}",
    ]
    there = run(tmp_path, FALLING + f"cases: [{', '.join(cases)}]")
    back = run(tmp_path, FALLING + f"cases: [{', '.join(cases[::-1])}]")
    for number in range(3):
        one, other = trace_of(there, number), trace_of(back, 2 - number)
        assert all(np.array_equal(one[name], other[name]) for name in one.names)


NOISY = """
title: noise
components:
  meter: {model: daq, parameters: {noise: 1.0, seed: 3, sample_time: 0.1}}
stimuli: {meter.signal: {constant: 0.0}}
run: {stop: 1, step: 0.1}
cases: [{name: a}, {name: b}, {name: c, set: {meter.seed: 3}}]
"""


def test_cases_have_the_same_noise_unless_each_is_to_draw_its_own(tmp_path: Path) -> None:
    same = [trace_of(run(tmp_path, NOISY), i)["meter.measured"] for i in range(3)]
    own = [trace_of(run(tmp_path, NOISY + "own_noise: true"), i)["meter.measured"] for i in range(3)]
    assert np.array_equal(same[0], same[1])
    assert np.array_equal(own[0], same[0])
    assert not np.any(own[1][1:] == own[0][1:])
    assert np.array_equal(own[2], own[0])  # the case sets its seed


def test_a_case_that_fails_its_expectation_fails_the_scenario_and_says_by_how_much(tmp_path: Path) -> None:
    result = run(
        tmp_path,
        FALLING
        + """
expect: [{signal: hand.energy, below: 1}]
cases:
  - {name: a, expect: [{signal: hand.angle, below: 0.1}]}
  - {name: b, set: {hand.angle_start: 0.5}, expect: [{signal: hand.angle, below: 0.1}]}
""",
    )
    assert [case.passed for case in result.cases] == [True, False]
    assert not result.passed
    check = result.cases[1].checks[1]
    assert (check.text, check.held, check.found) == ("hand.angle stays below 0.1 rad", False, "largest 0.5 rad")


def test_what_is_recorded_is_what_was_asked_for_and_what_is_looked_at(tmp_path: Path) -> None:
    result = run(
        tmp_path,
        FALLING
        + """
  # a stimulated input can be recorded, too
stimuli: {hand.torque: {constant: 0.01}}
record: [hand.torque, hand.speed]
expect: [{signal: hand.angle, above: -1}, {signal: hand.speed, above: -1}]
""",
    )
    assert trace_of(result).names == ("hand.torque", "hand.speed", "hand.angle")
    assert set(trace_of(result)["hand.torque"]) == {0.01}


def test_an_expectation_may_look_at_an_input_that_is_not_recorded_by_default(tmp_path: Path) -> None:
    stimuli = "stimuli: {hand.torque: {constant: 0.01}}\nexpect: [{signal: hand.torque, near: 0.01, within: 0}]"
    assert run(tmp_path, FALLING + stimuli).passed


@pytest.mark.parametrize("interpolation", ["linear", "hold"])
def test_a_recording_drives_an_input(tmp_path: Path, interpolation: str) -> None:
    time, values = np.array([0.0, 0.35, 1.0]), np.array([0.0, 0.7, -0.6])
    formats.write(Trace(time, {"torque": values}), tmp_path / "torque.csv")
    stimulus = f"{{file: torque.csv, signal: torque, interpolation: {interpolation}}}"
    text = FALLING.replace("0.01}", "0.05}") + f"stimuli: {{hand.torque: {stimulus}}}\nrecord: [hand.torque]"
    trace = trace_of(run(tmp_path, text))
    if interpolation == "linear":
        expected = np.interp(trace.time, time, values)
    else:
        expected = np.where(trace.time < 0.35, 0.0, np.where(trace.time < 1.0, 0.7, -0.6))
    assert trace["hand.torque"] == pytest.approx(expected, abs=1e-12)


def test_a_recording_that_ends_too_early_is_refused_or_held_where_that_is_said(tmp_path: Path) -> None:
    formats.write(Trace(np.array([0.0, 0.5]), {"torque": np.array([0.0, 0.1])}), tmp_path / "short.csv")
    stimulus = FALLING + "stimuli: {hand.torque: {file: short.csv, signal: torque, ends: hold}}"
    with pytest.raises(
        WiringError, match=r"yaml:6: stimuli\.hand\.torque: .*short\.csv covers 0 to 0\.5 s, not 0 to 1 s"
    ):
        run(tmp_path, stimulus.replace(", ends: hold", ""))
    result = run(tmp_path, stimulus + "\nrecord: [hand.torque]")
    assert trace_of(result)["hand.torque"][-1] == 0.1
    assert result.scenario.held == ["hand.torque keeps its last value from 0.5 s on"]


def test_a_gap_that_a_stimulus_is_used_across_is_told_with_where_it_is(tmp_path: Path) -> None:
    time = np.concatenate([np.arange(0, 0.2, 1e-3), np.arange(0.7, 1.0005, 1e-3)])
    formats.write(Trace(time, {"torque": np.zeros(len(time))}), tmp_path / "gap.csv")
    assert [str(mark) for mark in formats.read(tmp_path / "gap.csv").marks] == ["gap from 0.199 to 0.7 s"]
    result = run(tmp_path, FALLING + "stimuli: {hand.torque: {file: gap.csv, signal: torque}}")
    assert "gap.csv: is used across gap from 0.199 to 0.7 s" in result.scenario.notes


def test_a_reference_that_ends_too_early_is_refused_before_the_run(tmp_path: Path) -> None:
    formats.write(Trace(np.array([0.0, 0.5]), {"angle": np.zeros(2)}), tmp_path / "short.csv")
    expect = "expect: [{signal: hand.angle, reference: {file: short.csv, signal: angle}, within: 9}]"
    with pytest.raises(ScenarioError, match=r"angle of short\.csv covers 0 to 0\.5 s, not 0 to 1 s; .* `before`"):
        run(tmp_path, FALLING + expect)
    assert run(tmp_path, FALLING + expect.replace("within", "before: 0.5, within")).passed


def test_a_reference_is_found_beside_the_scenario(tmp_path: Path) -> None:
    formats.write(trace_of(run(tmp_path, FALLING, hand__speed_start=1.0)), tmp_path / "reference.csv")
    expect = "expect: [{signal: hand.angle, reference: {file: reference.csv, signal: hand.angle}, within: 1.0e-12}]"
    assert run(tmp_path, FALLING + expect, hand__speed_start=1.0).passed
    assert not run(tmp_path, FALLING + expect, hand__speed_start=1.1).passed


CONTROLLED = """
title: Control that refuses
components:
  controller: {model: energy_controller}
connections: []
run: {stop: 0.1, step: 0.005}
"""


def test_a_refusal_that_is_expected_passes_and_the_next_case_runs(tmp_path: Path) -> None:
    result = run(
        tmp_path,
        CONTROLLED
        + """
cases:
  - {name: refused, expect: [{refused: downward equilibrium}]}
  - {name: wrong reason, expect: [{refused: upright}]}
  - {name: goes through, set: {controller.speed: 1.0}, expect: [{refused: downward equilibrium}]}
  - {name: runs, set: {controller.speed: 1.0}, expect: [{signal: controller.voltage, above: -1e3}]}
""",
    )
    assert [case.passed for case in result.cases] == [True, False, False, True]
    assert result.cases[2].checks[0].found == "the run went through"
    assert isinstance(result.cases[0].error, FmuError)


def test_a_refusal_nobody_expects_is_an_error_that_names_the_case(tmp_path: Path) -> None:
    text = CONTROLLED + "cases: [{name: one, set: {controller.speed: 1.0}}, {name: two}]"
    line = refused(tmp_path, text, FmuError)
    assert "case two: controller: step from t = 0 s by 0.005 s: " in line
    assert "start energy is that of the downward equilibrium" in line


def test_values_out_of_bounds_can_be_expected_to_be_refused(tmp_path: Path) -> None:
    expect = "expect: [{refused: outside its bounds}]"
    assert run(tmp_path, FALLING + expect, hand__added_mass=-1.0).passed


@pytest.mark.slow
def test_two_rates_and_jacobi_can_be_asked_for(tmp_path: Path) -> None:
    text = """
title: A sine on a motor
components:
  drive: {model: excitation, parameters: {shape: sine, amplitude: 0.01}, step: 1/50}
  motor: {model: dc_motor, parameters: {torque_gain: 2.48}}
  hand: {model: pendulum, step: 1/200}
connections: [drive.signal -> motor.voltage, hand.speed -> motor.speed, motor.torque -> hand.torque]
run: {stop: 1, step: 0.01, order: ORDER}
"""
    fine, rough = (trace_of(run(tmp_path, text.replace("ORDER", order))) for order in ("gauss-seidel", "jacobi"))
    assert fine.time[-1] == rough.time[-1] == 1.0
    difference = np.abs(fine["hand.angle"] - rough["hand.angle"]).max()
    assert 0 < difference < 0.1 * np.ptp(fine["hand.angle"])


def test_progress_runs_through_all_cases(tmp_path: Path) -> None:
    told: list[tuple[float, str]] = []
    path = tmp_path / "scenario.yaml"
    path.write_text(FALLING + "cases: [{name: a}, {name: b}]")
    run_scenario(path, progress=lambda fraction, doing: told.append((fraction, doing)))
    assert told == sorted(told)
    assert (0.5, "a") in told
    assert told[-1] == (1.0, "b")


def test_the_built_fmus_can_be_kept(tmp_path: Path) -> None:
    path = tmp_path / "scenario.yaml"
    path.write_text(FALLING)
    result = run_scenario(path, fmus=tmp_path / "kept")
    assert result.assembled.files["hand"] == tmp_path / "kept" / "hand.fmu"
    assert result.assembled.files["hand"].is_file()
    again = tmp_path / "again.yaml"
    again.write_text(FALLING.replace("model: pendulum", "fmu: kept/hand.fmu"))
    assert np.array_equal(trace_of(run_scenario(again))["hand.angle"], trace_of(result)["hand.angle"])


def test_a_notebook_shows_the_checks_of_a_run(tmp_path: Path) -> None:
    result = run(tmp_path, FALLING + "expect: [{signal: hand.angle, below: 1}]\ncases: [{name: <a>}]")
    html = result._repr_html_()
    assert "A pendulum falls" in html and "<td>&lt;a&gt;</td><td>hand.angle stays below 1 rad</td><td>yes</td>" in html


def test_a_case_without_a_trace_says_why(tmp_path: Path) -> None:
    result = run(tmp_path, FALLING + "cases: [{name: a, set: {hand.inertia: -1}, expect: [{refused: bounds}]}]")
    with pytest.raises(WiringError, match="outside its bounds"):
        result.cases[0].trace  # noqa: B018 - it raises
