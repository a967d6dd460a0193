"""The folder that a calibration leaves: truth within intervals, FMUs and files that others use, the same bits again."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from fmpy.ssp.ssd import read_ssv

from fmus.packaging import archive, defaults, targets
from fmus.parameters.write_back import PROVENANCE
from identification.validation import validate_result
from orchestrator import formats
from orchestrator.processes.pool import at_most
from orchestrator.progress import silent
from orchestrator.results import RECORD
from tests.support.identification.small_study import (
    LENGTH,
    STEP,
    TRUTH,
    calibrated,
    simulated,
    study,
    summary,
    voltage,
    write_study,
)
from tests.support.ssv import read_values

pytestmark = pytest.mark.usefixtures("in_this_process")


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory, data: Path) -> Path:
    """The folder that the calibration of the small study leaves."""
    folder = tmp_path_factory.mktemp("result")
    compare = {"the start": {name: block["start"] for name, block in study()["parameters"].items()}}
    calibrated(write_study(folder / "small.yaml", compare=compare), data, folder / "out")
    return folder / "out"


def test_the_truth_lies_inside_the_intervals_and_these_are_narrow(result: Path) -> None:
    for name, entry in summary(result)["parameters"].items():
        low, high = entry["ci95"]
        assert low <= TRUTH[name] <= high, name
        assert low <= entry["value"] <= high
        assert high - low < 0.03 * TRUTH[name], name
        assert entry["std"] > 0 and entry["truth"] == TRUTH[name]


def test_the_fit_of_unseen_traces_is_what_the_noise_leaves(result: Path) -> None:
    fit = summary(result)["fit"]
    assert set(fit["train"]["traces"]) == {"rig_0__a", "rig_50__b"}
    assert set(fit["validation"]["traces"]) == {"rig_100__c"}
    unseen = simulated(voltage(2), 0.1)
    left = 1 - 2e-4 / unseen.std()
    assert fit["validation"]["median"] == pytest.approx(left, abs=4e-4)


def test_other_parameters_are_judged_on_the_same_unseen_windows(result: Path, data: Path) -> None:
    fit = summary(result)["fit"]
    compared = fit["compared"]["the start"]
    assert compared["windows"] == fit["validation"]["windows"]
    start = {name: block["start"] for name, block in study()["parameters"].items()}
    measured = formats.read(data / "rig_100__c.csv").trace["angle"]
    error = np.linalg.norm(measured - simulated(voltage(2), 0.1, start))
    expected = 1 - error / np.linalg.norm(measured - measured.mean())
    assert compared["median"] == pytest.approx(expected, abs=1e-9)


def test_the_folder_holds_what_was_promised(result: Path) -> None:
    files = {str(path.relative_to(result)) for path in result.rglob("*") if path.is_file()} - {RECORD}
    parameters = {"parameters.ssv", "parameters.srmd"}
    free_run = {"free_run.yaml", "free_run.ssp", "free_run_commands.csv", "free_run_outputs.csv"}
    told = {"summary.json", "report.html", "study.yaml"}
    assert files == {"fmus/motor.fmu", "fmus/hand.fmu", *parameters, *free_run, *told}
    assert (result / "study.yaml").read_bytes() == (result.parent / "small.yaml").read_bytes()
    values = {name: entry["value"] for name, entry in summary(result)["parameters"].items()}
    assert read_values(result / "parameters.ssv") == values | {"hand.added_length": LENGTH}
    read_ssv(str(result / "parameters.ssv"), validate=True)


def test_importers_step_as_the_study_did(result: Path) -> None:
    for name in ("motor", "hand"):
        description = read_model_description(str(result / "fmus" / f"{name}.fmu"))
        assert float(description.defaultExperiment.stepSize) == STEP


def test_the_summary_has_every_key_that_others_rely_on(result: Path, data: Path) -> None:
    document = summary(result)
    for entry in document["parameters"].values():
        assert set(entry) >= {"value", "std", "ci95", "unit"}
    assert document["parameters"]["hand.inertia"]["unit"] == "kg.m2"
    assert document["parameters"]["hand.inertia"]["start"] == 0.006
    assert document["method"] == "output-error" and document["warnings"] == []
    assert {each["file"] for each in document["data"]} == {path.name for path in data.iterdir()}
    assert all(re.fullmatch(r"[0-9a-f]{64}", each["sha256"]) for each in document["data"])
    assert [each["role"] for each in document["data"]].count("held out") == 1
    assert {"servotwin", "python", "numpy", "scipy", "fmpy"} <= set(document["versions"])


def test_the_report_needs_no_network_and_names_every_parameter(result: Path) -> None:
    html = (result / "report.html").read_text()
    assert not re.search(r"https?://|@import|url\(|src=|<link", html)
    for name in TRUTH:
        assert name in html
    for word in ("A small rig", "rig_100__c", "numpy", summary(result)["data"][0]["sha256"]):
        assert word in html


def test_the_fmus_carry_the_estimates_as_defaults_and_where_they_come_from(result: Path) -> None:
    values = {name: entry["value"] for name, entry in summary(result)["parameters"].items()}
    files = archive.read(result / "fmus" / "hand.fmu")
    used = defaults.load(files[defaults.RESOURCE].decode())
    assert {f"hand.{name}": used[name] for name in ("inertia", "gravity_torque", "viscous_friction")} == {
        name: value for name, value in values.items() if name.startswith("hand.")
    }
    assert used["added_length"] == LENGTH and used["added_mass"] == 0
    assert json.loads(files[PROVENANCE])["data"] == summary(result)["data"]


def test_the_written_fmus_judged_with_nothing_set_fit_to_the_last_bit_as_in_the_calibration(
    result: Path, data: Path, tmp_path: Path
) -> None:
    document = validate_result(result, data, tmp_path / "validation", silent)
    fit = summary(result)["fit"]
    assert document["fit"] == {"unseen": fit["validation"], "fitted": fit["train"]}
    assert document["held"] and document["at_least"] == 0.95
    assert {each["trace"]: each["role"] for each in document["data"]}["rig_100__c"] == "held out"
    assert summary(tmp_path / "validation") == document
    assert (tmp_path / "validation" / "report.html").is_file()


def test_the_same_inputs_give_the_same_result_bit_for_bit(result: Path, data: Path, tmp_path: Path) -> None:
    calibrated(result / "study.yaml", data, tmp_path / "again")
    assert_same_result(tmp_path / "again", result)


def test_the_number_of_processes_changes_no_bit(data: Path, tmp_path: Path) -> None:
    traces = study()["traces"] | {"hold_out": []}
    study_file = write_study(tmp_path / "study.yaml", traces=traces, options={"max_evaluations": 4})
    for processes in (1, 2):
        with at_most(processes):
            calibrated(study_file, data, tmp_path / str(processes))
    assert_same_result(tmp_path / "1", tmp_path / "2")


def assert_same_result(one: Path, other: Path) -> None:
    for name in ("summary.json", "parameters.ssv", "fmus/hand.fmu", "fmus/motor.fmu"):
        assert (one / name).read_bytes() == (other / name).read_bytes(), name


def test_a_second_calibration_replaces_the_first(result: Path, data: Path, tmp_path: Path) -> None:
    target = tmp_path / "out"
    fixed = {name: {"start": value, "fixed": name != "hand.inertia"} for name, value in TRUTH.items()}
    for title in ("first", "second"):
        calibrated(write_study(tmp_path / "study.yaml", title=title, parameters=fixed), data, target)
    assert summary(target)["title"] == "second"
    assert {path.name for path in tmp_path.iterdir()} == {"out", "study.yaml"}


def test_a_calibrated_fmu_in_another_tool_swings_as_the_true_rig(result: Path) -> None:
    """FMPy alone, nothing set: a released pendulum has the period of the true one."""
    run = simulate_fmu(
        str(result / "fmus" / "hand.fmu"), stop_time=3, output_interval=0.01, start_values={"angle_start": 0.05}
    )
    values = {name.removeprefix("hand."): value for name, value in TRUTH.items() if "hand" in name}
    truth = targets.build("pendulum", result.parent / "true.fmu", parameters=values, target="python")
    other = simulate_fmu(str(truth), stop_time=3, output_interval=0.01, start_values={"angle_start": 0.05})
    assert np.max(np.abs(run["angle"] - other["angle"])) < 5e-4
