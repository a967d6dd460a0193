"""Scenarios: the files of the project hold, and every way to ask for something wrong is answered in one line."""

from __future__ import annotations

import pickle
import re
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import FmuError, InputError, ScenarioError, ServotwinError, WiringError
from orchestrator import formats
from orchestrator.engine import Result, Run, Simulation
from orchestrator.fmi.interface import Value, Written
from orchestrator.processes.interrupts import Interrupts
from orchestrator.scenario.run import Keeping, ScenarioInterrupted, ScenarioResult, parse_override, run_scenario
from orchestrator.trace import Trace
from orchestrator.yaml_file import keys

pytestmark = pytest.mark.usefixtures("scratch")

SCENARIOS = Path(__file__).parents[4] / "scenarios"
LONG = {"synthetic_campaign.yaml", "rig.yaml"}
FILES = [
    pytest.param(path, id=str(path.relative_to(SCENARIOS)), marks=pytest.mark.slow if path.name in LONG else ())
    for path in sorted(SCENARIOS.rglob("*.yaml"))
    if "run" in keys(path) and "can" not in keys(path)
]


@pytest.mark.slow
@pytest.mark.parametrize("path", FILES)
def test_the_scenarios_of_the_project_hold(path: Path) -> None:
    result = run_scenario(path)
    failed = [(case.name, check) for case in result.cases for check in case.checks if not check.held]
    assert failed == []
    assert result.passed


FALLING = """
title: A pendulum falls
components:
  hand: {model: pendulum, parameters: {viscous_friction: 0.0}}
run: {stop: 1, step: 0.01}
"""


def run(folder: Path, text: str, **overrides: Value) -> ScenarioResult:
    path = folder / "scenario.yaml"
    path.write_text(text)
    return run_scenario(path, {name.replace("__", "."): value for name, value in overrides.items()})


def refused(folder: Path, text: str, kind: type[ServotwinError] = InputError) -> str:
    """The refusal without the file's name."""
    with pytest.raises(kind) as failed:
        run(folder, text)
    message = str(failed.value)
    assert "\n" not in message
    return message.removeprefix(str(folder / "scenario.yaml"))


def trace_of(result: ScenarioResult, number: int = 0) -> Trace:
    made = result.cases[number].result
    assert made is not None
    return made.trace


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
    assert (check.text, check.held, check.found) == ("hand.angle stays below 0.1", False, "largest 0.5 rad")


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
        WiringError, match=r"yaml: stimuli\.hand\.torque: .*short\.csv covers 0 to 0\.5 s, not 0 to 1 s"
    ):
        run(tmp_path, stimulus.replace(", ends: hold", ""))
    result = run(tmp_path, stimulus + "\nrecord: [hand.torque]")
    assert trace_of(result)["hand.torque"][-1] == 0.1
    assert result.scenario.held == ["hand.torque keeps its last value from 0.5 s on"]


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


