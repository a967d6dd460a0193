"""A study by inverse dynamics, from recordings to an FMU, what it says, what it refuses, and the real axis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from fmus.errors import InputError, TraceError
from identification.calibrate import CalibratedStudy, calibrate
from orchestrator.assembly.assembly import ComponentSpec
from tests.support.identification import driven_axis
from tests.support.identification.driven_axis import GAIN, POSITION_GAIN, SPEED_GAIN, STEP, Axis, driven

pytestmark = pytest.mark.slow  # a calibration

AXIS = Axis(coulomb=(21.0, 21.0), offset=-3.0)
EMPS = Path(__file__).parents[3] / "scenarios" / "emps" / "inverse_dynamics.yaml"
TRUTH = {
    "axis.mass": 95.0,
    "axis.viscous_friction_positive": 160.0,
    "axis.viscous_friction_negative": 240.0,
    "axis.coulomb_friction_positive": 18.0,
    "axis.coulomb_friction_negative": 24.0,
}
STUDY: dict[str, Any] = {
    "title": "An axis",
    "method": "inverse-dynamics",
    "components": {"axis": {"model": "linear_axis", "parameters": {"drive_gain": GAIN}}},
    "connections": [],
    "traces": {"files": "*.csv"},
    "position": {"signal": "position", "output": "axis.position"},
    "command": {"signal": "command", "input": "axis.command", "gain": "axis.drive_gain"},
    "loop": {"reference": "wanted", "position_gain": POSITION_GAIN, "speed_gain": SPEED_GAIN},
    "cutoff": 200,
    "least_speed": 0.01,
    "write": {
        "inertia": "axis.mass",
        "viscous_positive": "axis.viscous_friction_positive",
        "viscous_negative": "axis.viscous_friction_negative",
        "coulomb_positive": "axis.coulomb_friction_positive",
        "coulomb_negative": "axis.coulomb_friction_negative",
    },
    "truth": TRUTH,
}


def recorded(file: Path, axis: Axis, seed: int = 3, noise: float = 2e-6) -> None:
    """A recording of this axis in its loop, with noise."""
    wanted = driven_axis.reference(20.0)
    position, command = (rows[:, 0] for rows in driven(axis, wanted, noise, 1, seed))
    table = np.column_stack((np.arange(len(wanted)) * STEP, position, command, wanted))
    header = "time [s],position [m],command [V],wanted [m]"
    np.savetxt(file, table, delimiter=",", header=header, comments="")


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings of a noisy axis in its loop."""
    folder = tmp_path_factory.mktemp("axis")
    for k in range(2):
        recorded(folder / f"run{k}.csv", AXIS, seed=k)
    return folder


def study(folder: Path, **changes: Any) -> Path:
    file = folder / "study.yaml"
    with file.open("w") as stream:
        YAML().dump({key: value for key, value in {**STUDY, **changes}.items() if value is not None}, stream)
    return file


@pytest.fixture(scope="module")
def found(recordings: Path, tmp_path_factory: pytest.TempPathFactory) -> CalibratedStudy:
    held_out = {"files": "*.csv", "hold_out": ["run1"]}
    return calibrate(study(tmp_path_factory.mktemp("study"), traces=held_out), recordings)


def test_the_axis_is_found_to_two_percent_and_explains_a_recording_kept_aside(found: CalibratedStudy) -> None:
    for name, one in found.parameters.items():
        assert one["value"] == pytest.approx(TRUTH[name], rel=0.02)
        assert one["truth"] == TRUTH[name]
    assert found.summary["fit"]["validation"] is not None
    assert found.summary["fit"]["validation"]["median"] > 0.95  # type: ignore[operator]


def test_a_recording_with_a_missing_command_is_refused_and_no_values_are_made_of_it(
    recordings: Path, tmp_path: Path
) -> None:
    rows = (recordings / "run0.csv").read_text().splitlines()
    time, position, _, wanted = rows[500].split(",")
    rows[500] = f"{time},{position},,{wanted}"
    (tmp_path / "run0.csv").write_text("\n".join(rows))
    with pytest.raises(TraceError, match=r"command: is not finite at .*`traces\.exclude: \[{trace: run0, from: "):
        calibrate(study(tmp_path), tmp_path)


def test_both_ways_stand_side_by_side(found: CalibratedStudy) -> None:
    ways = found.summary["found"]  # type: ignore[typeddict-item]
    assert (ways["least-squares"]["rounds"], found.summary["method"]) == (0, "inverse-dynamics (instrumental)")
    assert 1 <= ways["instrumental"]["rounds"] < 20


def test_that_an_offset_is_in_the_friction_by_direction_is_said(found: CalibratedStudy) -> None:
    assert any("a constant offset are the same force" in warning for warning in found.summary["warnings"])


