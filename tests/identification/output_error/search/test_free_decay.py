"""A pendulum let go from an angle, nothing driving it: what its swing tells is found, and what it cannot is said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import TraceError
from fmus.modelling.instance import Instance
from fmus.models.plants import pendulum
from identification.calibrate import CalibratedStudy, calibrate
from orchestrator import formats
from orchestrator.trace import Trace
from tests.support.identification.small_study import write_study

pytestmark = pytest.mark.usefixtures("in_this_process")

STEP, COUNT, NOISE = 0.01, 401, 2e-3
TRUTH = {"hand.inertia": 0.004, "hand.gravity_torque": 0.04, "hand.viscous_friction": 0.0015}
FREE: dict[str, Any] = {
    "hand.inertia": {"start": 0.006, "min": 0.0005, "max": 0.02},
    "hand.gravity_torque": {"start": 0.03, "min": 0.001, "max": 0.2},
    "hand.viscous_friction": {"start": 0.001, "min": 0.0, "max": 0.05},
}
KNOWN: dict[str, Any] = {**FREE, "hand.gravity_torque": {"start": 0.04, "fixed": True}}
BEGINS: dict[str, Any] = {
    "hand.angle_start": {"signal": "angle", "half_width": 0.05, "estimated": True},
    "hand.speed_start": {"signal": "angle", "derivative": 1, "half_width": 0.05, "estimated": True},
}


def let_go(folder: Path, seed: int) -> Path:
    """A recording of 4 s in which no torque acts."""
    own = {name.removeprefix("hand."): value for name, value in TRUTH.items()}
    hand, angle = Instance(pendulum.MODEL, {**own, "angle_start": 1.0}), [1.0]
    for k in range(COUNT - 1):
        hand.step(k * STEP, STEP)
        angle.append(hand.get("angle"))
    noisy = np.array(angle) + np.random.default_rng(seed).normal(0, NOISE, COUNT)
    trace = Trace(
        np.arange(COUNT) * STEP, {"torque": np.zeros(COUNT), "angle": noisy}, {"torque": "N.m", "angle": "rad"}
    )
    formats.write(trace, folder / "swing.csv")
    return folder


def fitted(folder: Path, seed: int = 1, **changes: Any) -> CalibratedStudy:
    study = write_study(
        folder / "study.yaml",
        **{
            "components": {"hand": {"model": "pendulum"}},
            "connections": [],
            "traces": {"files": "swing.csv"},
            "inputs": {"hand.torque": {"signal": "torque"}},
            "windows": {"length": 4},
            "validation": None,
            "initial": BEGINS,
            "parameters": KNOWN,
            "truth": {name: TRUTH[name] for name in TRUTH},
            **changes,
        },
    )
    return calibrate(study, let_go(folder, seed))


def test_inertia_and_friction_follow_from_the_swing_where_gravity_is_known(tmp_path: Path) -> None:
    found = fitted(tmp_path)
    assert found.summary["verdict"]["converged"]
    for name in ("hand.inertia", "hand.viscous_friction"):
        entry = found.parameters[name]
        assert entry["value"] == pytest.approx(TRUTH[name], rel=0.01)
        assert entry["ci95"] is not None
    assert any("hand.torque rests in swing" in warning for warning in found.summary["warnings"])


@pytest.mark.slow
def test_its_intervals_hold_the_truth_in_95_of_100_draws_or_about(tmp_path: Path) -> None:
    held = {"hand.inertia": 0, "hand.viscous_friction": 0}
    for seed in range(100):
        found = fitted(tmp_path, seed)
        for name in held:
            low, high = found.parameters[name]["ci95"] or (np.inf, -np.inf)
            held[name] += bool(low <= TRUTH[name] <= high)  # type: ignore[operator]
    assert all(90 <= count <= 99 for count in held.values()), held


def test_what_only_goes_together_in_a_free_swing_has_no_interval_and_is_named(tmp_path: Path) -> None:
    """Inertia, gravity and friction by one factor swing alike."""
    found = fitted(tmp_path, parameters=FREE)
    assert [found.parameters[name]["ci95"] for name in FREE] == [[None, None]] * 3
    told = " ".join(found.summary["warnings"])
    assert all(name in told for name in FREE)


def test_an_input_that_rests_is_refused_where_nothing_says_what_the_run_begins_with(tmp_path: Path) -> None:
    with pytest.raises(
        TraceError, match=r"torque: is constant \(0\); check the column's number, or, where it is let go"
    ):
        fitted(tmp_path, initial={})
