"""Lengths in samples are those of each recording, on the raster of the free runs, and odd ones are told."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from fmus.errors import ScenarioError
from identification.calibrate import calibrate_study
from identification.output_error import calibration
from identification.output_error.blocks import InitialBlock, WindowsBlock
from identification.output_error.schema import OutputErrorBlock
from identification.output_error.times.spans import Samples, on_raster
from identification.output_error.windows import cut_windows, length_warnings, start_curve
from identification.recordings.campaign import StudyTrace
from orchestrator.trace import Trace
from tests.support.identification.small_study import calibrated, plain_study, record, study, write_study


def recorded(every: float, count: int = 401) -> StudyTrace:
    time = np.asarray(0.7 + np.arange(count) * every, dtype=np.float64)
    trace = Trace(time, {"voltage": np.sin(time), "angle": 2 + 3 * time - 5 * time**2}, name=f"{every}")
    return StudyTrace(trace, {}, Path(f"{every}.csv"), "", "even", values={"hand.added_mass": 0.0})


def test_windows_in_samples_are_as_long_as_those_samples_take() -> None:
    asked = plain_study(step=0.01, windows={"length": "50 samples", "every": "20 samples", "skip": "1 sample"})
    slow, fast = recorded(0.02), recorded(0.01)
    windows = cut_windows(asked.run, [slow, fast], asked.windows)
    own = {trace.trace.name: [w for w in windows if w.trace == trace.trace.name] for trace in (slow, fast)}
    for every, cut in zip((0.02, 0.01), own.values(), strict=True):
        assert {float(window.stop) for window in cut} == {50 * every}
        assert np.diff([window.start for window in cut]) == pytest.approx(20 * every)
        assert cut[0].start == pytest.approx(0.7 + every)
        assert len(cut) == (400 - 1 - 50) // 20 + 1


@given(
    count=st.integers(0, 2000),
    every=st.floats(1e-4, 0.1),
    step=st.fractions(Fraction(1, 5000), 1, max_denominator=5000),
)
def test_samples_are_rounded_to_the_nearest_steps_and_never_to_none(count: int, every: float, step: Fraction) -> None:
    found = on_raster(Samples(count), every, step)
    assert (found / step).denominator == 1
    assert (found == 0) == (count == 0)
    assert abs(float(found) - count * every) <= float(step) * (0.5 + 1e-9) or found == step


def test_what_whole_steps_do_not_make_up_is_told() -> None:
    windows = plain_study(windows={"length": "33 samples", "every": "100 samples"}).windows
    [line] = length_warnings(Fraction(1, 100), windows, [recorded(0.0149).trace, recorded(0.01).trace], "windows")
    assert line == "windows.length: 33 samples of 0.0149 last 0.4917 s, which whole steps make 0.49 s"


def test_a_start_value_is_read_off_so_many_samples_of_its_recording() -> None:
    asked = plain_study(initial={"hand.angle_start": {"signal": "angle", "half_width": "3 samples"}})
    for every in (0.01, 0.2):
        trace = recorded(every, 41).trace
        start = float(trace.time[20])
        curve = start_curve(trace, start, asked.run.initial["hand.angle_start"])
        assert curve(start) == pytest.approx(2 + 3 * start - 5 * start**2)
    few = plain_study(initial={"hand.angle_start": {"signal": "angle"}}).run.initial["hand.angle_start"]
    with pytest.raises(Exception, match="widen `half_width`, to `3 samples` or more"):
        start_curve(trace, start, few)


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({"length": "0 samples"}, "must be positive"),
        ({"length": "5 samplings"}, "is no time"),
        ({"length": "-5 samples"}, "is no time"),
        ({"length": 1, "every": "0 samples"}, "must be positive"),
    ],
)
def test_lengths_that_are_none_are_refused(given: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValidationError, match=problem):
        WindowsBlock.model_validate(given)
    with pytest.raises(ValidationError, match="`half_width` must be positive"):
        InitialBlock.model_validate({"signal": "angle", "half_width": "0 samples"})


def test_delays_that_leave_nothing_of_so_many_samples_are_refused() -> None:
    late = {"hand.angle": {"signal": "angle", "delay": "lag"}}
    free = {**study()["parameters"], "lag": {"start": 0.1, "min": 0, "max": 0.3}}
    block = OutputErrorBlock.model_validate(study(outputs=late, parameters=free, windows={"length": "20 samples"}))
    asked = block.study(block.system(Path()), block.source(Path()))
    with pytest.raises(ScenarioError, match="leaves nothing to compare"):
        cut_windows(asked.run, [recorded(0.01)], asked.windows)


def test_a_study_in_samples_is_the_one_in_seconds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration, "processors", lambda: 1)
    data = record(tmp_path / "data")
    found = []
    for name, length in {"seconds": 0.5, "samples": "50 samples"}.items():
        file = write_study(tmp_path / f"{name}.yaml", windows={"length": length}, validation={"length": length})
        calibrate_study(file, data, tmp_path / name, lambda fraction, remark: None)
        found.append(json.loads((tmp_path / name / "summary.json").read_text()))
    assert found[0]["parameters"] == found[1]["parameters"]
    assert found[0]["fit"] == found[1]["fit"]
    assert found[1]["warnings"] == found[0]["warnings"]


def test_a_length_of_the_validation_that_whole_steps_do_not_make_up_is_told_by_its_name(tmp_path: Path) -> None:
    file = write_study(
        tmp_path / "study.yaml", step=0.004, windows={"length": 0.4}, validation={"length": "33 samples"}
    )
    warnings = calibrated(file, record(tmp_path / "data"), tmp_path / "out")["warnings"]
    [line] = [warning for warning in warnings if "which whole steps make" in warning]
    assert line.startswith("validation.length: 33 samples of ")
