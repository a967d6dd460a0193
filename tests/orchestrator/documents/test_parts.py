"""Scenarios share parts: what a file says itself counts, errors name file and line, what leads out is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fmus.errors import ScenarioError
from orchestrator.documents.parts import MOST
from orchestrator.scenario.scenario import Scenario
from orchestrator.scenario.schema import ScenarioBlock, load_scenario
from orchestrator.yaml_file import keys, load_joined

PART = """part: a hand and its sensor
components:
  hand: {model: pendulum, parameters: {inertia: 0.5, viscous_friction: 0.1}}
  sensor: {model: daq, parameters: {gain: 2, noise: 0.1}}
connections:
  - hand.angle -> sensor.signal
stimuli:
  hand.torque: {constant: 3 mNm}
run: {stop: 1, step: 0.01}
expect:
  - {signal: hand.angle, below: 4}
"""
OWN = """title: swing
include: [part.yaml]
components:
  sensor: {parameters: {noise: 0}}
run: {stop: 2}
expect:
  - {signal: hand.angle, above: -4}
"""


def scenario(folder: Path, own: str = OWN, **parts: str) -> Scenario:
    for name, text in {"part": PART, **parts}.items():
        (folder / f"{name}.yaml").write_text(text)
    (folder / "own.yaml").write_text(own)
    return load_scenario(folder / "own.yaml")


def refusal(folder: Path, own: str = OWN, **parts: str) -> str:
    with pytest.raises(ScenarioError) as refused:
        scenario(folder, own, **parts)
    return str(refused.value).replace(f"{folder}/", "")


def test_maps_are_joined_and_lists_appended_and_the_file_itself_counts(tmp_path: Path) -> None:
    made = scenario(tmp_path)
    assert made.system.values() == {
        "hand.inertia": 0.5,
        "hand.viscous_friction": 0.1,
        "sensor.gain": 2,
        "sensor.noise": 0,
    }
    assert (made.timing.stop, float(made.timing.step)) == (2, 0.01)
    assert [str(expected) for expected in made.cases[0].expected] == [
        "hand.angle stays below 4",
        "hand.angle stays above -4",
    ]
    assert [part.name for part in made.parts] == ["part.yaml"]


def test_a_component_of_another_model_and_a_stimulus_are_taken_whole(tmp_path: Path) -> None:
    own = "title: t\ninclude: [part.yaml]\ncomponents: {sensor: {model: daq}}\nstimuli: {hand.torque: {constant: 0}}"
    made = scenario(tmp_path, own)
    assert "sensor.gain" not in made.system.values() and made.stimuli["hand.torque"].source == 0


def test_of_several_parts_the_later_counts_and_one_that_comes_twice_is_taken_once(tmp_path: Path) -> None:
    fine = "part: fine\ninclude: [part.yaml]\ncomponents: {sensor: {parameters: {gain: 7}}}"
    stiff = "part: stiff\ninclude: [part.yaml]\ncomponents: {sensor: {parameters: {gain: 8, noise: 9}}}"
    made = scenario(tmp_path, OWN.replace("[part.yaml]", "[fine.yaml, stiff.yaml]"), fine=fine, stiff=stiff)
    assert made.system.values()["sensor.gain"] == 8 and made.system.values()["sensor.noise"] == 0
    assert made.system.connections == (("hand.angle", "sensor.signal"),)


def test_files_that_a_part_names_are_found_beside_it(tmp_path: Path) -> None:
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared" / "mine.py").write_text("")
    part = {
        "part": "files of all kinds",
        "components": {"a": {"fmu": "x.fmu"}, "b": {"model": "mine.py"}, "c": {"fmu": "/x.fmu"}},
        "stimuli": {"a.u": {"file": "u.csv", "signal": "u"}},
        "can": {"database": ["one.dbc", "two.dbc"], "send": {"A.b": "a.y"}},
        "expect": [{"signal": "a.y", "reference": {"file": "y.csv", "signal": "y"}, "within": 1}],
    }
    (tmp_path / "shared" / "part.yaml").write_text(json.dumps(part))
    own = tmp_path / "own.yaml"
    own.write_text("title: t\ninclude: [shared/part.yaml]\nrun: {stop: 1, step: 1}\ncomponents: {d: {fmu: x.fmu}}")
    block, _ = load_joined(own, ScenarioBlock)
    assert {name: str(one.fmu or one.model) for name, one in block.components.items()} == {
        "a": "shared/x.fmu",
        "b": "shared/mine.py",
        "c": "/x.fmu",
        "d": "x.fmu",
    }
    assert str(block.stimuli["a.u"].file) == "shared/u.csv"
    assert str(block.expect[0].reference.file) == "shared/y.csv"  # type: ignore[union-attr]
    assert block.can is not None and list(map(str, block.can.database)) == ["shared/one.dbc", "shared/two.dbc"]  # type: ignore[arg-type]


def test_what_is_wrong_in_a_part_is_told_with_its_file_and_line(tmp_path: Path) -> None:
    assert refusal(tmp_path, part=PART.replace("inertia: 0.5", "inertia: [")).startswith("part.yaml:")
    wrong = PART.replace("{model: daq, parameters", "{modle: daq, parameters")
    assert refusal(tmp_path, part=wrong) == ("part.yaml:4: components.sensor.modle: unknown key; did you mean 'model'?")
    wrong = PART.replace("below: 4", "below: much")
    assert refusal(tmp_path, part=wrong).startswith("part.yaml:11: expect.0.below: ")
    assert refusal(tmp_path, OWN.replace("above: -4", "abov: -4")).startswith("own.yaml:7: expect.1.abov: unknown key")


@pytest.mark.parametrize(
    ("own", "parts", "told"),
    [
        (OWN.replace("part.yaml", "absent.yaml"), {}, "own.yaml:2: include: there is no file absent.yaml"),
        (OWN.replace("part.yaml", "../../x.yaml"), {}, "own.yaml:2: include: ../../x.yaml lies outside of"),
        (OWN.replace("part.yaml", "/etc/passwd"), {}, "own.yaml:2: include: /etc/passwd lies outside of"),
        (OWN.replace("[part.yaml]", "part.yaml"), {}, "own.yaml:2: include: is no list of files"),
        (OWN, {"part": PART.replace("part: a", "title: a")}, "part.yaml: is included, and is no part"),
        (OWN, {"part": PART + "include: [part.yaml]"}, "includes itself: part.yaml -> part.yaml"),
        (
            OWN,
            {"part": PART + "include: [b.yaml]", "b": "part: b\ninclude: [own.yaml]"},
            "b.yaml:2: include: includes itself: own.yaml -> part.yaml -> b.yaml -> own.yaml",
        ),
    ],
)
def test_what_cannot_be_included_is_refused(own: str, parts: dict[str, str], told: str, tmp_path: Path) -> None:
    assert told in refusal(tmp_path, own, **parts)


def test_a_link_leads_out_of_a_project_no_more_than_a_path_does(tmp_path: Path) -> None:
    (tmp_path / "project" / "deep" / "down").mkdir(parents=True)
    (tmp_path / "project" / "pyproject.toml").write_text("")
    (tmp_path / "secret.yaml").write_text(PART)
    (tmp_path / "project" / "part.yaml").write_text(PART)
    folder = tmp_path / "project" / "deep" / "down"
    (folder / "link.yaml").symlink_to(tmp_path / "secret.yaml")
    assert "lies outside of" in refusal(folder, OWN.replace("part.yaml", "link.yaml"))
    assert scenario(folder, OWN.replace("part.yaml", "../../part.yaml")).title == "swing"


def test_a_flood_of_parts_is_refused_with_their_number(tmp_path: Path) -> None:
    names = [f"p{number}" for number in range(MOST + 1)]
    own = OWN.replace("part.yaml", ", ".join(f"{name}.yaml" for name in names))
    assert f"is made of more than {MOST} files" in refusal(tmp_path, own, **dict.fromkeys(names, "part: little"))


def test_a_part_is_no_scenario_and_says_what_to_do_with_it(tmp_path: Path) -> None:
    (tmp_path / "part.yaml").write_text(PART)
    with pytest.raises(ScenarioError, match="is a part of scenarios; name it under `include` of one"):
        load_scenario(tmp_path / "part.yaml")


def test_the_keys_of_a_file_are_also_those_of_its_parts(tmp_path: Path) -> None:
    scenario(tmp_path)
    assert {"title", "run", "stimuli"} <= set(keys(tmp_path / "own.yaml"))