REFUSED = [
    ("title: A pendulum falls", "titel: A", ":2: titel: unknown key; did you mean 'title'?"),
    ("model: pendulum", "model: pendelum", "model 'pendelum': is not in the library"),
    ("model: pendulum", "model: pendulum, fmu: a.fmu", ":4: components.hand: give either `model` or `fmu`"),
    ("model: pendulum, ", "", ":4: components.hand: give either `model` or `fmu`"),
    ("model: pendulum", "fmu: missing.fmu", "missing.fmu: no such file"),
    ("hand: {", "my hand: {", ":3: components: component 'my hand': use letters, digits and underscores"),
    ("viscous_friction: 0.0", "viscous: 0.0", "hand.viscous: no variable 'viscous' in 'hand'; did you mean"),
    ("viscous_friction: 0.0", "viscous_friction: -1", "hand.viscous_friction: is -1, outside its bounds [0, inf)"),
    ("viscous_friction: 0.0", "viscous_friction: much", "hand.viscous_friction: cannot be 'much'; give a Real"),
    ("viscous_friction: 0.0", "viscous_friction: true", "hand.viscous_friction: cannot be true; give a Real"),
    ("step: 0.01", "step: 0.03", "stop: 1 s is not a multiple of 0.03 s; use 0.99 s"),
    ("step: 0.01", "step: 0", ":5: run: `step` must be positive and `stop` after `start`"),
    ("step: 0.01", "step: soon", ":5: run.step: 'soon' is no time"),
    (
        "step: 0.01",
        "step: 0.01, order: gauss_seidel",
        ":5: run.order: input should be 'gauss-seidel', 'jacobi' or 'iterated'",
    ),
    ("step: 0.01", "step: 0.01, start: 2", ":5: run: `step` must be positive and `stop` after `start`"),
    ("run:", "connections: [hand.angle]\nrun:", ":5: connections: 'hand.angle': write source -> target"),
    ("run:", "connections: [hand.angle -> hand.angle]\nrun:", "'hand.angle' is an output; only an input can be a"),
    ("run:", "connections: [hand.angle -> hand.torque]\nrun:", "hand.angle -> hand.torque: rad does not fit N.m"),
    ("run:", "record: [hand.angel]\nrun:", "hand.angel: no variable 'angel' in 'hand'; did you mean 'angle'?"),
    ("run:", "expect: [{signal: hand.angel, below: 1}]\nrun:", "hand.angel: no variable 'angel' in 'hand'"),
    ("run:", "expect: [{signal: hand.angle, below: 1, after: 7}]\nrun:", "expect hand.angle: there is no sample from"),
    ("run:", "cases: [{name: a, set: {hand.weight: 1}}]\nrun:", "hand.weight: no variable 'weight' in 'hand'"),
    ("run:", "cases: [{name: a}, {name: a}]\nrun:", "two cases have one name"),
    ("run:", "stimuli: {hand.angle: {constant: 1}}\nrun:", "'hand.angle' is an output; only an input can be"),
    ("run:", "stimuli: {hand.torque: {}}\nrun:", ":5: stimuli.hand.torque: give `constant`, or `file` and `signal`"),
    ("run:", "stimuli: {hand.torque: {file: a.csv}}\nrun:", ":5: stimuli.hand.torque: give `constant`, or `file` and"),
    ("run:", "stimuli: {hand.torque: {file: a.csv, signal: b}}\nrun:", "a.csv: there is no such file"),
    ("0.0}", "0.0}, tables: {a: {file: b.csv, signal: c}}", "b.csv: there is no such file"),
    ("0.0}", "0.0}, feed_through: some", ":4: components.hand.feed_through: input should be"),
    ("0.0}", "0.0}, step: -1/3", "hand.step: -1/3 s is not positive"),
]


@pytest.mark.parametrize(("old", "new", "line"), REFUSED, ids=range(len(REFUSED)))
def test_what_is_wrong_is_one_line_that_names_the_place(tmp_path: Path, old: str, new: str, line: str) -> None:
    assert old in FALLING
    assert line in refused(tmp_path, FALLING.replace(old, new))


def test_a_wrong_expectation_of_the_last_case_is_found_before_the_first_runs(tmp_path: Path) -> None:
    told: list[str] = []
    path = tmp_path / "scenario.yaml"
    path.write_text(FALLING + "cases: [{name: a}, {name: b, expect: [{signal: hand.x, below: 1}]}]")
    with pytest.raises(WiringError, match=r"hand\.x: no variable"):
        run_scenario(path, progress=lambda fraction, doing: told.append(doing))
    assert told == []


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


@pytest.mark.parametrize(
    ("text", "name", "value"),
    [
        ("hand.mass=1", "hand.mass", 1),
        ("hand.mass=1.0", "hand.mass", 1.0),
        (" hand.mass = -2e-3 ", "hand.mass", -2e-3),
        ("drive.on=true", "drive.on", True),
        ("drive.on=False", "drive.on", False),
        ("drive.shape=sine sweep", "drive.shape", "sine sweep"),
        ("drive.name=a=b", "drive.name", "a=b"),
        ("drive.name=", "drive.name", ""),
    ],
)
def test_overrides_are_read_as_number_truth_or_text(text: str, name: str, value: Value) -> None:
    read = parse_override(text)
    assert read[0] == name and isinstance(read[1], Written)
    assert read[1].read() == value and type(read[1].read()) is type(value)


@given(st.text(max_size=30))
def test_any_override_is_read_or_refused(text: str) -> None:
    try:
        name, _ = parse_override(text)
    except WiringError as error:
        assert "=" not in text
        assert re.search("has no value; write component.variable=value$", str(error))
    else:
        assert name == text.partition("=")[0].strip()


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e999", "9" * 5000])
def test_an_override_that_is_no_number_is_refused(tmp_path: Path, value: str) -> None:
    name, parsed = parse_override(f"hand.gravity_torque={value}")
    overrides: dict[str, Any] = {name: parsed}
    path = tmp_path / "scenario.yaml"
    path.write_text(FALLING)
    with pytest.raises((WiringError, InputError)) as failed:
        run_scenario(path, overrides)
    assert len(str(failed.value)) < 300


