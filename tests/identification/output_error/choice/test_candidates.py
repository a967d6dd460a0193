"""A study with candidates, from its file to a result folder, on real FMUs with known truth."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import FmuError, ScenarioError, WiringError
from identification.calibrate import calibrate_study
from identification.estimation.stopped import EstimationInterrupted
from identification.output_error.calibration import PreparedStudy
from identification.output_error.choice.change import of_candidate
from identification.output_error.windows import cut_windows
from identification.recordings.campaign import load_campaign
from identification.study import load_study
from identification.validation import validate_result
from orchestrator import formats
from orchestrator.progress import silent
from tests.support.identification.small_study import COUNT, STEP, TRUTH, plain_study, record, study, write_study
from tests.support.ssv import read_values

pytestmark = pytest.mark.usefixtures("in_this_process")

Document = dict[str, Any]
DRY: Document = {
    "hand.coulomb_friction_positive": {"start": 1e-4, "min": 0.0, "max": 0.05},
    "hand.coulomb_friction_negative": {"tied": "hand.coulomb_friction_positive"},
}
FREE: Document = {"set": {"hand.viscous_friction": 0.0}}
LAG: Document = {"start": 0.001, "min": -0.02, "max": 0.02}
LATE: Document = {
    "outputs": {"hand.angle": {"signal": "angle", "delay": "lag"}},
    "parameters": {"lag": LAG},
}


def calibrated(folder: Path, data: Path, candidates: Document, **changes: Any) -> Document:
    """What `summary.json` in `folder/out` holds."""
    file = write_study(folder / "study.yaml", candidates=candidates, **changes)
    calibrate_study(file, data, folder / "out", silent)
    document: Document = json.loads((folder / "out" / "summary.json").read_text())
    return document


def test_the_right_candidate_is_chosen_written_and_judged_like_one_alone(data: Path, tmp_path: Path) -> None:
    candidates = {"viscous": {}, "frictionless": FREE, "dry too": {"parameters": DRY}}
    document = calibrated(tmp_path, data, candidates)
    choice = document["choice"]
    assert document["candidate"] == choice["chosen"] == "viscous"
    assert next(iter(choice["candidates"])) == "viscous"
    assert choice["candidates"]["frictionless"]["state"] == "apart"
    assert {name: one["unknowns"] for name, one in choice["candidates"].items()} == {
        "viscous": 4,
        "frictionless": 3,
        "dry too": 5,
    }
    calibrate_study(write_study(tmp_path / "alone.yaml"), data, tmp_path / "alone", silent)
    alone = json.loads((tmp_path / "alone" / "summary.json").read_text())
    assert document["parameters"] == alone["parameters"]
    assert document["fit"] == alone["fit"]
    assert read_values(tmp_path / "out" / "parameters.ssv") == read_values(tmp_path / "alone" / "parameters.ssv")


def test_a_result_folder_holds_the_study_of_the_chosen_candidate(data: Path, tmp_path: Path) -> None:
    wrong = {"set": {"hand.inertia": 0.01, "motor.torque_gain": 8.0}}
    dry = {"parameters": {**DRY, "hand.viscous_friction": None}}
    document = calibrated(tmp_path, data, {"wrong": wrong, "dry": dry}, truth={})
    kept = load_study(tmp_path / "out" / "study.yaml").block
    assert document["candidate"] == "dry" and kept.candidates == {}
    assert list(kept.parameters) == [name for name in TRUTH if name != "hand.viscous_friction"] + list(DRY)
    found = validate_result(tmp_path / "out", data, tmp_path / "validation", silent)
    assert found["fit"]["unseen"]["median"] == pytest.approx(document["fit"]["validation"]["median"], abs=1e-9)


def test_one_that_nothing_tells_from_the_chosen_one_is_said(data: Path, tmp_path: Path) -> None:
    """Back EMF and viscous friction act as one sum."""
    emf = {"set": {"hand.viscous_friction": 0.0}, "parameters": {"motor.back_emf": {"start": 1e-4, "min": 0}}}
    document = calibrated(tmp_path, data, {"viscous": {}, "back EMF": emf}, truth={})
    [alike] = [name for name, one in document["choice"]["candidates"].items() if one["state"] == "alike"]
    [said] = [warning for warning in document["warnings"] if "not distinguishable" in warning]
    assert said.startswith(f"candidates: {alike} not distinguishable from {document['candidate']}, which is written")
    assert said in (tmp_path / "out" / "report.html").read_text()


def test_one_that_fails_is_a_row_with_the_reason(data: Path, tmp_path: Path) -> None:
    broken = {"set": {"motor.torque_gain": 1e308}}
    document = calibrated(tmp_path, data, {"broken": broken, "viscous": {}, "frictionless": FREE})
    failed = document["choice"]["candidates"]["broken"]
    assert document["candidate"] == "viscous"
    assert failed["state"] == "failed" and failed["remark"]
    assert any(warning.startswith("candidates: broken failed") for warning in document["warnings"])


def test_where_all_fail_that_is_an_error_with_the_first_reason(data: Path, tmp_path: Path) -> None:
    broken = {"motor.torque_gain": 1e308}
    candidates = {"one": {"set": broken}, "other": {"set": {**broken, "hand.viscous_friction": 0.0}}}
    with pytest.raises(FmuError, match=r"candidates\.one: fails as all others do"):
        calibrated(tmp_path, data, candidates)
    assert not (tmp_path / "out").exists()


def test_a_delay_is_found_and_all_are_compared_at_the_same_instants(data: Path, tmp_path: Path) -> None:
    document = calibrated(tmp_path, data, {"prompt": {}, "late": LATE}, truth={})
    late = document["choice"]["candidates"]["late"]
    assert document["candidate"] == "prompt" and late["state"] != "failed"
    assert abs(late["parameters"]["lag"]["value"]) < 3 * late["parameters"]["lag"]["std"]
    assert late["unknowns"] == 5


def test_a_run_is_compared_at_the_instants_that_suit_the_delays_of_those_beside_it(data: Path) -> None:
    plain, late = plain_study(), plain_study(**of_candidate(study(candidates={"late": LATE}), "late"))
    source = replace(plain.traces, folder=data)
    alone, beside = (
        cut_windows(run, load_campaign(source), plain.windows)
        for run in (plain.run, replace(plain.run, beside=(late.run,)))
    )
    lag = round(LAG["max"] / STEP)
    assert [window.at.tolist() for window in beside] == [[*range(lag, COUNT - lag)]] * len(beside)
    assert [len(window.measured) for window in alone] == [COUNT] * len(alone)


def test_windows_in_samples_are_those_of_each_candidate(data: Path, tmp_path: Path) -> None:
    initial = {"hand.angle_start": {"signal": "angle", "half_width": "3 samples"}}
    changes = {"windows": {"length": "100 samples"}, "validation": {"length": "50 samples"}, "initial": initial}
    document = calibrated(tmp_path, data, {"viscous": {}, "frictionless": FREE}, **changes)
    assert document["choice"]["windows"] == document["fit"]["validation"]["windows"] == 2


def test_noise_that_leaves_few_independent_samples_is_said(tmp_path: Path) -> None:
    """A drift of the sensor, as long as the recordings, is what all candidates leave over."""
    folder = record(tmp_path / "drifting")
    for file in folder.iterdir():
        trace = formats.read(file).trace
        drift = 5e-3 * np.sin(4 * trace.time + len(file.stem))
        formats.write(replace(trace, signals={**trace.signals, "angle": trace["angle"] + drift}), file)
    document = calibrated(tmp_path, folder, {"viscous": {}, "dry too": {"parameters": DRY}}, truth={})
    [said] = [warning for warning in document["warnings"] if "independent samples" in warning]
    assert said.startswith("candidates: the noise is so correlated that criteria count ") and "5 unknowns" in said
    assert document["choice"]["samples"] < 50


def test_without_a_trace_held_out_that_is_said(data: Path, tmp_path: Path) -> None:
    traces = {**study()["traces"], "hold_out": []}
    document = calibrated(tmp_path, data, {"viscous": {}, "frictionless": FREE}, traces=traces, validation=None)
    assert document["candidate"] == "viscous"
    assert document["choice"]["candidates"]["viscous"]["prediction"] is None
    assert any("no trace is held out" in warning for warning in document["warnings"])


@pytest.mark.parametrize(
    ("candidates", "said"),
    [
        ({"a": {}}, r"candidates\.a: is no choice alone"),
        ({"a": {}, "b": {}}, r"candidates\.b: is the same as a"),
        ({"a": {}, "b": {"set": {"hnd.x": 1.0}}}, r"candidates\.b: set\.hnd\.x: there is no component 'hnd'"),
        ({"a": {}, "b": {"free": ["hand.x"]}}, r"candidates\.b: free: 'hand\.x' is no parameter"),
        ({"a": {}, "b": {"parameters": {"hand.q": None}}}, r"candidates\.b: parameters\.hand\.q: is not there"),
        (
            {"a": {}, "b": {"outputs": {"hand.angle": None, "hand.speed": {"signal": "voltage"}}}},
            r"candidates\.a: shares no output with all others \(a: angle; b: voltage\)",
        ),
    ],
)
def test_candidates_that_are_no_choice_are_refused_at_their_line(
    tmp_path: Path, candidates: Document, said: str
) -> None:
    file = write_study(tmp_path / "study.yaml", candidates=candidates)
    with pytest.raises(ScenarioError, match=rf"study\.yaml:\d+: {said}"):
        load_study(file)


def test_a_name_twice_is_refused_at_its_line(tmp_path: Path) -> None:
    file = write_study(tmp_path / "study.yaml", candidates={"a": {}, "b": FREE})
    file.write_text(file.read_text().replace('"b": {', '"a": {'))
    with pytest.raises(ScenarioError, match=r'study\.yaml:\d+: is not YAML \(found duplicate key "a"'):
        load_study(file)


def test_a_variable_that_a_model_has_not_ends_all_before_anything_runs(data: Path, tmp_path: Path) -> None:
    wrong = {"set": {"hand.frction": 0.0}}
    with pytest.raises(WiringError, match=r"candidates\.wrong: .*hand\.frction"):
        calibrated(tmp_path, data, {"right": {}, "wrong": wrong})


def test_an_interrupt_leaves_the_best_of_those_that_were_done(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitted: Callable[..., Any] = PreparedStudy.calibrated
    done: list[str] = []

    def until_the_third(self: PreparedStudy, *given: Any) -> Any:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append("one more")
        return fitted(self, *given)

    monkeypatch.setattr(PreparedStudy, "calibrated", until_the_third)
    file = write_study(tmp_path / "s.yaml", candidates={"free": FREE, "viscous": {}, "dry": {"parameters": DRY}})
    with pytest.raises(EstimationInterrupted):
        calibrate_study(file, data, tmp_path / "out", silent)
    document = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert document["candidate"] == "viscous"
    assert document["verdict"]["said"] == "STOPPED, interrupted before dry was done"
    assert any("dry not tried" in warning for warning in document["warnings"])


def test_intervals_that_are_asked_for_are_those_of_the_chosen_one(data: Path, tmp_path: Path) -> None:
    document = calibrated(tmp_path, data, {"viscous": {}, "frictionless": FREE}, uncertainty="profile")
    assert document["candidate"] == "viscous"
    assert set(document["uncertainty"]["profiles"]) == set(TRUTH)
    low, high = document["parameters"]["hand.viscous_friction"]["ci95"]
    assert low < TRUTH["hand.viscous_friction"] < high and np.isfinite([low, high]).all()
