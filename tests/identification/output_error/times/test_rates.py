"""Recordings that are sampled otherwise than free runs step are told of, and only those."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identification.output_error.times.rates import rate_warnings
from identification.output_error.windows import cut_windows
from identification.recordings.campaign import StudyTrace
from orchestrator.trace import FloatArray, Trace
from tests.support.identification.small_study import calibrated, plain_study, record, write_study

HELD = {"motor.voltage": {"signal": "voltage", "interpolation": "hold"}}


def recorded(every: float, rate: float = 7.0) -> StudyTrace:
    """4 s of a voltage with a level of its own every 50 ms, and of an angle that swings at `rate` [rad/s]."""
    time = np.asarray(np.arange(round(4 / every) + 1) * every, dtype=np.float64)
    levels = np.random.default_rng(0).uniform(-1, 1, 100)[np.floor(time / 0.05 + 1e-6).astype(int)]
    trace = Trace(time, {"voltage": levels, "angle": np.sin(rate * time)}, name=f"{every}")
    return StudyTrace(trace, {}, Path(f"{every}.csv"), "", "even", values={"hand.added_mass": 0.0})


def told(every: float, step: float, rate: float = 7.0, frames: bool = False, **keys: str) -> list[str]:
    asked = plain_study(
        step=step, windows={"length": 2}, initial={}, inputs={"motor.voltage": {"signal": "voltage", **keys}}
    )
    one = replace(recorded(every, rate), held=frames)
    return list(rate_warnings(asked.run, [one], cut_windows(asked.run, [one], asked.windows)))


@pytest.mark.parametrize("every", [0.01, 0.05])
def test_samples_that_come_once_a_step_need_no_word(every: float) -> None:
    assert told(every, every) == []


def test_an_input_that_moves_within_steps_is_told_until_it_is_said_how() -> None:
    [line] = told(0.01, 0.1)
    assert line.startswith("inputs.motor.voltage: 0.01 has a sample every 0.01 s, and steps of 0.1 s take the value")
    assert "say `interpolation: hold` for a command" in line
    assert told(0.01, 0.1, interpolation="hold") == []
    assert told(0.01, 0.1, interpolation="linear") == []


def test_an_input_and_outputs_of_frames_that_are_drawn_along_lines_are_told_with_what_that_does() -> None:
    rate = 7.0
    [driven] = told(0.05, 0.01, rate)  # the output is compared at its samples
    [compared] = told(0.05, 0.01, rate, frames=True)
    assert driven.startswith("inputs.motor.voltage: 0.05 has a sample every 0.05 s, and steps of 0.01 s take the value")
    cut = (rate * 0.05) ** 2 / 8  # of a sine's curve in the middle between samples, in its size
    assert f"is compared every 0.01 s, along lines that cut its curves by about {100 * cut:.2g} %" in compared
    assert told(0.05, 0.01, rate, interpolation="hold") == []


@pytest.mark.parametrize("samples", [2, 5])
def test_an_output_that_holds_its_values_over_several_samples_is_told_with_how_late_it_is(samples: int) -> None:
    """An encoder that counts slowly, or every sample anew, is not, and neither are frames, which have stamps."""
    fine = recorded(0.01)
    asked = plain_study(step=0.01, windows={"length": 2}, initial={})

    def said(angle: FloatArray, **changes: Any) -> list[str]:
        one = replace(fine, trace=replace(fine.trace, signals={**fine.trace.signals, "angle": angle}), **changes)
        return list(rate_warnings(asked.run, [one], cut_windows(asked.run, [one], asked.windows)))

    angle = fine.trace["angle"]
    held = np.repeat(angle[::samples], samples)[: len(angle)]
    [line] = said(held)
    assert f"angle of 0.01 has a new value only every {samples} samples" in line
    assert f"late by {(samples - 1) / 2 * 0.01:.2g} s on average" in line
    assert f"let `step` be {samples * 0.01:.3g} s" in line
    assert said(held, held=True) == []
    assert said(np.round(angle, 1)) == []
    assert said(angle) == []


def test_steps_finer_than_samples_change_no_estimate_and_no_interval(tmp_path: Path) -> None:
    """The voltage changes at samples only, so that finer steps simulate the same."""
    data, found = record(tmp_path / "data"), []
    for step in (0.01, 0.001):
        asked = write_study(tmp_path / "study.yaml", step=step, inputs=HELD)
        found.append(calibrated(asked, data, tmp_path / f"{step}"))
        assert not any("every 0.01 s" in line for line in found[-1]["warnings"])
    for name, plain in found[0]["parameters"].items():
        fine = found[1]["parameters"][name]
        assert fine["value"] == pytest.approx(plain["value"], abs=0.02 * plain["std"])
        assert fine["std"] == pytest.approx(plain["std"], rel=0.01)
    assert found[1]["fit"]["validation"]["median"] == pytest.approx(found[0]["fit"]["validation"]["median"], abs=1e-4)
