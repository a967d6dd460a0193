"""Plants of components: their linear models run as the FMUs do, and draws of them have the spread that was given."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus import library
from fmus.errors import IdentificationError, InputError
from identification import tune
from identification.experiments.physical_modes import physical_modes
from identification.linearisation.equations import slopes
from identification.tuning.assembled import assembled
from identification.tuning.schema import TuneBlock
from identification.tuning.sources.calibrated import calibrated_system
from identification.tuning.sources.system_plant import PlantOutput, SystemPlant, independent
from orchestrator.assembly.assembly import ComponentSpec, SystemSpec, open_system
from orchestrator.trace import Trace
from orchestrator.yaml_file import load
from tests.support.identification.tuning_study import STEP, driven, system_study, write

RATE = 1 / 300
SMOOTH = {"bristle_stiffness": 1e-6, "bristle_damping": 0.0}
ARM = SystemSpec(
    {
        "drive": ComponentSpec("servo_drive"),
        "arm": ComponentSpec("flexible_arm", {**SMOOTH, "payload": 0.2}),
        "tachometer": ComponentSpec("daq", {"gain": 0.4, "filter_order": 2, "cutoff": 60.0, "sample_time": RATE}),
    },
    (("drive.torque", "arm.torque"), ("arm.speed", "tachometer.signal")),
)


def arm(**spread: float) -> SystemPlant:
    outputs = {
        "angle": PlantOutput("arm.angle"),
        "strain": PlantOutput("arm.middle_strain", 1e4, "V"),
        "speed": PlantOutput("tachometer.measured", unit="V"),
    }
    return SystemPlant(ARM, {"u": "drive.voltage"}, outputs, independent(spread))


@pytest.mark.slow
def test_a_linear_plant_runs_as_its_fmus_do() -> None:
    """The drive's command is a random one, held over each sample; within it the FMUs exchange values often."""
    u, fine = 0.5 * np.random.default_rng(0).standard_normal(120), 64
    time = RATE / fine * np.arange(fine * len(u))
    record = ["arm.angle", "arm.middle_strain", "tachometer.measured"]
    with open_system(ARM.components, [f"{a} -> {b}" for a, b in ARM.connections], ["drive.voltage"]) as opened:
        stimulus = {"drive.voltage": Trace(time, {"u": np.repeat(u, fine)}, {"u": "V"})}
        trace = opened.run("119/300", f"1/{300 * fine}", ARM.values(), stimulus, record).trace
    found = arm().linear("plant", RATE).model.simulate(u[:, None])
    scale = np.abs(found).max(axis=0)
    assert found[:, 0] == pytest.approx(trace["arm.angle"][::fine], abs=2e-4 * scale[0])
    assert found[:, 1] == pytest.approx(1e4 * trace["arm.middle_strain"][::fine], abs=2e-4 * scale[1])
    sampled = trace["tachometer.measured"][1::fine]
    assert found[: len(sampled), 2] == pytest.approx(sampled, abs=2e-2 * scale[2])


@pytest.mark.slow
def test_what_no_input_reaches_is_left_out() -> None:
    """Of 16 states of the arm bristles, the motor's side of a rigid gear and the stops' clock are not reached."""
    model = arm().linear("plant", RATE).model
    assert model.order == 14
    frequencies = np.sort(np.abs(np.log(model.eigenvalues)) / RATE / 2 / np.pi)
    known = [mode.frequency for mode in physical_modes("flexible_arm", {**SMOOTH, "payload": 0.2})]
    assert frequencies[2:6:2] == pytest.approx(known[:2], rel=1e-6)


@pytest.mark.slow
def test_draws_have_the_spread_that_was_given_and_stay_within_bounds() -> None:
    drawn = arm(**{"drive.torque_constant": 0.05}).drawn("plant", RATE, 400, np.random.default_rng(1))
    gains = np.array([model.frequency_response(np.array([1.0]))[0, 0, 0] for model in drawn])
    relative = np.abs(gains) / np.abs(arm().linear("plant", RATE).model.frequency_response(np.array([1.0]))[0, 0, 0])
    assert relative.mean() == pytest.approx(1.0, abs=0.02)
    assert relative.std() == pytest.approx(0.05 / 0.5876, rel=0.15)
    near_zero = arm(**{"arm.viscous_friction": 0.05}).drawn("plant", RATE, 200, np.random.default_rng(2))
    assert all(model.stable for model in near_zero)