def test_a_file_that_is_no_scenario_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="no such file"):
        run_scenario(tmp_path / "missing.yaml")


def stopped_at(folder: Path, text: str, fraction: float, keeping: Keeping | None = None) -> ScenarioResult:
    """What a scenario leaves that is interrupted when so much of it is done."""

    def interrupt(done: float, doing: str) -> None:
        if done >= fraction:
            raise KeyboardInterrupt

    path = folder / "scenario.yaml"
    path.write_text(text)
    with pytest.raises(ScenarioInterrupted) as stopped:
        run_scenario(path, progress=interrupt, keeping=keeping)
    assert type(pickle.loads(pickle.dumps(stopped.value))) is KeyboardInterrupt
    return stopped.value.result


EXPECT = "expect: [{signal: hand.angle, below: 9}]\n"
THREE = FALLING + EXPECT + "cases: [{name: a}, {name: b, set: {hand.angle_start: 0.2}}, {name: c}]\n"


def test_an_interrupt_keeps_the_cases_that_are_done_and_the_one_that_runs(tmp_path: Path) -> None:
    result = stopped_at(tmp_path, THREE, 0.5)
    assert [(case.name, case.state) for case in result.cases] == [("a", "done"), ("b", "interrupted"), ("c", "not run")]
    assert [case.passed for case in result.cases] == [True, False, False]
    assert [len(case.checks) for case in result.cases] == [1, 0, 0]
    assert result.interrupted and not result.passed
    whole = run(tmp_path, THREE)
    assert np.array_equal(trace_of(result)["hand.angle"], trace_of(whole)["hand.angle"])
    part = trace_of(result, 1)
    assert np.array_equal(part["hand.angle"], trace_of(whole, 1)["hand.angle"][: len(part)]) and len(part) > 0


def test_an_interrupt_before_anything_was_stepped_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "scenario.yaml"
    path.write_text(FALLING)
    with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt) as stopped:
        patch.setattr(Simulation, "check_record", interrupt_now)
        run_scenario(path)
    assert not isinstance(stopped.value, ScenarioInterrupted)


def test_an_interrupt_between_two_cases_lists_those_that_have_not_begun(tmp_path: Path) -> None:
    def between(simulation: Simulation, run: Run, *more: Any) -> Result:
        if run.values == {"hand.viscous_friction": 0.0, "hand.angle_start": 0.2}:
            raise KeyboardInterrupt
        return execute(simulation, run, *more)

    execute: Any = Simulation.execute
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Simulation, "execute", between)
        result = stopped_at(tmp_path, THREE, 2.0)
    assert [case.state for case in result.cases] == ["done", "not run", "not run"]


def test_an_interrupt_when_all_is_done_loses_nothing(tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Simulation, "close", interrupt_now)
        result = stopped_at(tmp_path, THREE, 2.0)
    assert [case.state for case in result.cases] == ["done"] * 3
    assert result.interrupted and result.passed


def test_the_error_with_which_an_fmu_answers_an_interrupt_is_no_refusal(tmp_path: Path) -> None:
    """Also where a case expects one: the cases after it do not run."""

    def fail(*_: object) -> None:
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        raise FmuError("hand", "returned fatal error")

    path = tmp_path / "scenario.yaml"
    path.write_text(FALLING + "cases: [{name: a, expect: [{refused: fatal}]}, {name: b}]")
    with pytest.MonkeyPatch.context() as patch, Interrupts(), pytest.raises(KeyboardInterrupt):
        patch.setattr("orchestrator.engine.simulation.initialise", fail)
        run_scenario(path)


def interrupt_now(*_: object) -> None:
    raise KeyboardInterrupt


def test_a_notebook_shows_the_checks_of_a_run(tmp_path: Path) -> None:
    result = run(tmp_path, FALLING + "expect: [{signal: hand.angle, below: 1}]\ncases: [{name: <a>}]")
    html = result._repr_html_()
    assert "A pendulum falls" in html and "<td>&lt;a&gt;</td><td>hand.angle stays below 1</td><td>yes</td>" in html


def test_a_case_without_a_trace_says_why(tmp_path: Path) -> None:
    result = run(tmp_path, FALLING + "cases: [{name: a, set: {hand.inertia: -1}, expect: [{refused: bounds}]}]")
    with pytest.raises(WiringError, match="outside its bounds"):
        result.cases[0].trace  # noqa: B018 - it raises
