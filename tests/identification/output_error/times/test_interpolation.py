"""An input in lines from sample to sample acts as one: by its exact mean over each step, and not half a step late."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate, signal

from fmus.errors import WiringError
from identification.output_error.calibration import judge
from identification.output_error.schema import OutputErrorBlock
from identification.output_error.times.delays import HeldCommand, KnownDelay, LinearCommand
from identification.output_error.windows import cut_windows
from identification.recordings.campaign import StudyTrace
from orchestrator.assembly.assembly import assemble
from orchestrator.fmi.interface import Port
from orchestrator.trace import FloatArray, Trace
from tests.support.identification.small_study import study

pytestmark = pytest.mark.usefixtures("in_this_process")

LAG = """
from . import Model, State, input_, output, parameter

MODEL = Model("lag", "Lag", (input_("v", "V", "In"), output("y", "V", "Out"), parameter("time", "s", 0.05, "Time")),
              states=(State("y"),), derivatives=lambda t, x, u, p: {"y": (u.v - x.y) / p.time},
              solver_step=lambda p: 0.001)
"""
STEP, EVERY = 0.005, 0.02  # of the free runs, and between samples [s]


def wave(every: float) -> StudyTrace:
    """A sine of 4 Hz; what goes through a line is what the lag shows."""
    time = np.asarray(np.arange(round(1 / every) + 1) * every, dtype=np.float64)
    driven = np.sin(8 * np.pi * time)
    return StudyTrace(Trace(time, {"v": driven, "y": driven}, name="wave"), {}, Path("wave.csv"), "", "even")


def predicted(tmp_path: Path, **keys: Any) -> FloatArray:
    """(K,) the study's prediction of the lag's output, at every step."""
    (tmp_path / "lag.py").write_text(LAG)
    block = OutputErrorBlock.model_validate(
        study(
            components={"lag": {"model": "lag.py"}},
            connections=None,
            step=STEP,
            traces={"files": "wave.csv"},
            inputs={"lag.v": {"signal": "v", **keys}},
            outputs={"lag.y": {"signal": "y"}},
            parameters={"lag.time": {"start": 0.05, "fixed": True}},
            truth=None,
        )
    )
    asked = block.study(block.system(tmp_path), block.source(tmp_path))
    windows = [
        replace(window, at=np.arange(float(window.count)), measured=np.zeros((window.count, 1)))
        for window in cut_windows(asked.run, [wave(EVERY)], asked.windows)
    ]
    judged = judge(asked, assemble(asked.system, tmp_path, ["lag.v"]), windows, {"lag.time": 0.05})
    return np.asarray(judged.simulated[0][:, 0])


def exact(driven: FloatArray, time: FloatArray) -> FloatArray:
    """(K,) the lag's output under lines, in closed form."""
    _, output, _ = signal.lsim(([1.0], [0.05, 1.0]), driven, time)
    return np.asarray(output)


@pytest.mark.slow
def test_a_logged_sine_drives_as_the_lines_through_its_samples(tmp_path: Path) -> None:
    trace, time = wave(EVERY).trace, np.asarray(np.arange(201) * STEP, dtype=np.float64)
    expected = exact(np.interp(time, trace.time, trace["v"]), time)
    lines = np.abs(predicted(tmp_path, interpolation="linear") - expected).max()
    assert lines < (8 * np.pi * STEP) ** 2 / 8  # what holding the mean of each step costs at most
    assert np.abs(predicted(tmp_path) - expected).max() > 10 * lines  # by the values at the beginnings


def test_held_without_a_delay_is_a_delay_of_nothing_and_lines_come_late_too(tmp_path: Path) -> None:
    assert np.array_equal(predicted(tmp_path, interpolation="hold"), predicted(tmp_path, delay=0))
    trace, time = wave(EVERY).trace, np.asarray(np.arange(201) * STEP, dtype=np.float64)
    late = predicted(tmp_path, interpolation="linear", delay=0.0123)
    expected = exact(np.interp(time - 0.0123, trace.time, trace["v"]), time)
    assert late == pytest.approx(expected, abs=(8 * np.pi * STEP) ** 2 / 8)


@given(
    stamps=st.lists(st.floats(0.01, 1), min_size=1, max_size=6),
    edges=st.lists(st.floats(0.05, 2), min_size=1, max_size=6),
    begin=st.floats(-3, 3),
    seed=st.integers(0, 99),
)
def test_lines_have_the_mean_of_what_is_under_them(
    stamps: list[float], edges: list[float], begin: float, seed: int
) -> None:
    time = np.concatenate([[0.0], np.cumsum(stamps)])
    values = np.random.default_rng(seed).normal(size=len(time))
    limits = begin + np.concatenate([[0.0], np.cumsum(edges)])
    lines = LinearCommand(time, values)
    expected = []
    for low, high in itertools.pairwise(limits):
        corners = np.unique(np.concatenate([[low, high], time[(time > low) & (time < high)]]))
        expected.append(integrate.trapezoid(np.interp(corners, time, values), corners) / (high - low))
    np.testing.assert_allclose(lines.means(limits), expected, atol=1e-12)
    part = lines.between(float(limits[0]), float(limits[-1]))
    np.testing.assert_allclose(part.means(limits), expected, atol=1e-12)
    np.testing.assert_allclose(part.at(limits[:-1]), np.interp(limits[:-1], time, values), atol=1e-12)


def test_frames_of_a_bus_are_held_where_nothing_else_is_said() -> None:
    block = OutputErrorBlock.model_validate(study(inputs={"motor.voltage": {"signal": "voltage"}}))
    linear = {"motor.voltage": {"signal": "voltage", "interpolation": "linear"}}
    other = OutputErrorBlock.model_validate(study(inputs=linear))
    assert block.signals.commands == {"voltage"} and other.signals.commands == frozenset()
    assert "voltage" in other.signals.measured
    asked = other.study(other.system(Path()), other.source(Path())).run.by_means()
    assert asked.inputs["motor.voltage"].linear and asked.inputs["motor.voltage"].delay == KnownDelay(0.0)


def test_lines_to_an_input_that_changes_in_steps_are_refused() -> None:
    block = OutputErrorBlock.model_validate(
        study(inputs={"motor.voltage": {"signal": "voltage", "interpolation": "linear"}})
    )
    run = block.study(block.system(Path()), block.source(Path())).run
    ports = {"motor.voltage": Port("voltage", 0, "Integer", "input")}
    trace = Trace(np.arange(3.0), {"voltage": np.arange(3.0), "angle": np.arange(3.0)})
    with pytest.raises(WiringError, match=r"motor\.voltage\.interpolation: changes in steps, .* `interpolation: hold`"):
        run.in_units_of(ports, trace)


def test_the_first_and_the_last_value_last() -> None:
    time, values = np.array([0.0, 1.0, 3.0]), np.array([1.0, 2.0, -1.0])
    for curve in (HeldCommand(time, values), LinearCommand(time, values)):
        assert curve.means(np.array([-2.0, -1.0, 0.0])) == pytest.approx([1.0, 1.0])
        assert curve.means(np.array([3.0, 4.0, 9.0])) == pytest.approx([-1.0, -1.0])
