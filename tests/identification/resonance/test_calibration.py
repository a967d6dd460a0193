"""The resonance method from study file to result folder: the thesis' figures as published, and the corrected ones."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import ScenarioError
from fmus.modelling.instance import Instance
from fmus.models.plants import dc_motor, pendulum
from fmus.packaging import archive, defaults
from identification.calibrate import calibrate_study
from orchestrator import formats
from orchestrator.results import RECORD
from orchestrator.trace import Trace
from tests.support.commands import servotwin
from tests.support.identification.pendulum_resonance import resonance_frequency
from tests.support.ssv import read_values

pytestmark = pytest.mark.slow  # a calibration

STUDIES = Path(__file__).parents[3] / "scenarios" / "butterfly"
TRUTH = {
    "hand.inertia": 0.00325,
    "hand.viscous_friction": 0.003,
    "hand.gravity_torque": 0.04905,
    "motor.torque_gain": 10.0,
}
MASSES = (0.0, 0.1, 0.2)
LENGTH, AMPLITUDE = 0.05, 1e-5


def calibrate(*arguments: str) -> dict[str, Any]:
    """The JSON document of a calibration through the command line."""
    answer = servotwin("calibrate", *arguments, "--json")
    assert answer.exit_code == 0, answer.stderr
    document: dict[str, Any] = json.loads(answer.stdout)
    return document


def values(document: dict[str, Any], method: str) -> list[float]:
    return [load["value"] for load in document["resonance"][method]]


def recorded(added_mass: float, hertz: float) -> Trace:
    """45 s of the rig under a small sine, of which the method takes the last 30, from the model's functions alone."""
    motor = Instance(dc_motor.MODEL, {"torque_gain": TRUTH["motor.torque_gain"]})
    own = {name.removeprefix("hand."): value for name, value in TRUTH.items() if name.startswith("hand.")}
    hand = Instance(pendulum.MODEL, {**own, "added_mass": added_mass, "added_length": LENGTH})
    step, angle = 0.02, [0.0]
    time = np.arange(2251) * step
    for t in time[:-1]:
        motor.set("voltage", AMPLITUDE * math.sin(2 * math.pi * hertz * (t + step / 2)))
        hand.set("torque", motor.get("torque"))
        hand.step(t, step)
        angle.append(hand.get("angle"))
    return Trace(time, {"angle": np.array(angle)}, {"angle": "rad"})


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three loads at seven frequencies each; names tell grams and hundredths of a hertz."""
    folder = tmp_path_factory.mktemp("sines")
    for mass in MASSES:
        for hundredths in (40, 50, 60, 70, 80, 90, 100):
            formats.write(recorded(mass, hundredths / 100), folder / f"sine_{1000 * mass:.0f}__0_{hundredths:03}.csv")
    return folder


def study(**changes: Any) -> dict[str, Any]:
    document = {
        "title": "Sines",
        "method": "resonance",
        "components": {"motor": {"model": "dc_motor"}, "hand": {"model": "pendulum"}},
        "connections": ["hand.speed -> motor.speed", "motor.torque -> hand.torque"],
        "traces": {
            "files": "sine_*.csv",
            "file_name": {
                "pattern": r"sine_(?P<mass>\d+)__(?P<hertz>\d+_\d+)",
                "fields": {"mass": {"factor": 0.001}, "hertz": {"decimal": "underscore", "factor": 10}},
            },
        },
        "campaign": {
            "signal": "angle",
            "added_mass": "mass",
            "added_length": LENGTH,
            "amplitude": AMPLITUDE,
            "frequency": "hertz",
            "frequency_in": "Hz",
        },
        "script": "recordings",
        "bounds": {"lower": [0, 0, 0], "upper": [0.03, 0.03, 0.5]},
        "write": dict(zip(("p1", "p2", "p3", "p4"), TRUTH, strict=True)),
        "truth": TRUTH,
    }
    return document | changes


def write_study(path: Path, **changes: Any) -> Path:
    path.write_text(json.dumps(study(**changes), indent=2))
    return path


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory, data: Path) -> Path:
    folder = tmp_path_factory.mktemp("result")
    calibrate_study(write_study(folder / "study.yaml"), data, folder / "out", lambda at, remark: None)
    return folder / "out"


def test_the_corrected_resonances_are_those_of_the_closed_form(result: Path) -> None:
    document = json.loads((result / "summary.json").read_text())
    loads = document["resonance"]["corrected"]
    assert [(load["added_mass"], load["added_length"]) for load in loads] == [(mass, LENGTH) for mass in MASSES]
    p1, p2, p3 = (TRUTH[f"hand.{name}"] for name in ("inertia", "viscous_friction", "gravity_torque"))
    truth = resonance_frequency(p1, p2, p3, np.array(MASSES), np.full(3, LENGTH))
    assert values(document, "corrected") == pytest.approx(truth, rel=2e-3)
    for name, entry in document["parameters"].items():
        assert entry["value"] == pytest.approx(TRUTH[name], rel=0.03) and entry["truth"] == TRUTH[name]


def test_the_result_folder_has_the_same_shape_as_any_calibration(result: Path, data: Path) -> None:
    files = {str(path.relative_to(result)) for path in result.rglob("*") if path.is_file()} - {RECORD}
    assert files == {
        "fmus/motor.fmu",
        "fmus/hand.fmu",
        "parameters.ssv",
        "parameters.srmd",
        "summary.json",
        "report.html",
        "study.yaml",
    }
    document = json.loads((result / "summary.json").read_text(), parse_constant=pytest.fail)
    assert {"parameters", "fit", "method", "data", "versions", "warnings"} <= set(document)
    assert document["method"] == "resonance (corrected)"
    assert {each["file"] for each in document["data"]} == {path.name for path in data.iterdir()}
    for entry in document["parameters"].values():
        assert {"value", "std", "ci95", "unit"} <= set(entry)
    estimated = {name: entry["value"] for name, entry in document["parameters"].items()}
    assert read_values(result / "parameters.ssv") == estimated
    used = defaults.load(archive.read(result / "fmus" / "hand.fmu")[defaults.RESOURCE].decode())
    assert used["inertia"] == estimated["hand.inertia"]


def test_what_is_taken_is_what_is_written(data: Path, tmp_path: Path) -> None:
    study_file = write_study(tmp_path / "study.yaml", take="published")
    document = calibrate_study(study_file, data, tmp_path / "out", lambda at, remark: None)
    assert document["method"] == "resonance (as published)"
    assert document["parameters"]["hand.inertia"]["value"] == document["lumped"]["as published"]["p1"]["value"]


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"write": {"p1": "hand.inertai"}}, "write.hand.inertai: no variable 'inertai'"),
        ({"write": {"p1": "hand.angle"}}, "write.hand.angle: is an output"),
        ({"truth": {"hand.mass": 1}}, "truth.hand.mass: no variable 'mass'"),
        ({"campaign": study()["campaign"] | {"added_mass": "weight"}}, "no field 'weight'; there are mass, hertz"),
        ({"campaign": study()["campaign"] | {"signal": "angel"}}, "has no signal 'angel'; it holds angle"),
    ],
)
def test_a_study_that_does_not_fit_is_refused_and_nothing_is_written(
    data: Path, tmp_path: Path, changes: dict[str, Any], problem: str
) -> None:
    study_file = write_study(tmp_path / "study.yaml", **changes)
    with pytest.raises(ValueError, match=problem):
        calibrate_study(study_file, data, tmp_path / "out", lambda at, remark: None)
    assert [path.name for path in tmp_path.iterdir()] == ["study.yaml"]


def test_a_result_of_sines_cannot_be_validated_by_free_runs(result: Path, data: Path) -> None:
    answer = servotwin("validate", result, "--data", data)
    assert answer.exit_code == 2 and "is no study of FMUs or of a linear model on recordings" in answer.stderr


def test_a_campaign_that_fails_names_the_case(tmp_path: Path) -> None:
    scenario = {
        "title": "Refused",
        "components": study()["components"] | {"guard": {"model": "energy_controller"}},
        "connections": [*study()["connections"], "hand.angle -> guard.angle", "hand.speed -> guard.speed"],
        "run": {"stop": 1, "step": 0.01},
        "expect": [{"refused": "start energy"}],
    }
    (tmp_path / "rig.yaml").write_text(json.dumps(scenario))
    study_file = write_study(tmp_path / "study.yaml", traces={"scenario": "rig.yaml"})
    with pytest.raises(ScenarioError, match=r"rig\.yaml: case run: gave no trace \(.*start energy"):
        calibrate_study(study_file, None, tmp_path / "out", lambda at, remark: None)


def test_table_4_comes_out_of_the_real_recordings_through_the_command_line(
    butterfly_data: Path, tmp_path: Path
) -> None:
    thesis = str(STUDIES / "thesis.yaml")
    document = calibrate(thesis, "--data", str(butterfly_data), "--out", str(tmp_path / "out"))
    assert values(document, "as published") == pytest.approx([4.1889, 5.7606, 6.281], rel=3e-3)
    assert [load["added_mass"] for load in document["resonance"]["as published"]] == [0.052, 0.1205, 0.154]
    assert len(document["data"]) == len(list(butterfly_data.glob("Data_*.mat")))
    assert document["parameters"]["hand.viscous_friction"]["value"] == pytest.approx(0.02, rel=0.1)


def test_the_synthetic_campaign_gives_eq_100_as_published_and_eq_79_when_corrected(tmp_path: Path) -> None:
    document = calibrate(str(STUDIES / "synthetic.yaml"), "--out", str(tmp_path / "out"))
    assert values(document, "as published") == pytest.approx([3.7739, 3.7704, 4.2643, 4.7614, 5.2448], abs=5e-3)
    assert values(document, "corrected") == pytest.approx([3.8788, 3.9741, 4.2436, 4.6489, 5.1447], rel=5e-4)
    for entry in document["parameters"].values():
        assert entry["value"] == pytest.approx(entry["truth"], rel=1e-3)