def test_the_fmu_holds_what_was_found(found: CalibratedStudy, tmp_path: Path) -> None:
    folder = found.write(tmp_path / "result")
    with ComponentSpec(folder / "fmus" / "axis.fmu").open(folder / "fmus" / "axis.fmu") as fmu:
        start = {name: port.start for name, port in fmu.interface.ports.items()}
    for name, one in found.parameters.items():
        assert float(str(start[name.removeprefix("axis.")])) == pytest.approx(one["value"], rel=1e-12)
    assert "The ways side by side" in (folder / "report.html").read_text()


def test_friction_that_would_have_to_be_negative_is_none_and_said(tmp_path: Path) -> None:
    """What drives the axis the faster the faster it goes is no friction."""
    recorded(tmp_path / "run0.csv", Axis(viscous=(-30.0, -30.0)))
    document = calibrate(study(tmp_path, truth=None), tmp_path)
    for side in ("positive", "negative"):
        entry = document.parameters[f"axis.viscous_friction_{side}"]
        assert (entry["value"], entry["ci95"]) == (0.0, None)
        assert any(f"viscous_friction_{side} is 0, the least" in one for one in document.summary["warnings"])


def test_others_that_lie_outside_of_the_intervals_are_named(recordings: Path, tmp_path: Path) -> None:
    file = study(tmp_path, compare={"data sheet": {"axis.mass": 80.0}}, loop=None)
    warnings = calibrate(file, recordings).summary["warnings"]
    assert any("data sheet lies outside of the 95 % intervals, in half widths: axis.mass by" in one for one in warnings)


def test_what_noise_does_to_least_squares_is_told_and_in_the_intervals(tmp_path: Path) -> None:
    """With the loop's instruments there is nothing to tell."""
    recorded(tmp_path / "run0.csv", Axis(), noise=2e-5)
    file = study(tmp_path, truth=None, take="least-squares")
    document = calibrate(file, tmp_path)
    (told,) = [one for one in document.summary["warnings"] if "noise of the position is in its accelerations" in one]
    assert "with `cutoff: 24` values move: axis.mass by " in told
    low, high = document.parameters["axis.mass"]["ci95"] or (0.0, 0.0)
    assert low < Axis().mass < high
    said = calibrate(study(tmp_path, truth=None), tmp_path).summary["warnings"]
    assert not any("values move" in one for one in said)


def test_that_values_move_where_samples_near_rest_are_left_out_is_told(tmp_path: Path) -> None:
    recorded(tmp_path / "run0.csv", Axis())
    warnings = calibrate(study(tmp_path, truth=None, least_speed=0, cutoff=20), tmp_path).summary["warnings"]
    assert any("values move: axis.mass by" in one and "write `least_speed: 0.00" in one for one in warnings), warnings


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"write": {"viscous": "axis.viscous_friction_positive"}, "truth": None}, "lacks inertia"),
        ({"write": STUDY["write"] | {"offset": "axis.offset"}}, "coulomb_negative, coulomb_positive, offset apart"),
        ({"loop": None, "take": "instrumental"}, "needs the `loop`"),
        ({"truth": {"axis.offset": 1.0}}, "axis.offset is not written"),
        ({"write": STUDY["write"] | {"inertia": "axis.offset"}, "truth": None}, "kg does not fit N"),
        ({"position": {"signal": "position", "output": "axis.speed"}}, "name an output in m or rad"),
        ({"command": {"signal": "command", "input": "axis.command"}}, "N does not fit V"),
        ({"command": STUDY["command"] | {"gain": "axis.mass"}}, "N/V does not fit kg"),
        ({"cutoff": 600}, "cannot be had"),
        ({"cutoff": 201}, "cannot be had from 1000 samples a second; write `cutoff: 200` or less, or record faster"),
        ({"least_speed": 5}, "leaves no row"),
        ({"components": {"axis": {"model": "linear_axis", "parameters": {"drive_gain": -GAIN}}}}, "negative one"),
    ],
)
def test_what_does_not_fit_together_is_refused(
    recordings: Path, tmp_path: Path, changes: dict[str, Any], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        calibrate(study(tmp_path, **changes), recordings)


def test_on_the_real_axis_the_published_values_come_out_where_all_samples_count(
    emps_data: Path, tmp_path: Path
) -> None:
    """With the axis' slow samples left out, viscous friction is less: friction near rest is not Coulomb's."""
    given = YAML(typ="safe").load(EMPS)
    text = tmp_path / "all.yaml"
    YAML().dump(given | {"least_speed": 0.0}, text)
    everything, moving = (
        {name: one["value"] for name, one in calibrate(file, emps_data).parameters.items()} for file in (text, EMPS)
    )
    for name, published in given["compare"]["published"].items():
        assert everything[name] == pytest.approx(published, rel=0.04)
    assert moving["axis.mass"] == pytest.approx(95.109, rel=0.01)
    assert moving["axis.viscous_friction_positive"] < 0.95 * everything["axis.viscous_friction_positive"]
