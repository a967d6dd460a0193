"""Studies whose parameters and values are in lists and parameter sets beside them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from fmus.errors import InputError, ScenarioError
from fmus.parameters.ssv import parameter_set
from identification.calibrate import calibrate_study
from identification.study import load_study
from identification.validation import validate_result
from orchestrator.progress import silent
from tests.support.identification.small_study import study, write_study

pytestmark = pytest.mark.usefixtures("in_this_process")

LIST = """name,value,unit,min,max
motor.torque_gain,6,N.m/V,0.5,50
hand.inertia,60,kg.cm2,5,200
hand.gravity_torque,0.03,,-0.1,0.2
hand.viscous_friction,0.001,N.m.s/rad,0,0.05
"""
LOG = {"motor.torque_gain": {"scale": "log"}}
Document = dict[str, Any]


def calibrated(folder: Path, data: Path, text: str = LIST, **changes: Any) -> Document:
    folder.mkdir(exist_ok=True)
    (folder / "list.csv").write_text(text)
    given = {"parameters": LOG, "estimate": "list.csv", **changes}
    calibrate_study(write_study(folder / "study.yaml", **given), data, folder / "out", silent)
    document: Document = json.loads((folder / "out" / "summary.json").read_text())
    return document


def test_a_study_with_a_list_finds_what_one_with_the_same_entries_does(data: Path, tmp_path: Path) -> None:
    document = calibrated(tmp_path / "listed", data)
    calibrate_study(write_study(tmp_path / "plain.yaml"), data, tmp_path / "plain", silent)
    plain = json.loads((tmp_path / "plain" / "summary.json").read_text())["parameters"]
    assert {name: one["start"] for name, one in document["parameters"].items()} == pytest.approx(
        {name: block["start"] for name, block in study()["parameters"].items()}
    )
    for name, one in document["parameters"].items():
        assert one["value"] == pytest.approx(plain[name]["value"], rel=1e-5)


def test_what_was_converted_is_said_with_its_line(data: Path, tmp_path: Path) -> None:
    [said] = [one["text"] for one in calibrated(tmp_path, data)["units"] if "list.csv" in one["text"]]
    assert said.startswith("hand.inertia of ") and "list.csv:3" in said and "0.0001" in said


def test_the_result_folder_needs_no_list(data: Path, tmp_path: Path) -> None:
    document = calibrated(tmp_path, data)
    (tmp_path / "list.csv").unlink()
    kept = load_study(tmp_path / "out" / "study.yaml").block
    assert kept.parameters["motor.torque_gain"].scale == "log" and kept.parameters["hand.inertia"].max == "200.0 kg.cm2"
    found = validate_result(tmp_path / "out", data, tmp_path / "validation", silent)
    assert found["fit"]["unseen"]["median"] == pytest.approx(document["fit"]["validation"]["median"], abs=1e-9)


def test_candidates_may_free_what_a_list_has(data: Path, tmp_path: Path) -> None:
    candidates = {"all": {}, "less": {"free": ["motor.torque_gain"]}}
    document = calibrated(tmp_path, data, candidates=candidates)
    assert document["candidate"] == "all"
    assert document["choice"]["candidates"]["less"]["unknowns"] == 1


def test_parameter_sets_give_values_and_starts(data: Path, tmp_path: Path) -> None:
    """Those of components that are fixed, and of parameters without a start of their own."""
    values = {"hand.added_length": 10.0, "hand.inertia": 0.006}
    (tmp_path / "set.ssv").write_bytes(parameter_set("known", values, {"hand.added_length": "cm"}))
    components = {"motor": {"model": "dc_motor"}, "hand": {"model": "pendulum"}}
    parameters = {**study()["parameters"], "hand.inertia": {"min": 0.0005, "max": 0.02}}
    changes = {"parameters": parameters, "components": components, "parameter_sets": ["set.ssv"], "estimate": None}
    document = calibrated(tmp_path, data, **changes)
    assert document["parameters"]["hand.inertia"]["start"] == 0.006
    assert document["fit"]["validation"]["median"] > 0.95
    assert any("hand.added_length of" in one["text"] and "set.ssv" in one["text"] for one in document["units"])


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("hnd.inertia,1,,,", r"list\.csv:6: hnd\.inertia: no component 'hnd'; did you mean 'hand'\?"),
        ("hand.inertja,1,,,", r"list\.csv:6: .*hand\.inertja"),
        ("hand.added_length,1,kg,,", r"list\.csv:6: .*hand\.added_length"),
        ("hand.added_length,1,foo,,", r"list\.csv:6: .*'foo' is no unit that is known"),
        ("hand.added_length,0,,,", r"list\.csv:6: .*hand\.added_length: starts at 0 with an open bound"),
        ("lag,1,ms,0,2", r"list\.csv:6: .*lag"),
    ],
)
def test_a_row_that_the_system_has_not_is_refused_at_its_line(data: Path, tmp_path: Path, line: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        calibrated(tmp_path, data, LIST + line + "\n")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("hand.added_mass", -1.0, r"set\.ssv:4: hand\.added_mass: is -1, outside its bounds"),
        ("hand.inertja", 1.0, r"set\.ssv:4: hand\.inertja: no variable 'inertja'"),
        ("motor.model", "a", r"set\.ssv:4: motor\.model: no variable 'model'"),
    ],
)
def test_a_value_of_a_set_that_does_not_fit_is_refused_where_it_stands(
    data: Path, tmp_path: Path, name: str, value: Any, said: str
) -> None:
    (tmp_path / "set.ssv").write_bytes(parameter_set("known", {name: value}))
    with pytest.raises(InputError, match=said):
        calibrated(tmp_path, data, parameter_sets=["set.ssv"])


def test_a_delay_may_stand_in_a_list(data: Path, tmp_path: Path) -> None:
    outputs = {"hand.angle": {"signal": "angle", "delay": "lag"}}
    document = calibrated(tmp_path, data, f"{LIST}lag,1,ms,0,20\n", outputs=outputs)
    assert document["parameters"]["lag"]["start"] == pytest.approx(1e-3)


def test_a_study_that_asks_for_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="nothing is estimated"):
        load_study(write_study(tmp_path / "study.yaml", parameters=None))
