"""Studies whose windows the recordings choose."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import IdentificationError, TraceError
from identification.calibrate import calibrate_study
from identification.validation import validate_result
from orchestrator import formats
from orchestrator.progress import silent
from orchestrator.trace import Trace
from tests.support.identification.small_study import NOISE, STEP, TRUTH, plain_study, simulated, write_study

pytestmark = pytest.mark.usefixtures("in_this_process")

Document = dict[str, Any]
COUNT, MOVES = 1201, 600  # samples, and those before the rig comes to rest [1]
INITIAL = {
    "hand.angle_start": {"signal": "angle", "half_width": 0.05, "estimated": True},
    "hand.speed_start": {"signal": "angle", "derivative": 1, "half_width": 0.05, "estimated": True},
}
TRACES = {"files": "rig_*.csv", "hold_out": ["rig_c"]}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of a rig that swings for 6 s, is braked, and rests for 6 s."""
    folder = tmp_path_factory.mktemp("resting")
    time = np.arange(COUNT) * STEP
    for number, name in enumerate("abc"):
        voltage = np.where(np.arange(COUNT) < MOVES, 4e-3 * np.sin((4 + number) * time), 0.0)
        angle = simulated(voltage, 0.0, {**TRUTH, "hand.viscous_friction": 0.03})
        angle = angle + np.random.default_rng([8, number]).normal(0, NOISE, COUNT)
        trace = Trace(time, {"voltage": voltage, "angle": angle}, {"voltage": "V", "angle": "rad"})
        formats.write(trace, folder / f"rig_{name}.csv")
    return folder


def calibrated(folder: Path, data: Path, **changes: Any) -> Document:
    parameters = {
        "hand.viscous_friction": {"start": 0.02, "min": 0.0, "max": 0.2},
        "motor.torque_gain": {"start": 8.0, "fixed": True},
        "hand.inertia": {"start": 0.004, "fixed": True},
        "hand.gravity_torque": {"start": 0.04, "fixed": True},
    }
    given = {
        "windows": "auto",
        "validation": {"length": "auto"},
        "initial": INITIAL,
        "traces": TRACES,
        "parameters": parameters,
        "truth": {},
        **changes,
    }
    calibrate_study(write_study(folder / "study.yaml", **given), data, folder / "out", silent)
    document: Document = json.loads((folder / "out" / "summary.json").read_text())
    return document


def test_windows_lie_where_the_recordings_move_and_that_is_shown(data: Path, tmp_path: Path) -> None:
    document = calibrated(tmp_path, data)
    windows = document["windows"]
    assert set(windows["traces"]) == {"rig_a", "rig_b", "rig_c"}
    assert all(one["taken"] >= 1 and one["still"] >= 1 and one["less"] == 0 for one in windows["traces"].values())
    assert 2 * np.pi / 6 < windows["period"] < 2 * np.pi / 4 * 1.3
    worst = document["fit"]["train"]["worst"]
    assert worst["fit"] > 0.9, "a window at rest has no fit to speak of"
    found = document["parameters"]["hand.viscous_friction"]
    assert found["ci95"][0] < 0.03 < found["ci95"][1]
    assert f"windows of {windows['length']:.4g} s" in (tmp_path / "out" / "report.html").read_text().lower()


def test_the_most_of_a_recording_are_those_that_move_most(data: Path, tmp_path: Path) -> None:
    windows = calibrated(tmp_path, data, windows={"length": "auto", "most": 1})["windows"]["traces"]
    assert windows["rig_a"]["taken"] == 1 and windows["rig_a"]["less"] >= 0


def test_a_validation_takes_windows_of_the_same_length(data: Path, tmp_path: Path) -> None:
    document = calibrated(tmp_path, data)
    found = validate_result(tmp_path / "out", data, tmp_path / "validation", silent)
    assert found["fit"]["unseen"]["windows"] == document["fit"]["validation"]["windows"]
    assert found["fit"]["unseen"]["median"] == pytest.approx(document["fit"]["validation"]["median"], abs=1e-6)


def test_candidates_are_compared_on_the_same_windows(data: Path, tmp_path: Path) -> None:
    candidates = {
        "free": {},
        "known": {"set": {"hand.viscous_friction": 0.01}},
        "other": {"set": {"hand.inertia": 0.008}},
    }
    document = calibrated(tmp_path, data, candidates=candidates)
    assert document["candidate"] == "free"
    assert {one["state"] for one in document["choice"]["candidates"].values()} == {"chosen", "apart"}


def test_recordings_in_which_nothing_moves_for_long_enough_are_refused(tmp_path: Path) -> None:
    time = np.arange(400) * STEP
    steps = np.where(np.arange(400) % 400 == 399, 1.0, 0.0)
    for name in "abc":
        signals = {"voltage": steps, "angle": 1e-3 * steps}
        formats.write(Trace(time, signals, {"voltage": "V", "angle": "rad"}), tmp_path / f"rig_{name}.csv")
    with pytest.raises(TraceError, match="moves in no window"):
        calibrated(tmp_path, tmp_path, windows={"length": "auto", "skip": 0.1}, validation={"length": "auto"})


def test_a_study_without_recordings_has_to_say_how_long_windows_are() -> None:
    with pytest.raises(IdentificationError, match=r"windows\.length: is chosen by recordings"):
        _ = plain_study(windows="auto").said_windows
