"""What the length of the steps costs is told as it is: held against a run with far shorter ones."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from fmus.errors import InputError
from orchestrator import Scenario, load_scenario, run
from orchestrator.scenario.step_check import StepCost, step_errors
from tests.support.commands import servotwin
from tests.support.fmus import quirks

COUPLED = """
title: coupled
components:
  motor: {model: dc_motor, parameters: {back_emf: 1e-3}}
  hand: {model: pendulum, parameters: {angle_start: 1.0, coulomb_friction_positive: 0, coulomb_friction_negative: 0}}
connections: [motor.torque -> hand.torque, hand.speed -> motor.speed]
stimuli: {motor.voltage: {constant: 0.01}}
run: {stop: 0.4, step: 0.002}
"""
ALONE = """
title: alone
components: {motor: {model: dc_motor}}
stimuli: {motor.voltage: {constant: 1.0}, motor.speed: {constant: 0.0}}
run: {stop: 0.1, step: 0.01}
"""


def scenario(folder: Path, text: str) -> Scenario:
    (folder / "scenario.yaml").write_text(text)
    return load_scenario(folder / "scenario.yaml")


def errors(whole: Scenario) -> dict[str, StepCost]:
    return {error.signal: error for error in step_errors(whole, run(whole))}


def test_the_error_is_that_of_the_run_and_falls_as_the_step_does_where_values_are_held_over_it(tmp_path: Path) -> None:
    whole = scenario(tmp_path, COUPLED)
    found = errors(whole)["hand.angle"]
    fine = run(replace(whole, timing=replace(whole.timing, step=whole.timing.step * Fraction(1, 64)))).cases[0].trace
    truth = np.abs(run(whole).cases[0].trace["hand.angle"] - fine["hand.angle"][::64]).max()
    assert found.error == pytest.approx(truth, rel=0.05)
    assert found.order == pytest.approx(1.0, abs=0.1)
    assert not found.unsettled


SPRUNG = """
title: sprung
components: {mass: {model: mass.py}, spring: {model: spring.py, feed_through: none}}
connections: [mass.speed -> spring.speed, spring.force -> mass.force]
run: {stop: 2, step: {tolerance: 1e-4, least: 1e-4, most: 0.02}, order: iterated}
record: [mass.place]
"""
MASS = """
from . import Model, State, input_, output
MODEL = Model(name="mass", description="1 kg", solver_step=lambda p: 0.001, variables=(input_("force", "N", "On it"),
    output("speed", "m/s", "Its speed"), output("place", "m", "Where it is")),
    states=(State("place", unit="m"), State("speed", unit="m/s")),
    derivatives=lambda t, x, u, p: {"place": x.speed, "speed": u.force})
"""
SPRING = """
from . import Model, State, input_, output
MODEL = Model(name="spring", description="100 N/m", solver_step=lambda p: 0.001,
    variables=(input_("speed", "m/s", "Of its end"), output("force", "N", "That it pulls with")),
    states=(State("stretch", 0.1, unit="m"),), derivatives=lambda t, x, u, p: {"stretch": u.speed},
    outputs=lambda t, x, u, p: {"force": -100 * x.stretch})
"""


def test_where_a_tolerance_chooses_the_steps_the_error_is_that_of_the_run_too(tmp_path: Path) -> None:
    (tmp_path / "mass.py").write_text(MASS)
    (tmp_path / "spring.py").write_text(SPRING)
    whole = scenario(tmp_path, SPRUNG)
    found, trace = errors(whole)["mass.place"], run(whole).cases[0].trace
    truth = np.abs(trace["mass.place"] - 0.1 * (np.cos(10 * trace.time) - 1)).max()
    assert found.error == pytest.approx(truth, rel=0.05) and truth > 1e-4
    assert found.order == pytest.approx(2.0, abs=0.1)


def test_nothing_is_said_of_the_order_of_what_steps_do_not_change(tmp_path: Path) -> None:
    assert {(error.difference, error.order) for error in errors(scenario(tmp_path, ALONE)).values()} == {(0.0, None)}


def test_a_run_that_records_nothing_is_not_said_to_be_without_error(tmp_path: Path) -> None:
    quirks.build(tmp_path / "lag.fmu", output=False)
    text = "title: lag\ncomponents: {lag: {fmu: lag.fmu}}\nrun: {stop: 1, step: 0.1}"
    with pytest.raises(InputError, match="--check-step: nothing that is recorded is a number; name variables in"):
        errors(scenario(tmp_path, text))


@pytest.mark.parametrize("order", [0.0, -2.0, 36.0])
def test_a_difference_that_does_not_fall_as_an_error_does_is_not_taken_for_one_that_is_known(order: float) -> None:
    error = StepCost("run", "y", "m", 0.5, 0.1, order)
    assert error.unsettled and error.error == 0.5


def test_the_command_tells_errors_and_orders(tmp_path: Path) -> None:
    scenario(tmp_path, COUPLED)
    words = ["run", str(tmp_path / "scenario.yaml"), "--check-step", "--out", str(tmp_path / "out"), "--json"]
    done = servotwin(*words)
    told = {step["signal"]: step for step in json.loads(done.stdout)["steps"]}
    assert told["hand.angle"]["order"] == pytest.approx(1.0, abs=0.1)
    assert told["hand.angle"]["unit"] == "rad"