@pytest.mark.parametrize(
    ("name", "parameters", "problem"),
    [
        ("pendulum", {"angle_start": 0.3}, "does not rest where it starts: 'speed' changes"),
        ("daq", {"bits": 12, "range": 10.0}, "rounds what it samples"),
        ("daq", {"noise": 0.1}, "jumps or bends where it rests"),
        ("pi", {}, "remembers what it samples"),
    ],
)
def test_a_component_without_slopes_at_rest_is_refused(name: str, parameters: dict[str, float], problem: str) -> None:
    with pytest.raises(IdentificationError, match=problem):
        slopes("plant", library.find(name), parameters)


def test_slopes_of_many_parameter_sets_are_those_of_each() -> None:
    payloads = np.array([0.0, 0.2, 0.4])
    together = slopes("arm", library.find("flexible_arm"), {**SMOOTH, "payload": payloads}, 3)
    for number, payload in enumerate(payloads):
        alone = slopes("arm", library.find("flexible_arm"), {**SMOOTH, "payload": float(payload)})
        assert together.a[number] == pytest.approx(alone.a[0], rel=1e-12)


def test_a_command_of_another_unit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"controller\.voltage -> plant\.u: .*N\.m"):
        tune(write(tmp_path, system_study(tmp_path)))


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({"load.inertia": -1}, "load.inertia: is -1, outside its bounds"),
        ({"load.inertia": "3 V"}, "load.inertia: V does not fit kg.m2"),
        ({"lead.inertia": 1}, "set.lead.inertia: names no component of the plant"),
    ],
)
def test_a_value_of_a_plant_that_does_not_fit_is_named_by_plant_and_line(
    tmp_path: Path, values: dict[str, Any], problem: str
) -> None:
    study = system_study(tmp_path)
    name = next(iter(study["plants"]))
    study["plants"][name]["set"] = values
    file = write(tmp_path, study)
    file.write_text(json.dumps(study, indent=1))
    line = 1 + next(n for n, text in enumerate(file.read_text().splitlines()) if f'"{next(iter(values))}"' in text)
    with pytest.raises(InputError, match=rf"{file.name}:{line}: plants\.{name}: {problem}"):
        tune(file)


@pytest.mark.slow
def test_hard_goals_hold_for_the_share_of_draws_that_was_asked_for(tmp_path: Path) -> None:
    """A heavier load turns the phase more: the margin of the nominal one has to be larger, and just so much."""
    alone = tune(write(tmp_path, driven(tmp_path))).summary
    spread = driven(tmp_path, spread={"load.inertia": 0.01})
    found: Any = tune(write(tmp_path, spread | {"draws": {"count": 200, "share": 0.9}})).summary
    assert found["feasible"]
    assert 0.9 <= found["draws"]["held"] <= 0.96
    assert found["parameters"]["controller.kp"]["value"] < 0.99 * alone["parameters"]["controller.kp"]["value"]
    assert found["draws"]["count"] == 200
    unseen = found["draws"]["unseen"]
    [margin, itae] = unseen["goals"]
    assert margin["held"] == unseen["held"]
    assert margin["held"]["ci95"][0] < 0.9 < margin["held"]["ci95"][1]
    assert margin["percentiles"][0] < 60 < margin["percentiles"][2]
    assert itae["held"] is None
    assert unseen["stable"]["share"] == 1.0


def test_as_many_draws_of_each_plant_as_the_search_sees_are_kept_from_it(tmp_path: Path) -> None:
    document = driven(tmp_path, spread={"load.inertia": 0.01})
    [load_plant] = document["plants"].values()
    document["plants"] = {"one": load_plant, "two": load_plant}
    parts = assembled(load(write(tmp_path, document | {"draws": {"count": 5}}), TuneBlock).study(tmp_path))
    sought, unseen = parts.problem.draws, parts.unseen
    assert sought is not None
    assert unseen is not None
    for name in ("one", "two"):
        assert [sum(draw.startswith(name) for draw in each.names) for each in (sought, unseen)] == [5, 5]
    assert len(np.unique(np.concatenate([sought.a, unseen.a])[:, 0, 1])) == 20


