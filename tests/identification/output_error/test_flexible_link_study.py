"""The flexible link's study: it finds a known link again, and what it predicts of recordings of the real one."""

from __future__ import annotations

import html
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from fmus.modelling.instance import Instance
from fmus.models.plants import flexible_link
from identification.calibrate import calibrate_study
from identification.output_error import calibration
from identification.validation import validate_result
from orchestrator.trace import FloatArray
from tests.support.commands import servotwin

pytestmark = pytest.mark.slow  # a calibration

STUDIES = Path(__file__).parents[3] / "scenarios" / "flexible_link"
COUNT, STEP = 501, 0.002
TRUTH = {
    "link.torque_gain": 2.7e-3,
    "link.viscous_friction": 0.13,
    "link.coulomb_friction": 0.02,
    "link.cogging_torque": 0.012,
    "link.frequency_1": 2.6,
    "link.participation_1": 0.8,
    "link.frequency_2": 17.5,
    "link.tip_2": -1.1,
    "link.softening": 0.2,
    "link.accelerometer_gain": -1.6,
}
START = {
    "cogging_period": 0.08,
    "angle_start": -14 / 651.9,
    "encoder_gain": 651.9,
    "accelerometer_offset": 1.0,
    "accelerometer_lowest": -150.0,
    "accelerometer_highest": 150.0,
}


def unseen(study: str, data: Path, folder: Path) -> dict[str, dict[str, float]]:
    """FIT of free runs over whole recordings kept out of the fit: medians of `outputs` and of `traces`."""
    document = calibrate_study(STUDIES / study, data, folder, lambda fraction, remark: None)
    validation: dict[str, dict[str, float]] = document["fit"]["validation"]
    return validation


def command(number: int) -> FloatArray:
    """(K,) a swept sine, another one for each recording, in whole counts."""
    time = np.arange(COUNT) * STEP
    return np.round((90 + 20 * number) * np.sin(2 * math.pi * (1.5 + number + 9 * time) * time))


def readings(driven: FloatArray) -> FloatArray:
    """(K, 2) encoder and accelerometer of the true link in whole counts, by the model's functions alone."""
    link = Instance(flexible_link.MODEL, START | {name.removeprefix("link."): each for name, each in TRUTH.items()})
    rows = []
    for k, value in enumerate(driven.tolist()):
        rows.append([link.get("encoder"), link.get("accelerometer")])
        link.set("command", value)
        link.step(k * STEP, STEP)
    return np.round(np.array(rows))


def record(folder: Path) -> Path:
    """The folder, filled with three recordings in the format of the real link's."""
    folder.mkdir()
    for number in range(3):
        driven = command(number)
        table = np.column_stack([np.arange(COUNT) * STEP, np.arange(COUNT), driven, driven, readings(driven)])
        np.savetxt(folder / f"sweep{number}.txt", table, "%.10g", "\t", header="link\nt n u v theta a")
    return folder


def small_study(path: Path) -> Path:
    """The real link's study with fewer unknowns, which start up to 10 % off, and other recordings."""
    document: dict[str, Any] = YAML(typ="safe").load((STUDIES / "calibration.yaml").read_text())
    given = {name: each for name, each in START.items() if name != "angle_start"}
    document["components"]["link"]["parameters"] |= given
    document["traces"]["hold_out"] = ["sweep2"]
    document["windows"]["length"] = document["validation"]["length"] = (COUNT - 1) * STEP
    off = dict.fromkeys(TRUTH, 1.1) | {"link.frequency_1": 1.03, "link.frequency_2": 0.98}
    free = document["parameters"]
    document["parameters"] = {name: free[name] | {"start": off[name] * each} for name, each in TRUTH.items()}
    with path.open("w") as file:
        YAML().dump(document | {"truth": TRUTH}, file)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with recordings in `data`, what the small study makes of them in `out`, what is printed in `printed`."""
    folder = tmp_path_factory.mktemp("link")
    study, data = small_study(folder / "study.yaml"), record(folder / "data")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration, "processors", lambda: 1)
        answer = servotwin("calibrate", study, "--data", data, "--out", folder / "out")
    assert answer.exit_code == 0, answer.stderr
    (folder / "printed").write_text(answer.stdout)
    return folder


@pytest.fixture
def summary(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "out" / "summary.json").read_text())
    return document


def test_the_study_finds_a_known_link_in_whole_counts(summary: dict[str, Any]) -> None:
    for name, entry in summary["parameters"].items():
        assert entry["value"] == pytest.approx(TRUTH[name], rel=0.03), name


def test_what_the_study_predicts_is_off_by_what_rounding_leaves(summary: dict[str, Any]) -> None:
    measured = readings(command(2))
    for fit, column in zip(summary["fit"]["validation"]["outputs"].values(), measured.T, strict=True):
        assert 1 - 1.6 * math.sqrt(1 / 12) / column.std() < fit < 1


def test_fit_is_told_by_output_in_summary_and_report_and_on_the_terminal(folder: Path, summary: dict[str, Any]) -> None:
    for group in ("train", "validation"):
        assert list(summary["fit"][group]["outputs"]) == ["link.encoder", "link.accelerometer"]
    assert "Median FIT of the trace's windows, by output" in html.unescape((folder / "out" / "report.html").read_text())
    for name, fit in summary["fit"]["validation"]["outputs"].items():
        assert f"  {name}: {fit:.4f}\n" in (folder / "printed").read_text()


def test_validating_the_result_gives_each_output_the_same_fit(
    folder: Path, summary: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calibration, "processors", lambda: 1)
    judged = validate_result(folder / "out", folder / "data", tmp_path / "v", lambda fraction, remark: None)
    for name, fit in summary["fit"]["validation"]["outputs"].items():
        assert judged["fit"]["unseen"]["outputs"][name] == pytest.approx(fit, abs=1e-9)


def test_grey_box_predicts_unseen_recordings_of_the_real_link(flexible_link_data: Path, tmp_path: Path) -> None:
    found = unseen("calibration.yaml", flexible_link_data, tmp_path / "out")
    assert found["outputs"]["link.accelerometer"] > 0.76
    assert found["outputs"]["link.encoder"] > 0.8
    assert min(found["traces"].values()) > 0.65


def test_linear_model_predicts_unseen_recordings_of_the_real_link(flexible_link_data: Path, tmp_path: Path) -> None:
    found = unseen("subspace.yaml", flexible_link_data, tmp_path / "out")
    assert found["outputs"]["a"] > 0.7
    assert found["outputs"]["theta"] > 0.55
