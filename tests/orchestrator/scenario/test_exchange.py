"""A scenario goes out as an SSP and comes back: the same trajectories, the same expectations, all that it reads."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from fmus.errors import InputError, WiringError
from orchestrator.scenario.exchange import export, unpack
from orchestrator.scenario.run import ScenarioResult, run_scenario
from orchestrator.ssp.checking import check
from tests.support.simulation import ssps
from tests.support.simulation.ssps import archive, component, system

STAIR = "time,torque\n0,0\n0.1,0.01\n0.3,-0.01\n0.5,0\n"
COMPONENTS: dict[str, Any] = {
    "push": {"model": "excitation", "parameters": {"shape": "sine sweep", "amplitude": 0.3, "frequency": 2}},
    "motor": {"model": "dc_motor", "parameters": {"inductance": 0.02}},
    "hand": {"model": "pendulum", "parameters": {"angle_start": 0.4}},
}
WIRES = ["0.5 * push.signal + 0.1 -> motor.voltage", "hand.speed -> motor.speed", "motor.torque -> hand.torque"]
PLAYED = {
    "stimuli": {"hand.torque": {"file": "stair.csv", "signal": "torque", "ends": "hold"}},
    "components": {"hand": {"model": "pendulum"}},
    "connections": [],
}
CONSTANT = {**PLAYED, "stimuli": {"hand.torque": {"constant": 0.01}}}
LOW, HIGH = {"name": "low", "set": {"hand.angle_start": 0.1}}, {"name": "high", "set": {"motor.inductance": 0.1}}


def scenario(folder: Path, **more: Any) -> Path:
    document = {
        "title": "A motor turns a hand",
        "components": COMPONENTS,
        "connections": WIRES,
        "run": {"stop": 0.5, "step": 0.01},
        "expect": [{"signal": "hand.angle", "below": 3}],
    } | more
    folder.mkdir(exist_ok=True)
    (folder / "turn.yaml").write_text(json.dumps(document))
    (folder / "stair.csv").write_text(STAIR)
    return folder / "turn.yaml"


def same(one: ScenarioResult, other: ScenarioResult) -> None:
    assert [case.name for case in one.cases] == [case.name for case in other.cases]
    for case, again in zip(one.cases, other.cases, strict=True):
        assert case.result is not None and again.result is not None
        assert case.result.trace == again.result.trace
        assert [check.text for check in case.checks] == [check.text for check in again.checks]


@pytest.mark.parametrize(
    "more",
    [
        {},
        PLAYED,
        CONSTANT,
        {"record": ["hand.angle", "motor.current"]},
        {"cases": [LOW, HIGH]},
        {"run": {"stop": "10/3", "step": "1/300", "order": "jacobi"}},
        {"connections": [*WIRES[:1], *WIRES[2:]], "stimuli": {"motor.speed": {"constant": "60 rpm"}}},
        {"recorder": {"signals": {"angle": "hand.angle"}, "every": 0.05}},
    ],
    ids=["plain", "recording", "constant", "record", "cases", "exact times", "unit", "recorder"],
)
def test_an_ssp_and_the_folder_that_it_is_unpacked_to_run_as_the_scenario_does(
    tmp_path: Path, more: dict[str, Any]
) -> None:
    file = scenario(tmp_path / "own", **more)
    export(file, tmp_path / "turn.ssp")
    expected = run_scenario(file)
    assert check(tmp_path / "turn.ssp").problems == ()
    same(run_scenario(tmp_path / "turn.ssp"), expected)
    same(run_scenario(unpack(tmp_path / "turn.ssp", tmp_path / "again")), expected)


def test_what_went_out_and_in_goes_out_as_it_did_before(tmp_path: Path) -> None:
    file = scenario(tmp_path / "own", **PLAYED)
    export(file, tmp_path / "turn.ssp")
    again = unpack(tmp_path / "turn.ssp", tmp_path / "again")
    export(again, tmp_path / "turn2.ssp")
    export(tmp_path / "turn.ssp", tmp_path / "turn3.ssp")
    with zipfile.ZipFile(tmp_path / "turn.ssp") as first:
        for name in ("turn2.ssp", "turn3.ssp"):
            with zipfile.ZipFile(tmp_path / name) as second:
                assert {one: first.read(one) for one in first.namelist() if "scenario" not in one} == {
                    one: second.read(one).replace(name[:5].encode(), b"turn")
                    for one in second.namelist()
                    if "scenario" not in one
                }


def test_an_ssp_can_be_included_and_its_values_changed(tmp_path: Path) -> None:
    file = scenario(tmp_path / "own")
    export(file, tmp_path / "own" / "turn.ssp")
    changed = scenario(tmp_path / "other", components=COMPONENTS | {"hand": {"model": "pendulum"}})
    document = {
        "title": "included",
        "include": ["turn.ssp"],
        "components": {"hand": {"parameters": {"angle_start": 0.0}}},
        "run": {"stop": 0.5, "step": 0.01},
    }
    (tmp_path / "own" / "with.yaml").write_text(json.dumps(document))
    found, expected = (run_scenario(one).cases[0].result for one in (tmp_path / "own" / "with.yaml", changed))
    assert found is not None and expected is not None
    assert found.trace == expected.trace


def test_what_another_tool_changes_in_the_description_counts(tmp_path: Path) -> None:
    export(scenario(tmp_path / "own", **CONSTANT), tmp_path / "turn.ssp")
    with zipfile.ZipFile(tmp_path / "turn.ssp") as read, zipfile.ZipFile(tmp_path / "new.ssp", "w") as made:
        for name in read.namelist():
            content = read.read(name).replace(b'stopTime="0.5"', b'stopTime="0.25"')
            made.writestr(name, content.replace(b'<ssv:Real value="0.01"', b'<ssv:Real value="0.02"'))
    other = {"stimuli": {"hand.torque": {"constant": 0.02}}, "run": {"stop": 0.25, "step": 0.01}}
    changed = scenario(tmp_path / "own", **CONSTANT | other)
    same(run_scenario(tmp_path / "new.ssp"), run_scenario(changed))


def test_nothing_is_written_where_the_scenario_does_not_fit(tmp_path: Path) -> None:
    file = scenario(tmp_path / "own", connections=["hand.sped -> motor.speed"])
    with pytest.raises(WiringError, match="did you mean 'speed'"):
        export(file, tmp_path / "turn.ssp")
    assert not (tmp_path / "turn.ssp").exists()


def test_a_file_that_is_there_is_not_written_over(tmp_path: Path) -> None:
    export(scenario(tmp_path / "own"), tmp_path / "turn.ssp")
    unpack(tmp_path / "turn.ssp", tmp_path / "again")
    with pytest.raises(InputError, match="is there already"):
        unpack(tmp_path / "turn.ssp", tmp_path / "again")


def test_annotations_of_other_tools_go_along_both_ways(tmp_path: Path) -> None:
    def noted(what: str) -> str:
        inside = f'<v:Color xmlns:v="urn:vendor" of="{what}"><v:Deep/></v:Color>'
        return f'<ssd:Annotations><ssc:Annotation type="com.vendor">{inside}</ssc:Annotation></ssd:Annotations>'

    inner = system([component("w", inner=noted("w"))], name="m")
    described = ssps.described(system([component("a", inner=noted("a")), inner], after=noted("top")))
    described = described.replace("</ssd:SystemStr", f"{noted('all')}</ssd:SystemStr")
    foreign = archive(tmp_path / "foreign.ssp", described)
    export(foreign, tmp_path / "direct.ssp")
    export(unpack(foreign, tmp_path / "out"), tmp_path / "by_folder.ssp")
    for name in ("direct.ssp", "by_folder.ssp"):
        assert check(tmp_path / name).problems == ()
        with zipfile.ZipFile(tmp_path / name) as made:
            text = made.read("SystemStructure.ssd").decode()
        root = ElementTree.fromstring(text)
        owners = {
            child.get("of"): owner.get("name")
            for owner in root.iter()
            for child in owner.findall("{*}Annotations/{*}Annotation/{urn:vendor}Color")
        }
        assert owners == {"all": root.get("name"), "top": root.get("name"), "a": "a", "w": "m__w"}
        assert text.count("Deep") == 4
