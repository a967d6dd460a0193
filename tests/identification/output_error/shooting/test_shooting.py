"""Multiple shooting: the estimates of output error, also where no search by free runs comes to them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import IdentificationError
from fmus.modelling.instance import Instance
from fmus.models.plants import pendulum
from identification.output_error.schema import OutputErrorBlock
from identification.results import read_summary
from orchestrator import formats
from orchestrator.trace import Trace
from tests.support.identification.small_study import STEP, calibrated, write_study

pytestmark = pytest.mark.usefixtures("in_this_process")

INITIAL = {
    "hand.angle_start": {"signal": "angle", "estimated": True, "half_width": 0.05},
    "hand.speed_start": {"signal": "angle", "derivative": 1, "estimated": True, "half_width": 0.05},
}
SHARP = {"cost_tolerance": 1e-12, "step_tolerance": 1e-10}


def values(document: Mapping[str, Any]) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([entry["value"] for entry in document["parameters"].values()])


@pytest.mark.slow
@pytest.mark.parametrize("initial", [INITIAL, None], ids=["estimated starts", "starts at rest"])
def test_a_stable_system_has_the_estimates_of_whole_windows(data: Path, tmp_path: Path, initial: Any) -> None:
    whole = write_study(tmp_path / "whole.yaml", initial=initial, options=SHARP)
    cut = write_study(tmp_path / "cut.yaml", initial=initial, options=SHARP, shooting={"segments": 4})
    one, other = (calibrated(file, data, tmp_path / file.stem) for file in (whole, cut))
    assert values(other) == pytest.approx(values(one), rel=1e-6)
    assert other["search"]["shooting"]["joined"] and other["search"]["iterations"] <= 2
    ends = [entry["ci95"] for entry in one["parameters"].values()]
    assert np.array([entry["ci95"] for entry in other["parameters"].values()]) == pytest.approx(
        np.array(ends), rel=1e-4
    )


TRUTH = {"hand.inertia": 0.004, "hand.gravity_torque": 0.05, "hand.viscous_friction": 0.0015}


def inverted(folder: Path, seconds: float, seed: int = 0) -> Path:
    """Recordings of an inverted pendulum, which a controller holds upright and moves about."""
    folder.mkdir()
    count = round(seconds / STEP) + 1
    for number in range(2):
        random = np.random.default_rng([seed, number])
        own = {name.removeprefix("hand."): value for name, value in TRUTH.items()}
        hand = Instance(pendulum.MODEL, {**own, "equilibrium_angle": float(np.pi), "angle_start": 0.1})
        wanted = np.repeat(random.uniform(-0.3, 0.3, count // 40 + 1), 40)[:count]
        torque, angle = np.zeros(count), np.zeros(count)
        for k in range(count):
            angle[k] = hand.get("angle")
            torque[k] = 0.15 * (wanted[k] - angle[k]) - 0.012 * hand.get("speed")
            hand.set("torque", float(torque[k]))
            hand.step(k * STEP, STEP)
        signals = {"torque": torque, "angle": angle + random.normal(0, 1e-3, count)}
        trace = Trace(np.arange(count) * STEP, signals, {"torque": "N.m", "angle": "rad"})
        formats.write(trace, folder / f"rig_{number}.csv")
    return folder


def upright(path: Path, seconds: float, **changes: Any) -> Path:
    """A study of those recordings."""
    asked = {
        "components": {"hand": {"model": "pendulum", "parameters": {"equilibrium_angle": float(np.pi)}}},
        "connections": None,
        "traces": {"files": "rig_*.csv"},
        "inputs": {"hand.torque": {"signal": "torque"}},
        "initial": INITIAL,
        "windows": {"length": seconds},
        "validation": None,
        "parameters": {
            "hand.inertia": {"start": 0.006, "min": 0.0005, "max": 0.02},
            "hand.gravity_torque": {"start": 0.03, "min": -0.1, "max": 0.2},
            "hand.viscous_friction": {"start": 0.003, "min": 0.0, "max": 0.05},
        },
        "truth": TRUTH,
    }
    return write_study(path, **{**asked, **changes})


def off(document: Mapping[str, Any]) -> float:
    """By how many half-widths the truth is farthest off."""
    entries = document["parameters"].values()
    return max(abs(one["value"] - one["truth"]) / (one["ci95"][1] - one["value"]) for one in entries)


@pytest.mark.slow
@pytest.mark.parametrize(("seconds", "segments"), [(3.0, 10), (10.0, 30)], ids=["10 time constants", "35"])
def test_an_unstable_plant_is_found_where_free_runs_leave_it(tmp_path: Path, seconds: float, segments: int) -> None:
    data = inverted(tmp_path / "data", seconds)
    free = calibrated(upright(tmp_path / "free.yaml", seconds), data, tmp_path / "free")
    assert not free["search"]["converged"]
    study = upright(tmp_path / "shot.yaml", seconds, shooting={"segments": segments})
    found = calibrated(study, data, tmp_path / "shot")
    assert found["search"]["converged"] and found["search"]["shooting"]["gap"] < 1e-12
    assert found["fit"]["train"]["median"] > 0.99
    assert off(found) < 1.5
    assert all(entry["ci95"][1] - entry["value"] < 0.02 * entry["value"] for entry in found["parameters"].values())
    assert read_summary(tmp_path / "shot")["verdict"]["converged"]
    assert "segments, which have joined" in (tmp_path / "shot" / "report.html").read_text()


def test_more_constraints_than_data_are_refused_with_the_key(data: Path, tmp_path: Path) -> None:
    study = write_study(tmp_path / "study.yaml", initial=INITIAL, shooting={"length": 0.01})
    with pytest.raises(
        IdentificationError, match=r"shooting.length: makes 396 constraints .* for 202 samples; cut into"
    ):
        calibrated(study, data, tmp_path / "out")


def test_segments_of_one_sample_are_refused(data: Path, tmp_path: Path) -> None:
    parameters = {"hand.inertia": {"start": 0.006, "min": 0.0005, "max": 0.02}}
    study = write_study(tmp_path / "study.yaml", parameters=parameters, shooting={"segments": 51}, truth=None)
    with pytest.raises(IdentificationError, match="with 1 instants to compare; cut into fewer"):
        calibrated(study, data, tmp_path / "out")


def test_a_run_that_remembers_more_than_its_start_values_is_not_cut(data: Path, tmp_path: Path) -> None:
    """The armature has a current, which no start value sets."""
    slow = {"motor": {"model": "dc_motor", "parameters": {"inductance": 0.5, "resistance": 1.0}}}
    hand = {"hand": {"model": "pendulum", "parameters": {"added_length": 0.1}}}
    study = write_study(tmp_path / "study.yaml", components={**slow, **hand}, shooting={"segments": 4})
    with pytest.raises(
        IdentificationError, match=r"shooting.segments: cannot cut .*more is remembered than hand.angle"
    ):
        calibrated(study, data, tmp_path / "out")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"shooting": {"length": 1}}, "shooting.length: is no shorter than the windows"),
        (
            {"shooting": {"segments": 3}, "parameters": {"hand.angle_start": {"start": 0.1, "min": -1, "max": 1}}},
            "shooting: estimates hand.angle_start in each segment; write it under `initial`",
        ),
        (
            {
                "shooting": {"segments": 3},
                "initial": {"hand.equilibrium_angle": {"signal": "angle", "half_width": 0.05}},
            },
            "initial.hand.equilibrium_angle: is no start value whose state can be seen",
        ),
    ],
)
def test_what_cannot_be_cut_is_refused_in_a_line(data: Path, tmp_path: Path, changes: Any, said: str) -> None:
    with pytest.raises(IdentificationError, match=said):
        calibrated(write_study(tmp_path / "study.yaml", truth=None, **changes), data, tmp_path / "out")


@pytest.mark.parametrize("entry", [{}, {"segments": 3, "length": 1}, {"segments": 1}, {"length": 0}])
def test_segments_or_their_length_are_given(tmp_path: Path, entry: Any) -> None:
    study = json.loads(write_study(tmp_path / "study.yaml", shooting=entry).read_text())
    with pytest.raises(ValueError, match="shooting"):
        OutputErrorBlock.model_validate(study)


def test_several_starts_are_not_passed_over(tmp_path: Path) -> None:
    study = json.loads(
        write_study(tmp_path / "study.yaml", shooting={"segments": 3}, options={"starts": 2}).read_text()
    )
    with pytest.raises(ValueError, match=r"remove `options\.starts`, or `shooting`"):
        OutputErrorBlock.model_validate(study)


@pytest.mark.slow
def test_what_is_known_before_counts_by_the_noise_that_is_left(data: Path, tmp_path: Path) -> None:
    """As it does without segments."""
    parameters = {
        "hand.inertia": {"start": 0.006, "min": 0.0005, "max": 0.02, "prior": {"mean": 0.005, "std": 1e-5}},
        "hand.viscous_friction": {"start": 0.001, "min": 0.0, "max": 0.05},
    }
    asked: dict[str, Any] = {"parameters": parameters, "options": SHARP, "initial": INITIAL, "truth": None}
    whole = calibrated(write_study(tmp_path / "whole.yaml", **asked), data, tmp_path / "whole")
    study = write_study(tmp_path / "cut.yaml", **asked, shooting={"segments": 3})
    assert values(calibrated(study, data, tmp_path / "cut")) == pytest.approx(values(whole), rel=1e-4)
