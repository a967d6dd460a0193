"""The contract of methods: each in the table keeps it, and other packages add theirs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fmus.errors import ScenarioError
from fmus.packaging import targets
from identification import study
from identification.calibrate import calibrate_study
from identification.method import Calibrated, CalibratedFmu, Method
from identification.recordings.schema import StudyBlock
from identification.results import Summary, read_summary
from identification.study import METHODS, load_study, method
from orchestrator.fmi.isolation import Isolation
from orchestrator.info import about
from orchestrator.progress import Progress, silent
from orchestrator.report import Report
from orchestrator.results import RECORD


class WeighingBlock(StudyBlock):
    """A study of a method that weighs the pendulum."""

    kilograms: float


def weigh(
    block: WeighingBlock, base: Path, data: Path | None, progress: Progress, isolation: Isolation | None
) -> WeighingBlock:
    progress(0.5, "weighing")
    return block


def summary(weighed: WeighingBlock) -> Summary:
    return {
        "title": weighed.title,
        "method": weighed.method,
        "parameters": {
            "hand.added_mass": {"value": weighed.kilograms, "std": None, "ci95": None, "unit": "kg", "start": None}
        },
        "fit": {},
        "data": [],
        "versions": {"servotwin": "0"},
        "warnings": [],
    }


def calibrated(weighed: WeighingBlock, folder: Path) -> Calibrated:
    fmu = targets.build("pendulum", folder / "hand.fmu", target="python")
    values = {"added_mass": weighed.kilograms}
    return Calibrated({"hand": CalibratedFmu(fmu, values)}, {"hand.added_mass": weighed.kilograms}, {})


WEIGHING = Method(WeighingBlock, weigh, summary, lambda weighed: Report(weighed.title), calibrated)


@pytest.fixture
def weighing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another package's entry point."""
    monkeypatch.setattr(study, "plugins", lambda group, fits: {"weighing": WEIGHING} if fits(WEIGHING) else {})


def test_a_method_of_another_package_calibrates_like_ours(weighing: None, tmp_path: Path) -> None:
    file = tmp_path / "scales.yaml"
    file.write_text(json.dumps({"title": "On the scales", "method": "weighing", "kilograms": 0.154}))
    found = calibrate_study(file, None, tmp_path / "out", silent)
    assert found["parameters"]["hand.added_mass"]["value"] == 0.154
    left = {path.name for path in (tmp_path / "out").rglob("*") if path.is_file()} - {RECORD}
    assert left == {"hand.fmu", "parameters.ssv", "parameters.srmd", "summary.json", "report.html", "study.yaml"}
    (mass,) = (
        port for port in about(tmp_path / "out" / "fmus" / "hand.fmu")["parameters"] if port["name"] == "added_mass"
    )
    assert float(mass["start"]) == 0.154
    assert read_summary(tmp_path / "out") == found


def test_an_unknown_method_is_refused_with_those_there_are(weighing: None, tmp_path: Path) -> None:
    (tmp_path / "study.yaml").write_text('{"title": "x", "method": "guess"}')
    with pytest.raises(ScenarioError, match=r"method: 'guess' is unknown; use output-error or .* or weighing"):
        load_study(tmp_path / "study.yaml")


@pytest.mark.parametrize("name", METHODS)
def test_a_methods_name_in_the_table_is_that_of_its_studies(name: str) -> None:
    field = method(name).schema.model_fields["method"]
    assert name in str(field.annotation)
