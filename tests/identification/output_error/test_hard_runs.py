"""Runs that fail, windows in which nothing moves, and studies without recordings kept aside."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identification.validation import validate_result
from orchestrator import formats
from orchestrator.progress import silent
from orchestrator.trace import Trace
from tests.support.identification.small_study import (
    COUNT,
    STEP,
    TRUTH,
    calibrated,
    record,
    simulated,
    study,
    summary,
    voltage,
    write_study,
)

pytestmark = pytest.mark.usefixtures("in_this_process")


LAG = '''"""A first-order lag that breaks down when it is slower than 0.8 s."""
from .model import Model, Requirement, State, input_, output, parameter

def derivatives(t, x, u, p):
    return {"y": (p.gain * u.v - x.y) / p.slowness}

MODEL = Model("lag", "Lag", (
    input_("v", "V", "Input"),
    output("y", "1", "Output"),
    parameter("gain", "1/V", 1.0, "Gain"),
    parameter("slowness", "s", 0.1, "Time constant", minimum=0.01),
), states=(State("y"),), derivatives=derivatives, solver_step=lambda p: 0.005,
   requirements=(Requirement(lambda t, x, u, p: p.slowness < 0.8, "too slow for me"),))
'''


def lag_study(folder: Path, **changes: Any) -> Path:
    """A study of the lag, its model file beside it, and data of gain 2 and time constant 0.3 s."""
    (folder / "lag.py").write_text(LAG)
    driven, y = voltage(0), [0.0]
    for v in driven[:-1]:
        y.append(2 * v + (y[-1] - 2 * v) * float(np.exp(-STEP / 0.3)))
    noisy = np.array(y) + np.random.default_rng(1).normal(0, 1e-5, COUNT)
    formats.write(Trace(np.arange(COUNT) * STEP, {"v": driven, "y": noisy}), folder / "lag.csv")
    system = {
        "components": {"lag": {"model": "lag.py"}},
        "connections": None,
        "traces": {"files": "lag.csv"},
        "inputs": {"lag.v": {"signal": "v"}},
        "outputs": {"lag.y": {"signal": "y"}},
        "validation": None,
        "truth": {"lag.gain": 2.0, "lag.slowness": 0.3},
        "parameters": {
            "lag.gain": {"start": 1.0, "min": 0.1, "max": 5},
            "lag.slowness": {"start": 0.2, "min": 0.01, "max": 2},
        },
    }
    return write_study(folder / "study.yaml", **(system | changes))


@pytest.mark.slow
def test_runs_that_fail_are_counted_and_told_and_do_not_end_the_estimation(tmp_path: Path) -> None:
    document = calibrated(lag_study(tmp_path, options={"starts": 6, "seed": 3}), tmp_path, tmp_path / "out")
    search = document["search"]
    assert 0 < search["failures"] < search["simulations"]
    assert any("too slow for me" in reason for reason in search["reasons"])
    (warning,) = [each for each in document["warnings"] if "simulations failed" in each]
    assert warning.startswith(f"{search['failures']} of {search['simulations']} ") and "too slow for me" in warning
    for name, true in {"lag.gain": 2.0, "lag.slowness": 0.3}.items():
        low, high = document["parameters"][name]["ci95"]
        assert low <= true <= high


def test_a_study_without_traces_kept_aside_compares_on_the_fitted_ones(tmp_path: Path) -> None:
    compare = {"truth": {"lag.gain": 2.0, "lag.slowness": 0.3}}
    document = calibrated(lag_study(tmp_path, compare=compare), tmp_path, tmp_path / "out")
    assert document["fit"]["validation"] is None
    assert document["fit"]["compared"]["truth"]["median"] == pytest.approx(document["fit"]["train"]["median"], abs=1e-3)
    assert summary(tmp_path / "out") == document


def test_start_values_of_windows_can_be_estimated_along(tmp_path: Path) -> None:
    hidden = {"hand.angle_start": {"signal": "angle", "half_width": 0.05, "estimated": True}}
    record(tmp_path / "data", noise=5e-3)
    document = calibrated(write_study(tmp_path / "study.yaml", initial=hidden), tmp_path / "data", tmp_path / "out")
    for name, entry in document["parameters"].items():
        low, high = entry["ci95"]
        assert low <= TRUTH[name] <= high, name


def test_windows_in_which_nothing_moves_have_no_fit_and_do_not_spoil_the_summary(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    driven = np.concatenate([voltage(0)[:-1], np.zeros(COUNT)])
    angle = np.concatenate([simulated(voltage(0), 0.0)[:-1], np.full(COUNT, simulated(voltage(0), 0.0)[-1])])
    time = np.arange(len(driven)) * STEP
    for name in ("rig_0__a", "rig_0__b"):
        formats.write(Trace(time, {"voltage": driven, "angle": angle}), tmp_path / "data" / f"{name}.csv")
    known = {name: {"start": value, "fixed": name != "hand.inertia"} for name, value in TRUTH.items()}
    traces = study()["traces"] | {"hold_out": ["rig_0__b"]}
    rest = {"length": 0.5, "skip": 1.2}
    study_file = write_study(tmp_path / "study.yaml", parameters=known, traces=traces, validation=rest)
    document = calibrated(study_file, tmp_path / "data", tmp_path / "out")
    assert document["fit"]["validation"]["median"] is None
    assert document["fit"]["validation"]["traces"] == {"rig_0__b": None}
    assert summary(tmp_path / "out") == document
    verdict = validate_result(tmp_path / "out", tmp_path / "data", tmp_path / "judged", silent)
    assert verdict["held"] is True and verdict["at_least"] is None
