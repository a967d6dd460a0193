"""Errors about values name the file and line where what counts in the case stands, and nothing where that is open."""

from __future__ import annotations

from pathlib import Path

import pytest

from fmus.errors import InputError
from orchestrator.scenario.run import run_scenario
from orchestrator.yaml_file import naming

PART = """part: a motor
components:
  motor:
    model: dc_motor
    parameters:
      back_emf: 0.1
      resistance: 1
sets:
  worn:
    motor.back_emf: 0.2
    motor.resistance: 2
expect:
  - {signal: motor.torque, below: 1}
"""
OWN = """title: a motor
include: [part.yaml]
stimuli:
  motor.voltage: {constant: 1}
run: {stop: 0.1, step: 0.01}
cases:
  - {name: new}
  - name: worn
    use: [worn]
  - name: cold
    use: [worn]
    set:
      motor.resistance: 0.5
"""


def refused(folder: Path, part: str = PART, own: str = OWN) -> str:
    (folder / "part.yaml").write_text(part)
    (folder / "own.yaml").write_text(own)
    with pytest.raises(InputError) as error:
        run_scenario(folder / "own.yaml")
    return str(error.value).replace(f"{folder}/", "")


@pytest.mark.parametrize(
    ("line", "value", "place"),
    [
        ("      resistance: 1", "      resistance: -1", "own.yaml: part.yaml:7: case new: motor.resistance"),
        ("    motor.resistance: 2", "    motor.resistance: -2", "own.yaml: part.yaml:11: case worn: motor.resistance"),
        ("    motor.back_emf: 0.2", "    motor.back_emf: -2", "own.yaml: part.yaml:10: case worn: motor.back_emf"),
        ("      back_emf: 0.1", "      back_em: 0.1", "own.yaml: part.yaml:6: case new: motor.back_em"),
        ("signal: motor.torque", "signal: motor.torqe", "own.yaml: part.yaml:13: expect motor.torqe"),
    ],
)
def test_a_value_of_a_part_is_named_by_the_part_and_its_line(tmp_path: Path, line: str, value: str, place: str) -> None:
    assert refused(tmp_path, part=PART.replace(line, value)).startswith(f"{place}: ")


def test_a_value_of_the_file_itself_is_named_by_its_line(tmp_path: Path) -> None:
    wrong = OWN.replace("resistance: 0.5", "resistance: -5")
    assert refused(tmp_path, own=wrong).startswith("own.yaml:13: case cold: motor.resistance: is -5")
    wrong = OWN.replace("motor.voltage:", "motor.volts:")
    assert refused(tmp_path, own=wrong).startswith("own.yaml:4: motor.volts: ")


@pytest.mark.parametrize(
    ("place", "stands"),
    [
        ("motor.resistance", ": "),  # of which case?
        ("case unknown: motor.resistance", ": "),
        ("stimuli.motor.voltage", ":4: "),
        ("run.stop", ":5: "),
        ("--set: motor.resistance", ": "),
        ("list.csv:3: motor.voltage", ": "),
        ("components.motor.model", ": part.yaml:4: "),
        ("nothing of this", ": "),
    ],
)
def test_a_line_is_told_where_one_alone_can_be_meant(tmp_path: Path, place: str, stands: str) -> None:
    (tmp_path / "part.yaml").write_text(PART)
    (tmp_path / "own.yaml").write_text(OWN)
    with pytest.raises(InputError) as error, naming(tmp_path / "own.yaml"):
        raise InputError(place, "is wrong")
    assert str(error.value).replace(f"{tmp_path}/", "") == f"own.yaml{stands}{place}: is wrong"
