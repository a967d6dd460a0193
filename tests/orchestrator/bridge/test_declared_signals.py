"""A scenario's signals become messages that its peer can be built on."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fmus.errors import ScenarioError
from orchestrator.bridge.declared_signals import declared
from orchestrator.can.database.database import load
from tests.support.commands import servotwin

SCENARIO = """title: A swing
components:
  motor: {model: dc_motor}
  hand: {model: pendulum, step: 0.005}
connections: [hand.speed -> motor.speed, motor.torque -> hand.torque]
stimuli:
  motor.voltage: {constant: 0.1}
record: [hand.angle, motor.torque]
run: {stop: 1, step: 0.01}
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    file = tmp_path / "swing.yaml"
    file.write_text(SCENARIO, encoding="utf-8")
    return file


def test_recorded_outputs_and_driven_inputs_are_sent_at_their_components_steps(scenario: Path) -> None:
    found = {wanted.name: (wanted.unit, wanted.every, wanted.sender) for wanted in declared(scenario)}
    assert found == {
        "hand.angle": ("rad", 0.005, "Rig"),
        "motor.torque": ("N.m", 0.01, "Rig"),
        "motor.voltage": ("V", 0.01, "Controller"),
    }


def test_a_period_for_all_goes_over_the_steps(scenario: Path) -> None:
    assert {wanted.every for wanted in declared(scenario, 0.02)} == {0.02}


def test_what_is_not_recorded_is_refused_where_nothing_is_left(scenario: Path) -> None:
    scenario.write_text("title: T\ncomponents: {hand: {model: pendulum}}\nrecord: []\nrun: {stop: 1, step: 0.01}\n")
    with pytest.raises(ScenarioError, match="records no output"):
        declared(scenario)


def test_the_command_writes_a_database_that_reads_back_and_never_over_one(scenario: Path, tmp_path: Path) -> None:
    target = tmp_path / "swing.dbc"
    arguments = ["can", "database", str(scenario), "--out", str(target), "--json"]
    answer = servotwin(*arguments)
    assert answer.exit_code == 0, answer.stderr
    messages = {message.name: [signal.name for signal in message.signals] for message in load(target).messages}
    assert messages == {name: message["signals"] for name, message in json.loads(answer.stdout)["messages"].items()}
    assert messages["Rig_5ms"] == ["hand_angle"]
    again = servotwin(*arguments)
    assert again.exit_code == 2
    assert "is there already" in again.stderr
