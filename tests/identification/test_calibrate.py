"""Calibrations on the command line: what is said last, and what is left however they end."""

from __future__ import annotations

import hashlib
import itertools
import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from typer.testing import Result

from fmus.errors import FmuError
from identification.calibrate import calibrate_study, layout_of
from identification.output_error import calibration
from identification.output_error.free_runs.simulator import SystemSimulator
from identification.validation import validate_result
from orchestrator.processes import pool
from orchestrator.scenario.exchange import export
from tests.support.commands import servotwin
from tests.support.identification.small_study import study, write_study

pytestmark = pytest.mark.usefixtures("in_this_process")


def test_progress_of_a_calibration_never_goes_back_and_ends_full(tmp_path: Path, data: Path) -> None:
    told: list[float] = []
    calibrate_study(write_study(tmp_path / "study.yaml"), data, tmp_path / "out", lambda at, remark: told.append(at))
    assert told == sorted(told) and told[-1] == 1 and all(0 <= at <= 1 for at in told)


def calibrated(folder: Path, data: Path, *options: object, **changes: Any) -> Result:
    study_file = write_study(folder / "study.yaml", **changes)
    return servotwin("calibrate", study_file, "--data", data, "--out", folder / "out", *options)


@pytest.mark.slow
def test_a_calibration_whose_validation_misses_its_target_ends_with_exit_code_1_and_says_so_last(
    tmp_path: Path, data: Path
) -> None:
    answer = calibrated(tmp_path, data, validation={"length": 1, "at_least": 1.0})
    assert answer.exit_code == 1
    assert answer.stdout.splitlines()[-1].startswith("MISSED: median FIT, unseen, 0.9")
    assert "± 95 %: intervals take the model, and whatever is fixed in it" in " ".join(answer.stdout.split())
    verdict = json.loads((tmp_path / "out" / "summary.json").read_text())["verdict"]
    assert not verdict["held"] and verdict["converged"] and 0.9 < verdict["reached"] < verdict["at_least"] == 1.0
    assert "MISSED: median FIT, unseen" in (tmp_path / "out" / "report.html").read_text()


