"""A study by `method: motion`, from recordings of a rig of FMUs to recalibrated FMUs, and what it refuses."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from fmus.errors import InputError
from identification.calibrate import CalibratedStudy, calibrate
from orchestrator.assembly.assembly import ComponentSpec
from orchestrator.formats import Layout
from orchestrator.formats.can_conversion import convert
from orchestrator.progress import silent
from orchestrator.scenario.results import write_run
from orchestrator.scenario.run import run_scenario

pytestmark = pytest.mark.slow  # a calibration

SCENARIOS = Path(__file__).parents[3] / "scenarios" / "butterfly" / "motion"
STUDY = SCENARIOS / "recalibration.yaml"
Block = dict[str, Any]


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the rig leaves."""
    folder = tmp_path_factory.mktemp("rig") / "run"
    write_run(run_scenario(SCENARIOS / "rig.yaml"), {}, folder)
    return folder


@pytest.fixture(scope="module")
def found(recordings: Path) -> CalibratedStudy:
    return calibrate(STUDY, recordings)


def test_near_the_motion_the_recalibrated_model_runs_three_times_better_than_the_generic_one(
    found: CalibratedStudy,
) -> None:
    """The thesis' main claim, on a rig with dry friction and play that the model has not; every window by itself."""
    windows = found.summary["free_runs"]["windows"]  # type: ignore[typeddict-item]
    assert len(windows["balance"]) >= 4
    assert all(windows["generic"][name] > 3 * error for name, error in windows["balance"].items())
    assert found.summary["verdict"]["held"]


def test_what_a_motion_cannot_tell_is_named_and_held(found: CalibratedStudy) -> None:
    assert any("up to a common factor: p4 is held at 2.96" in warning for warning in found.summary["warnings"])
    assert found.parameters["motor.torque_gain"]["value"] == 2.96
    assert found.parameters["motor.torque_gain"]["ci95"] is None


def test_the_ratio_of_weight_and_inertia_is_the_rigs(found: CalibratedStudy) -> None:
    rig = 0.15831697 / (3.7956640e-3 + 3e-4)
    ratio = found.parameters["hand.gravity_torque"]["value"] / found.parameters["hand.inertia"]["value"]
    assert ratio == pytest.approx(rig, rel=5e-3)


def test_all_ways_stand_side_by_side(found: CalibratedStudy) -> None:
    ways = found.summary["found"]  # type: ignore[typeddict-item]
    assert set(ways) == {"balance", "invariant", "published"}
    assert all(one["ci95"] is None for one in ways["published"]["parameters"].values())
    assert all(one["ci95"] is not None for one in ways["invariant"]["parameters"].values())


def test_the_result_holds_fmus_that_are_recalibrated_with_nothing_set(found: CalibratedStudy, tmp_path: Path) -> None:
    folder = found.write(tmp_path / "result")
    assert sorted(file.name for file in (folder / "fmus").iterdir()) == ["controller.fmu", "hand.fmu", "motor.fmu"]
    with ComponentSpec(folder / "fmus" / "controller.fmu").open(folder / "fmus" / "controller.fmu") as fmu:
        start = {name: float(port.start or "nan") for name, port in fmu.interface.ports.items() if port.start}
    for name in ("p1", "p2", "p3", "p4"):
        assert start[name] == pytest.approx(found.parameters[f"controller.{name}"]["value"], rel=1e-12)
    assert start["amplitude"] == 1.0
    assert json.loads((folder / "summary.json").read_text())["intervals"] == "stretches"
    assert "Free runs in the tube" in (folder / "report.html").read_text()


def test_logs_of_a_bus_tell_the_same_as_the_recordings_that_they_were_made_of(
    recordings: Path, tmp_path: Path, found: CalibratedStudy
) -> None:
    layout = Layout(database=SCENARIOS.parent / "butterfly.dbc")
    for file in recordings.glob("*.csv"):
        convert(file, tmp_path / f"{file.stem}.blf", layout, silent)
    logged = calibrate(SCENARIOS / "recalibration_can.yaml", tmp_path)
    assert logged.summary["verdict"]["held"]
    for name, entry in found.parameters.items():
        assert logged.parameters[name]["value"] == pytest.approx(entry["value"], rel=2e-3)


def study(folder: Path, change: Callable[[Block], object]) -> Path:
    """The study with a change, as a file."""
    yaml = YAML()
    block = yaml.load(STUDY)
    change(block)
    yaml.dump(block, folder / "study.yaml")
    return folder / "study.yaml"


def parameters(block: Block, component: str) -> Block:
    return block["components"][component]["parameters"]  # type: ignore[no-any-return]


