"""Results judged on other recordings, and folders and recordings that cannot be."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import Result

from fmus.packaging import archive
from identification.calibrate import calibrate_study
from identification.validation import validate_result
from orchestrator.results import RECORD
from tests.support.commands import servotwin
from tests.support.identification.small_study import write_study

pytestmark = pytest.mark.usefixtures("in_this_process")


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory, data: Path) -> Path:
    """A calibration of one parameter."""
    folder = tmp_path_factory.mktemp("result")
    study_file = write_study(folder / "study.yaml", parameters={"hand.inertia": {"start": 0.004, "min": 0.001}})
    calibrate_study(study_file, data, folder / "out", lambda at, remark: None)
    return folder / "out"


def validate(folder: Path, data: Path, *options: object) -> Result:
    return servotwin("validate", folder, "--data", data, *options)


def test_a_validation_that_misses_its_target_has_exit_code_1_and_still_leaves_its_report(
    result: Path, data: Path, tmp_path: Path
) -> None:
    """One parameter alone cannot make up for the others, which are the library's."""
    answer = validate(result, data, "--out", tmp_path / "out", "--json")
    assert answer.exit_code == 1, answer.stderr
    document = json.loads(answer.stdout)
    assert document["held"] is False and document["fit"]["unseen"]["median"] < document["at_least"]
    assert {path.name for path in (tmp_path / "out").iterdir()} - {RECORD} == {"summary.json", "report.html"}


def test_recordings_are_known_by_their_bytes_not_by_their_names(result: Path, data: Path, tmp_path: Path) -> None:
    shutil.copyfile(data / "rig_0__a.csv", tmp_path / "rig_0__renamed.csv")
    document = json.loads(validate(result, tmp_path, "--out", tmp_path / "out", "--json").stdout)
    assert set(document["fit"]) == {"fitted"}
    assert document["warnings"] == ["every recording was used in the fit; this judges nothing new"]


def test_one_file_can_be_validated_and_lies_beside_the_result_by_default(
    result: Path, data: Path, tmp_path: Path
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(result, copy)
    document = json.loads(validate(copy, data / "rig_100__c.csv", "--json").stdout)
    assert set(document["fit"]["unseen"]["traces"]) == {"rig_100__c"}
    assert (copy / "validation" / "report.html").is_file()


@pytest.mark.parametrize(
    ("spoil", "problem"),
    [
        (shutil.rmtree, "holds no study.yaml; give a folder that `servotwin calibrate` wrote"),
        (lambda folder: (shutil.rmtree(folder), folder.touch()), "holds no study.yaml"),
        (lambda folder: (folder / "study.yaml").unlink(), "holds no study.yaml"),
        (lambda folder: (folder / "summary.json").unlink(), "holds no summary.json"),
        (lambda folder: (folder / "summary.json").write_text("{"), "is not a calibration's summary"),
        (lambda folder: (folder / "summary.json").write_text("[]"), "is not a calibration's summary"),
        (lambda folder: (folder / "fmus" / "hand.fmu").unlink(), "hand.fmu: no such file"),
        (lambda folder: archive.write(folder / "fmus" / "hand.fmu", {"a": b""}), "holds no modelDescription.xml"),
    ],
)
def test_a_folder_that_is_no_result_is_refused_in_one_line(
    result: Path, data: Path, tmp_path: Path, spoil: Callable[[Path], Any], problem: str
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(result, copy)
    spoil(copy)
    answer = validate(copy, data, "--out", tmp_path / "out", "--json")
    assert answer.exit_code == 2 and json.loads(answer.stdout)["error"]["exit_code"] == 2
    (line,) = answer.stderr.splitlines()
    assert problem in line
    assert not (tmp_path / "out").exists()


def test_recordings_that_a_result_cannot_read_are_refused(result: Path, tmp_path: Path) -> None:
    answer = validate(result, tmp_path / "none", "--out", tmp_path / "out")
    assert answer.exit_code == 2 and "none: no such file or folder" in answer.stderr
    assert list(tmp_path.iterdir()) == []


def test_validating_twice_gives_the_same_verdict(result: Path, data: Path, tmp_path: Path) -> None:
    one, other = (validate_result(result, data, tmp_path / name, lambda at, remark: None) for name in ("a", "b"))
    assert one == other