def test_draws_without_a_spread_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="draws: are asked for, and no plant has a spread"):
        tune(write(tmp_path, driven(tmp_path) | {"draws": {}}))


@pytest.mark.slow
def test_a_delay_of_part_of_a_sample_is_exact_for_a_system(tmp_path: Path) -> None:
    half, one = (
        tune(write(tmp_path, driven(tmp_path) | {"delay": delay})).summary["parameters"]["controller.kp"]["value"]
        for delay in (STEP / 2, STEP)
    )
    assert half > one


def calibration(folder: Path) -> None:
    """The result of an output-error study of a load and of a delay, which is no component's."""
    blocks = {
        "traces": {"files": "*.csv"},
        "step": 0.01,
        "outputs": {"load.angle": {"signal": "y"}},
        "windows": {"length": 1},
    }
    components = {"components": {"load": {"model": "load.py"}}}
    parameters = {"load.inertia": {"start": 1, "min": 0.1, "max": 2}, "late": {"start": 0, "min": 0, "max": 1}}
    document = {"title": "x", "method": "output-error", "parameters": parameters} | blocks | components
    (folder / "study.yaml").write_text(json.dumps(document))
    estimates = {name: {"value": 0.3, "std": 0.1, "ci95": None, "unit": "1", "start": None} for name in parameters}
    summary = {"title": "x", "method": "output-error", "parameters": estimates, "fit": {}, "data": [], "versions": {}}
    covariance = {"parameters": ["late", "load.inertia"], "matrix": [[4.0, 1.0], [1.0, 0.01]]}
    (folder / "summary.json").write_text(
        json.dumps(summary | {"warnings": [], "uncertainty": {"covariance": covariance}})
    )


def test_a_calibrated_system_has_its_estimates_and_their_covariance(tmp_path: Path) -> None:
    calibration(tmp_path)
    system, spread = calibrated_system(tmp_path)
    assert system.values() == {"load.inertia": 0.3}
    assert spread.names == ("load.inertia",)
    assert spread.covariance.tolist() == [[0.01]]


def plant_of(folder: Path, **keys: Any) -> SystemPlant:
    document = driven(folder, **keys)
    found = load(write(folder, document), TuneBlock).study(folder).plants["load"]
    assert isinstance(found, SystemPlant)
    return found


def test_a_plant_of_components_takes_what_a_calibration_has_found_of_it(tmp_path: Path) -> None:
    (tmp_path / "found").mkdir()
    calibration(tmp_path / "found")
    own = {"spread": {"drive.torque_constant": 0.1}, "calibration": {"folder": "found"}}
    plant = plant_of(tmp_path, **own)
    assert plant.system.values()["load.inertia"] == 0.3
    assert plant.spread.names == ("drive.torque_constant", "load.inertia")
    assert plant.spread.covariance == pytest.approx(np.diag([0.01, 0.01]))
    set_over_it = plant_of(tmp_path, **own, set={"load.inertia": 0.5})
    assert set_over_it.system.values()["load.inertia"] == 0.5


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        (
            {"calibration": {"folder": "found", "parameters": ["load.mass"]}},
            r"has no covariance of load\.mass; there are",
        ),
        ({"calibration": {"folder": "nowhere"}}, r"nowhere: holds no summary\.json"),
        (
            {"calibration": {"folder": "found"}, "spread": {"load.inertia": 0.1}},
            r"spread\.load\.inertia: varies by itself and with the calibration",
        ),
    ],
)
def test_a_calibration_that_does_not_fit_is_refused(tmp_path: Path, keys: dict[str, Any], problem: str) -> None:
    (tmp_path / "found").mkdir()
    calibration(tmp_path / "found")
    with pytest.raises(InputError, match=problem):
        plant_of(tmp_path, **keys)