REFUSED: list[tuple[Callable[[Block], object], str]] = [
    (
        lambda b: parameters(b, "controller").update(amplitude=0.0),
        "controller.amplitude: 0 rad asks for the downward equilibrium's energy, 0 J, which Lemma 8 excludes; ask for",
    ),
    (lambda b: parameters(b, "controller").update(amplitude=3.141592653589793), "asks for the upright equilibrium's"),
    (lambda b: parameters(b, "controller").update(p1=5e-3), "write.p1.controller.p1: is 0.005 where hand.inertia is"),
    (
        lambda b: parameters(b, "motor").update(torque_gain=0.0) or parameters(b, "controller").update(p4=0.0),
        "write.p4",
    ),
    (lambda b: b["write"].pop("p3"), "`write` lacks p3"),
    (lambda b: b["write"].update(dry_positive="hand.coulomb_friction_positive"), "or neither"),
    (lambda b: b.pop("controller") and b.update(take="published"), "needs E\\* and gain"),
    (lambda b: b.pop("voltage"), "need a recorded `voltage`"),
    (
        lambda b: b.update(take="invariant") or parameters(b, "controller").update(gain=0.02),
        "another one made the motion",
    ),
    (lambda b: b.update(equilibrium="hand.middle"), "no variable 'middle'"),
    (lambda b: b["write"].update(p2="hand.inertia"), "does not fit kg.m2"),
    (lambda b: b["free_runs"].update(periods=100), "free_runs: 100 periods of 1.05"),
    (lambda b: b["traces"].update(hold_out=["x"]), "mean nothing here"),
    (lambda b: b.update(held="p2"), "held"),
]


@pytest.mark.parametrize(("change", "message"), REFUSED)
def test_what_does_not_fit_is_refused(
    change: Callable[[Block], object], message: str, recordings: Path, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        calibrate(study(tmp_path, change), recordings)


def test_recordings_of_another_controller_are_no_obstacle_to_the_balance(recordings: Path, tmp_path: Path) -> None:
    found = calibrate(study(tmp_path, lambda b: parameters(b, "controller").update(gain=0.02)), recordings)
    assert "another one made the motion" in found.summary["refused"]["invariant"]  # type: ignore[typeddict-item]
    assert any("another one made the motion" in warning for warning in found.summary["warnings"])
    assert found.summary["verdict"]["held"]


def test_dry_friction_goes_where_a_component_takes_it(recordings: Path, tmp_path: Path) -> None:
    def change(block: Block) -> None:
        block["write"] |= {f"dry_{side}": f"hand.coulomb_friction_{side}" for side in ("positive", "negative")}

    found = calibrate(study(tmp_path, change), recordings)
    scale = 2.96 / 2.466
    assert found.parameters["hand.coulomb_friction_positive"]["value"] == pytest.approx(scale * 3.2e-3, rel=0.2)
    assert found.parameters["hand.coulomb_friction_negative"]["value"] == pytest.approx(scale * 6.2e-3, rel=0.2)


def test_a_generic_model_that_is_near_already_misses_the_target_and_the_reason_is_told(
    recordings: Path, tmp_path: Path, found: CalibratedStudy
) -> None:
    known = {name: found.summary["parameters"][f"controller.{name}"]["value"] for name in ("p1", "p2", "p3", "p4")}

    def change(block: Block) -> None:
        block.pop("controller")
        parameters(block, "controller").update(known)
        parameters(block, "motor").update(torque_gain=known["p4"])
        hand = {"inertia": known["p1"], "viscous_friction": known["p2"], "gravity_torque": known["p3"]}
        parameters(block, "hand").update(hand)

    verdict = calibrate(study(tmp_path, change), recordings).summary["verdict"]
    assert not verdict["held"]
    assert verdict["reached"] == pytest.approx(1, rel=0.01)
    assert "MISSED" in verdict["said"] and "the generic model was near the motion already" in verdict["said"]


def test_pieces_of_a_log_between_gaps_count_where_they_swing(recordings: Path, tmp_path: Path) -> None:
    def change(block: Block) -> None:
        block["traces"]["exclude"] = [[8, 9], [9.5, 10]]

    found = calibrate(study(tmp_path, change), recordings)
    assert found.summary["verdict"]["held"]
    assert any("2 pieces of recordings last less than 2 periods" in warning for warning in found.summary["warnings"])
    with pytest.raises(InputError, match="without gaps"):
        calibrate(study(tmp_path, lambda b: b["traces"].update(exclude=[[1, 100]])), recordings)
