"""Controllers tuned on simulated loops: figures are those of the linear loop where that is linear, dry friction counts
where it is not, and what cannot be run is told."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import InputError
from identification.calibrate import study_without_data
from identification.tuning.summary import TuningSummary
from orchestrator.fmi.isolation import Isolation
from orchestrator.info import about
from orchestrator.progress import silent
from tests.support.commands import servotwin
from tests.support.fmus import quirks
from tests.support.identification.tuning_study import study, write

STEP = 0.01
LOAD = """
from . import Model, State, input_, ops, output, parameter


def derivatives(t, x, u, p):
    return {"position": x.speed, "speed": 10 * (p.gain * u.voltage - x.speed - p.dry * ops.clip(x.speed / 1e-3, -1, 1))}


MODEL = Model(
    name="load",
    description="A load with a lag and dry friction",
    variables=(
        input_("voltage", "V", "Command"),
        output("position", "V", "Position"),
        output("speed", "V/s", "Speed"),
        parameter("gain", "1", 2.0, "Gain"),
        parameter("dry", "V", 0.0, "Dry friction"),
    ),
    states=(State("position", 0.0, "V"), State("speed", 0.0, "V/s")),
    derivatives=derivatives,
    solver_step=lambda p: 1e-4,
)
"""
RIG = {
    "title": "A servo",
    "components": {
        "source": {"model": "excitation", "parameters": {"shape": "square", "frequency": 0.01, "amplitude": 2}},
        "servo": {"model": "pi", "parameters": {"sample_time": STEP}},
        "load": {"model": "load.py"},
    },
    "connections": [
        "source.signal -> servo.reference",
        "load.position -> servo.position",
        "servo.voltage -> load.voltage",
    ],
    "run": {"stop": 4, "step": STEP},
    "cases": [{"name": "smooth"}, {"name": "dry", "set": {"load.dry": 0.2}}],
}
ASKED: dict[str, Any] = {
    "title": "A servo, simulated",
    "method": "tune-simulated",
    "controller": {"model": "pi", "parameters": {"sample_time": STEP, "ki": 0}},
    "plants": {"light": {"scenario": "rig.yaml", "component": "servo"}},
    "reference": "source.signal",
    "tracked": "load.position",
    "command": "servo.voltage",
    "minimise": [{"measure": "itae", "relative": "reference"}],
    "design": {"unknowns": {"kp": {"start": 0.5, "min": 0.01, "max": 20}}},
}


def tuned(folder: Path, **changes: Any) -> TuningSummary:
    (folder / "load.py").write_text(LOAD)
    (folder / "rig.yaml").write_text(json.dumps(RIG))
    document = {key: value for key, value in (ASKED | changes).items() if value is not None}
    return study_without_data("tune", write(folder, document), folder / "out", silent)  # type: ignore[return-value]


def gain(found: TuningSummary) -> float:
    return found["parameters"]["controller.kp"]["value"]


@pytest.mark.slow
def test_the_gain_of_a_smooth_loop_is_that_of_the_linear_loop(tmp_path: Path) -> None:
    """The study of `tuning_study`, whose plant is this one under a held command, on the way of matrices."""
    found = tuned(tmp_path, goals=[{"measure": "overshoot", "at_most": "5 %"}])
    (tmp_path / "linear").mkdir()
    linear = study(
        plants={"light": study()["plants"]["light"]},
        goals=[{"measure": "overshoot", "at_most": "5 %"}],
        minimise=[{"measure": "itae", "relative": "reference"}],
        step={"height": 2, "duration": 4},
    )
    known: Any = study_without_data("tune", write(tmp_path / "linear", linear), tmp_path / "linear" / "out", silent)
    assert found["feasible"]
    assert gain(found) == pytest.approx(gain(known), rel=2e-3)
    [overshoot, itae] = found["goals"]
    assert overshoot["figures"]["light"] == pytest.approx(known["goals"][0]["figures"]["light"], abs=2e-3)
    assert itae["figures"]["light"] == pytest.approx(known["goals"][1]["figures"]["light"], rel=5e-3)


@pytest.mark.slow
def test_dry_friction_asks_for_more_gain(tmp_path: Path) -> None:
    """A load that sticks at 0.2 / 2 V of command rests 0.1 V / kp short of the reference, which it creeps up to."""
    goals = [{"measure": "steady error", "at_most": 0.1}]
    plants = {"dry": {"scenario": "rig.yaml", "component": "servo", "case": "dry"}}
    least = [{"measure": "effort"}]
    found = tuned(tmp_path, plants=plants, goals=goals, minimise=least)
    assert found["feasible"]
    assert gain(found) == pytest.approx(1, rel=0.06)
    assert found["goals"][0]["figures"]["dry"] == pytest.approx(0.1, rel=0.01)


@pytest.mark.slow
def test_values_are_in_the_fmu_and_the_runs_in_the_report(tmp_path: Path) -> None:
    found = tuned(tmp_path)
    [kp] = [port for port in about(tmp_path / "out" / "fmus" / "controller.fmu")["parameters"] if port["name"] == "kp"]
    assert float(kp["start"]) == gain(found)
    page = (tmp_path / "out" / "report.html").read_text()
    assert "itae of load.position over the reference" in page and "load.position" in page


@pytest.mark.slow
def test_what_the_loops_cannot_hold_leaves_with_1(tmp_path: Path) -> None:
    (tmp_path / "load.py").write_text(LOAD)
    (tmp_path / "rig.yaml").write_text(json.dumps(RIG))
    impossible = [{"measure": "rise time", "at_most": 0.02}]
    left = servotwin("tune", write(tmp_path, ASKED | {"goals": impossible}), "--out", tmp_path / "out")
    assert left.exit_code == 1
    assert "INFEASIBLE" in left.stdout and "rise time of load.position" in left.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"goals": [{"measure": "phase margin", "at_least": 60}]}, "is of linear loops; use `method: tune`"),
        ({"goals": [{"measure": "overshoot", "at_most": 0.1, "of": "servo.voltage"}]}, "follows nothing"),
        ({"goals": [{"measure": "saturation", "at_most": 0}]}, "there is no `limit`; give the command's"),
        ({"command": None, "minimise": [{"measure": "effort"}]}, "is of the command; name it by `command`"),
        ({"plants": {"a": {"scenario": "rig.yaml"}}}, r"plants\.a\.component: 'controller' is no component"),
        (
            {"plants": {"a": {"scenario": "rig.yaml", "component": "servo", "case": "wet"}}},
            r"plants\.a\.case: 'wet' is no case of rig\.yaml; smooth, dry",
        ),
        ({"plants": {"a": {"scenario": "none.yaml", "component": "servo"}}}, r"none\.yaml"),
        (
            {"plants": {"a": {"scenario": "rig.yaml", "component": "servo", "set": {"load.mass": 1}}}},
            r"load\.mass",
        ),
        ({"tracked": "load.angle"}, r"load\.angle"),
        (
            {"tracked": "load.speed", "reference": "servo.reference"},
            r"load\.speed: is in V/s, and servo\.reference in V",
        ),
        (
            {"plants": {"a": {"scenario": "rig.yaml", "component": "servo", "set": {"source.amplitude": 0}}}},
            "asks for no move of load.position; let it step",
        ),
        (
            {"plants": {"a": {"scenario": "rig.yaml", "component": "servo", "set": {"source.shape": "sine"}}}},
            "changes until the end; let it rest",
        ),
    ],
)
def test_what_does_not_fit_together_is_refused(changes: dict[str, Any], problem: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=problem):
        tuned(tmp_path, **changes)


@pytest.mark.slow
def test_a_run_that_fails_counts_as_unstable_and_is_told(tmp_path: Path) -> None:
    """Gains with which the sampled loop grows until its numbers end."""
    rig = RIG | {"run": {"stop": 60, "step": STEP}}
    (tmp_path / "load.py").write_text(LOAD)
    (tmp_path / "rig.yaml").write_text(json.dumps(rig))
    controller = {"model": "pi", "parameters": {"sample_time": STEP, "ki": 0, "voltage_limit": 1.7e308}}
    design = {"unknowns": {"kp": {"start": 1.0, "min": 0.01, "max": 1e4, "scale": "log"}}, "starts": [{"kp": 5e3}]}
    found: Any = study_without_data(
        "tune", write(tmp_path, ASKED | {"controller": controller, "design": design}), tmp_path / "out", silent
    )
    assert np.isfinite(found["objective"])
    assert any("runs of light failed on the way" in remark for remark in found["warnings"])


@pytest.mark.slow
@pytest.mark.parametrize("trouble", ["abort();", "for (;;) pause();"])
def test_an_fmu_that_crashes_or_hangs_at_some_gains_fails_there_and_the_search_goes_on(
    tmp_path: Path, trouble: str
) -> None:
    """The lag of `quirks.c` starts at 1 and is to go to 2, so that the command is at most kp."""
    quirks.build(tmp_path / "lag.fmu", ON_STEP=f"if (m->number[U] > 4) {trouble}")
    components = RIG["components"] | {"load": {"fmu": "lag.fmu"}}
    connections = ["source.signal -> servo.reference", "load.x -> servo.position", "servo.voltage -> load.u"]
    (tmp_path / "rig.yaml").write_text(
        json.dumps(RIG | {"components": components, "connections": connections, "cases": [{"name": "run"}]})
    )
    unknowns = {"kp": {"start": 3, "min": 0.5, "max": 20}}
    asked = ASKED | {"tracked": "load.x", "design": {"unknowns": unknowns, "evaluations": 12}}
    file = write(tmp_path, asked)
    found: Any = study_without_data("tune", file, tmp_path / "out", silent, Isolation(2.0))
    assert 3 <= gain(found) <= 4
    [remark] = [line for line in found["warnings"] if "failed on the way" in line]
    assert ("crashed" if trouble == "abort();" else "hangs") in remark
    assert servotwin("tune", file, "--patience", "2").exit_code == 2


@pytest.mark.slow
def test_parameters_that_no_loop_takes_are_bad_input(tmp_path: Path) -> None:
    """The search alone may come to parameters that do not fit together: such a candidate is passed over."""
    notch = {"model": "notch", "parameters": {"sample_time": STEP, "frequency": 60}}
    parts = {
        "source": RIG["components"]["source"],
        "servo": {"model": "notch", "parameters": {"sample_time": STEP, "frequency": 10}},
    }
    rig = RIG | {"components": parts, "connections": ["source.signal -> servo.effort"], "cases": [{"name": "one"}]}
    (tmp_path / "notch.yaml").write_text(json.dumps(rig))
    changes = {
        "controller": notch,
        "plants": {"light": {"scenario": "notch.yaml", "component": "servo"}},
        "tracked": "servo.voltage",
        "design": {"unknowns": {"width": {"start": 0.5, "min": 0.1, "max": 1}}, "evaluations": 10},
    }
    left = servotwin("tune", write(tmp_path, ASKED | changes), "--out", tmp_path / "out")
    assert left.exit_code == 2
    assert "plants.light: servo: frequency = 60, sample_time = 0.01: frequency is not below half" in left.stderr
    assert not (tmp_path / "out").exists()
