"""What is written for other tools: sets beside an FMU that cannot be changed, and choices by name."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from fmpy.ssp.ssd import read_ssd

from fmus.errors import WiringError
from fmus.packaging import archive, defaults, targets
from fmus.parameters.ssv import parameter_set
from identification.validation import validate_result
from orchestrator import formats
from orchestrator.progress import silent
from orchestrator.scenario.run import run_scenario
from tests.support.identification.small_study import LENGTH, STEP, TRUTH, calibrated, study, write_study
from tests.support.ssv import read_values

pytestmark = pytest.mark.usefixtures("in_this_process")


def foreign(path: Path) -> Path:
    """The pendulum's FMU as if another tool had made it."""
    targets.build("pendulum", path, target="python")
    files = archive.read(path)
    text = files["modelDescription.xml"].replace(b'generationTool="servotwin"', b'generationTool="Somebody"')
    archive.write(path, files | {"modelDescription.xml": text})
    return path


@pytest.mark.slow
def test_a_foreign_fmu_is_calibrated_by_sets_beside_it_and_validated_with_them(data: Path, tmp_path: Path) -> None:
    source = foreign(tmp_path / "Hand.fmu")
    before = source.read_bytes()
    components = study()["components"] | {"hand": {"fmu": "Hand.fmu", "parameters": {"added_length": LENGTH}}}
    document = calibrated(write_study(tmp_path / "study.yaml", components=components), data, tmp_path / "out")
    fmus = tmp_path / "out" / "fmus"
    names = {"motor.fmu", "hand.fmu", "hand.ssv", "hand.ssp", "hand.provenance.json"}
    assert {path.name for path in fmus.iterdir()} == names
    assert source.read_bytes() == (fmus / "hand.fmu").read_bytes() == before
    values = {
        name.removeprefix("hand."): entry["value"]
        for name, entry in document["parameters"].items()
        if name.startswith("hand.")
    }
    assert read_values(fmus / "hand.ssv") == {"added_length": LENGTH, **values}
    assert read_ssd(str(fmus / "hand.ssp"), validate=True).system.elements[0].source == "resources/Hand.fmu"
    for name, entry in document["parameters"].items():
        low, high = entry["ci95"]
        assert low <= TRUTH[name] <= high, name
    verdict = validate_result(tmp_path / "out", data, tmp_path / "judged", silent)
    assert verdict["fit"]["unseen"] == document["fit"]["validation"]
    inertia = read_values(fmus / "hand.ssv")["inertia"]
    units = {"inertia": "g.m2"}  # as another tool may write it
    changed = parameter_set("changed", {"added_length": LENGTH, **values, "inertia": 1000 * float(inertia)}, units)
    (fmus / "hand.ssv").write_bytes(changed)
    verdict = validate_result(tmp_path / "out", data, tmp_path / "judged", silent)
    assert verdict["fit"]["unseen"]["median"] == pytest.approx(document["fit"]["validation"]["median"], abs=1e-9)
    (fmus / "hand.ssv").write_bytes(changed.replace(b'unit="g.m2"', b'unit="bar"'))
    with pytest.raises(WiringError, match=r"hand\.inertia: bar does not fit kg\.m2"):
        validate_result(tmp_path / "out", data, tmp_path / "judged", silent)


@pytest.mark.slow
def test_choices_given_by_name_are_written_back_too(tmp_path: Path, data: Path) -> None:
    """A source inside the system: its shape is a name in the study and must be a default of its FMU afterwards."""
    driven = {"drive": {"model": "excitation", "parameters": {"shape": "square", "amplitude": 0.01, "frequency": 2.0}}}
    rig: dict[str, Any] = {
        "title": "A driven rig",
        "components": driven
        | {
            "motor": {"model": "dc_motor", "parameters": {"torque_gain": 8.0}},
            "hand": {"model": "pendulum", "parameters": {"inertia": 0.004}},
        },
        "connections": ["drive.signal -> motor.voltage", *study()["connections"]],
    }
    run_rig(tmp_path / "rig.yaml", rig, tmp_path / "driven.csv")
    components = rig["components"] | {"hand": {"model": "pendulum"}, "motor": {"model": "dc_motor"}}
    study_file = write_study(
        tmp_path / "study.yaml",
        components=components,
        connections=rig["connections"],
        inputs=None,
        traces={"files": "driven.csv"},
        outputs={"hand.angle": {"signal": "hand.angle"}},
        truth=None,
        parameters={"hand.inertia": {"start": 0.003, "min": 0.001}, "motor.torque_gain": {"start": 7.0, "min": 0.1}},
    )
    document = calibrated(study_file, tmp_path, tmp_path / "out")
    assert document["parameters"]["hand.inertia"]["value"] == pytest.approx(0.004, rel=1e-3)
    used = defaults.load(archive.read(tmp_path / "out" / "fmus" / "drive.fmu")[defaults.RESOURCE].decode())
    assert (used["shape"], used["amplitude"], used["frequency"]) == (3, 0.01, 2.0)
    verdict = validate_result(tmp_path / "out", tmp_path, tmp_path / "judged", silent)
    assert verdict["fit"]["fitted"] == document["fit"]["train"]
    assert verdict["warnings"] == ["every recording was used in the fit; this judges nothing new"]


def run_rig(scenario: Path, rig: Mapping[str, Any], target: Path) -> None:
    scenario.write_text(json.dumps({**rig, "run": {"stop": 1, "step": STEP}, "record": ["hand.angle"]}))
    result = run_scenario(scenario)
    formats.write(result.recorded(result.cases[0]), target)