def test_the_command_line_says_how_many_simulations_run_at_a_time(
    tmp_path: Path, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []
    monkeypatch.setattr(calibration, "processors", lambda: asked.append(pool.processors()) or 1)
    monkeypatch.setattr(calibration, "_SHORT", 0)
    assert calibrated(tmp_path, data, "-j", "3").exit_code == 0
    assert set(asked) == {3}


def test_a_target_without_recordings_held_out_is_for_the_fitted_ones(tmp_path: Path, data: Path) -> None:
    traces = study()["traces"] | {"hold_out": []}
    answer = calibrated(tmp_path, data, traces=traces, validation={"length": 1, "at_least": 0.5})
    assert answer.exit_code == 0
    assert answer.stdout.splitlines()[-1].startswith("held: median FIT, fitted (no trace was held out), 0.9")


def test_an_interrupt_leaves_what_had_been_estimated(
    tmp_path: Path, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs, simulate = itertools.count(), SystemSimulator.simulate

    def interrupted(self: SystemSimulator, window: int, values: dict[str, float]) -> Any:
        if next(runs) > 40:
            raise KeyboardInterrupt
        return simulate(self, window, values)

    monkeypatch.setattr(SystemSimulator, "simulate", interrupted)
    answer = calibrated(tmp_path, data)
    out = tmp_path / "out"
    assert answer.exit_code == 130
    (line,) = answer.stderr.splitlines()
    assert line == f"interrupted; what had been estimated is in {out}, without intervals and not validated"
    document = json.loads((out / "summary.json").read_text())
    assert document["verdict"]["said"].startswith("STOPPED, stopped: interrupted; the values are those of iteration")
    assert document["parameters"]["hand.inertia"]["std"] is None and document["fit"]["validation"] is None
    assert {"fmus", "parameters.ssv", "report.html"} <= {path.name for path in out.iterdir()}


def test_an_interrupt_before_anything_was_estimated_says_so(
    tmp_path: Path, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(self: SystemSimulator, window: int, values: dict[str, float]) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(SystemSimulator, "simulate", interrupted)
    answer = calibrated(tmp_path, data)
    assert answer.exit_code == 130 and not (tmp_path / "out").exists()
    assert answer.stderr.strip() == "interrupted before anything was estimated; nothing is written"


def test_fmus_that_fail_in_the_validation_do_not_take_the_estimate_with_them(
    tmp_path: Path, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failed(*_: Any) -> None:
        raise FmuError("hand", "step from t = 0.5 s by 0.01 s: returned error")

    monkeypatch.setattr(calibration, "judge", failed)
    answer = calibrated(tmp_path, data)
    assert answer.exit_code == 3
    (line,) = answer.stderr.splitlines()
    assert line.endswith(f"returned error; what had been estimated is in {tmp_path / 'out'}, not validated")
    document = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert document["parameters"]["hand.inertia"]["std"] is not None
    assert document["verdict"]["said"].startswith("STOPPED, not validated: hand: step from")


def test_a_search_that_was_cut_short_says_on_the_last_line_what_to_do(tmp_path: Path, data: Path) -> None:
    answer = calibrated(tmp_path, data, "--json", options={"max_evaluations": 1}, validation=None)
    assert answer.exit_code == 0
    verdict = json.loads(answer.stdout)["verdict"]
    assert verdict["held"] and not verdict["converged"]
    assert (
        verdict["said"].startswith("NOT CONVERGED: stopped") and "`options.max_evaluations` above 1" in verdict["said"]
    )
    assert "`scale: log` for hand.inertia" in verdict["said"]


def test_the_layout_of_a_study_reads_recordings_elsewhere(tmp_path: Path) -> None:
    traces = study()["traces"] | {"layout": {"time": "t", "columns": {"angle": "theta"}}}
    layout = layout_of(write_study(tmp_path / "study.yaml", traces=traces))
    assert (layout.time, layout.columns) == ("t", {"angle": "theta"})


def test_a_study_takes_its_system_from_an_ssp(tmp_path: Path, data: Path) -> None:
    system = {key: study()[key] for key in ("components", "connections")}
    scenario = {"title": "rig", **system, "run": {"stop": 1, "step": 0.01}}
    (tmp_path / "rig.yaml").write_text(json.dumps(scenario))
    export(tmp_path / "rig.yaml", tmp_path / "rig.ssp")
    plain = write_study(tmp_path / "plain.yaml")
    taken = write_study(tmp_path / "taken.yaml", include=["rig.ssp"], components=None, connections=None)
    expected, found = (
        calibrate_study(file, data, tmp_path / file.stem, lambda fraction, doing: None)["parameters"]
        for file in (plain, taken)
    )
    assert {name: one["value"] for name, one in found.items()} == {name: one["value"] for name, one in expected.items()}
    judged = [
        validate_result(tmp_path / name, data, tmp_path / f"{name}-judged", lambda fraction, doing: None)
        for name in ("taken", "plain")
    ]
    assert judged[0]["fit"] == judged[1]["fit"]


def test_the_parameter_set_comes_with_what_it_is_from(tmp_path: Path, data: Path) -> None:
    summary = calibrate_study(write_study(tmp_path / "s.yaml"), data, tmp_path / "out", lambda fraction, doing: None)
    root = ElementTree.fromstring((tmp_path / "out" / "parameters.srmd").read_bytes())
    content = (tmp_path / "out" / "parameters.ssv").read_bytes()
    assert root.get("checksum") == hashlib.sha3_256(content).hexdigest()
    said = {str(entry.get("keyword")): str(entry.text) for entry in root.iter() if entry.get("keyword")}
    assert said["method"] == "output-error"
    assert all(any(one["sha256"] in text for text in said.values()) for one in summary["data"])
    for name, parameter in summary["parameters"].items():
        low, high = parameter["ci95"] or (None, None)
        assert said[name] == f"95 % from {low!r} to {high!r} {parameter['unit']}"
