"""Calibration from a study file to a result folder, on systems of real FMUs with known truth."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from fmpy.ssp.ssd import read_ssd, read_ssv

from fmus.errors import WiringError
from fmus.packaging import archive, defaults, targets
from fmus.parameters.ssv import parameter_set, read_values
from fmus.parameters.write_back import PROVENANCE
from identification.calibrate import calibrate_study, validate_result
from identification.output_error import calibration
from orchestrator import formats
from orchestrator.results import RECORD
from orchestrator.trace import Trace
from tests.support.identification.small_study import (
    COUNT,
    LENGTH,
    STEP,
    TRUTH,
    record,
    simulated,
    study,
    voltage,
    write_study,
)

Document = dict[str, Any]
PLAIN_HAND: dict[str, Any] = {"model": "pendulum", "parameters": {"added_length": LENGTH}}


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulate here: starting processes takes longer than these calibrations."""
    monkeypatch.setattr(calibration, "processors", lambda: 1)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("recordings"))


def calibrated(study_file: Path, data: Path, target: Path) -> Document:
    return calibrate_study(study_file, data, target, lambda fraction, remark: None)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory, data: Path) -> Path:
    """The folder that the calibration of the small study leaves."""
    folder = tmp_path_factory.mktemp("result")
    compare = {"the start": {name: block["start"] for name, block in study()["parameters"].items()}}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration, "processors", lambda: 1)
        calibrated(write_study(folder / "small.yaml", compare=compare), data, folder / "out")
    return folder / "out"


def strict(text: str) -> Any:
    """JSON as the standard has it."""

    def refuse(constant: str) -> Any:
        raise AssertionError(f"{constant} is no JSON")

    return json.loads(text, parse_constant=refuse)


def summary(folder: Path) -> Document:
    document: Document = strict((folder / "summary.json").read_text())
    return document


def test_the_truth_lies_inside_the_intervals_and_these_are_narrow(result: Path) -> None:
    for name, entry in summary(result)["parameters"].items():
        low, high = entry["ci95"]
        assert low <= TRUTH[name] <= high, name
        assert low <= entry["value"] <= high
        assert high - low < 0.03 * TRUTH[name], name
        assert entry["std"] > 0 and entry["truth"] == TRUTH[name]


def test_the_fit_of_unseen_traces_is_what_the_noise_leaves(result: Path) -> None:
    fit = summary(result)["fit"]
    assert set(fit["train"]["traces"]) == {"rig_0__a", "rig_50__b"}
    assert set(fit["validation"]["traces"]) == {"rig_100__c"}
    unseen = simulated(voltage(2), 0.1)
    left = 1 - 2e-4 / unseen.std()
    assert fit["validation"]["median"] == pytest.approx(left, abs=4e-4)


def test_other_parameters_are_judged_on_the_same_unseen_windows(result: Path, data: Path) -> None:
    fit = summary(result)["fit"]
    compared = fit["compared"]["the start"]
    assert compared["windows"] == fit["validation"]["windows"]
    start = {name: block["start"] for name, block in study()["parameters"].items()}
    measured = formats.read(data / "rig_100__c.csv").trace["angle"]
    error = np.linalg.norm(measured - simulated(voltage(2), 0.1, start))
    expected = 1 - error / np.linalg.norm(measured - measured.mean())
    assert compared["median"] == pytest.approx(expected, abs=1e-9)


def test_the_folder_holds_what_was_promised(result: Path) -> None:
    files = {str(path.relative_to(result)) for path in result.rglob("*") if path.is_file()} - {RECORD}
    parameters = {"parameters.ssv", "parameters.srmd"}
    free_run = {"free_run.yaml", "free_run.ssp", "free_run_commands.csv", "free_run_outputs.csv"}
    told = {"summary.json", "report.html", "study.yaml"}
    assert files == {"fmus/motor.fmu", "fmus/hand.fmu", *parameters, *free_run, *told}
    assert (result / "study.yaml").read_bytes() == (result.parent / "small.yaml").read_bytes()
    values = {name: entry["value"] for name, entry in summary(result)["parameters"].items()}
    assert read_values(result / "parameters.ssv") == values | {"hand.added_length": LENGTH}
    read_ssv(str(result / "parameters.ssv"), validate=True)


def test_importers_step_as_the_study_did(result: Path) -> None:
    for name in ("motor", "hand"):
        description = read_model_description(str(result / "fmus" / f"{name}.fmu"))
        assert float(description.defaultExperiment.stepSize) == STEP


def test_the_summary_has_every_key_that_others_rely_on(result: Path, data: Path) -> None:
    document = summary(result)
    for entry in document["parameters"].values():
        assert set(entry) >= {"value", "std", "ci95", "unit"}
    assert document["parameters"]["hand.inertia"]["unit"] == "kg.m2"
    assert document["parameters"]["hand.inertia"]["start"] == 0.006
    assert document["method"] == "output-error" and document["warnings"] == []
    assert {each["file"] for each in document["data"]} == {path.name for path in data.iterdir()}
    assert all(re.fullmatch(r"[0-9a-f]{64}", each["sha256"]) for each in document["data"])
    assert [each["role"] for each in document["data"]].count("held out") == 1
    assert {"servotwin", "python", "numpy", "scipy", "fmpy"} <= set(document["versions"])


def test_the_report_needs_no_network_and_names_every_parameter(result: Path) -> None:
    html = (result / "report.html").read_text()
    assert not re.search(r"https?://|@import|url\(|src=|<link", html)
    for name in TRUTH:
        assert name in html
    for word in ("A small rig", "rig_100__c", "numpy", summary(result)["data"][0]["sha256"]):
        assert word in html


def test_the_fmus_carry_the_estimates_as_defaults_and_where_they_come_from(result: Path) -> None:
    values = {name: entry["value"] for name, entry in summary(result)["parameters"].items()}
    files = archive.read(result / "fmus" / "hand.fmu")
    used = defaults.load(files[defaults.RESOURCE].decode())
    assert {f"hand.{name}": used[name] for name in ("inertia", "gravity_torque", "viscous_friction")} == {
        name: value for name, value in values.items() if name.startswith("hand.")
    }
    assert used["added_length"] == LENGTH and used["added_mass"] == 0
    assert strict(files[PROVENANCE].decode())["data"] == summary(result)["data"]


def test_the_written_fmus_judged_with_nothing_set_fit_to_the_last_bit_as_in_the_calibration(
    result: Path, data: Path, tmp_path: Path
) -> None:
    document = validate_result(result, data, tmp_path / "validation", lambda fraction, remark: None)
    fit = summary(result)["fit"]
    assert document["fit"] == {"unseen": fit["validation"], "fitted": fit["train"]}
    assert document["held"] and document["at_least"] == 0.95
    assert {each["trace"]: each["role"] for each in document["data"]}["rig_100__c"] == "held out"
    assert strict((tmp_path / "validation" / "summary.json").read_text()) == document
    assert (tmp_path / "validation" / "report.html").is_file()


def test_the_same_inputs_give_the_same_result_bit_for_bit(result: Path, data: Path, tmp_path: Path) -> None:
    calibrated(result / "study.yaml", data, tmp_path / "again")
    assert_same_result(tmp_path / "again", result)


def test_the_number_of_processes_changes_no_bit(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    traces = study()["traces"] | {"hold_out": []}
    study_file = write_study(tmp_path / "study.yaml", traces=traces, options={"max_evaluations": 4})
    for processes in (1, 2):
        monkeypatch.setattr(calibration, "processors", lambda number=processes: number)
        calibrated(study_file, data, tmp_path / str(processes))
    assert_same_result(tmp_path / "1", tmp_path / "2")


def assert_same_result(one: Path, other: Path) -> None:
    for name in ("summary.json", "parameters.ssv", "fmus/hand.fmu", "fmus/motor.fmu"):
        assert (one / name).read_bytes() == (other / name).read_bytes(), name


def test_a_second_calibration_replaces_the_first(result: Path, data: Path, tmp_path: Path) -> None:
    target = tmp_path / "out"
    fixed = {name: {"start": value, "fixed": name != "hand.inertia"} for name, value in TRUTH.items()}
    for title in ("first", "second"):
        calibrated(write_study(tmp_path / "study.yaml", title=title, parameters=fixed), data, target)
    assert summary(target)["title"] == "second"
    assert {path.name for path in tmp_path.iterdir()} == {"out", "study.yaml"}


def test_fixed_parameters_stay_and_have_no_interval(data: Path, tmp_path: Path) -> None:
    parameters = {name: {"start": value, "fixed": True} for name, value in TRUTH.items()}
    parameters["hand.inertia"] = {"start": 0.006, "min": 0.001}
    document = calibrated(write_study(tmp_path / "study.yaml", parameters=parameters), data, tmp_path / "out")
    gain, inertia = document["parameters"]["motor.torque_gain"], document["parameters"]["hand.inertia"]
    assert (gain["value"], gain["std"], gain["ci95"]) == (8.0, None, None)
    low, high = inertia["ci95"]
    assert low <= TRUTH["hand.inertia"] <= high


def test_a_tied_parameter_follows_with_its_interval(tmp_path: Path) -> None:
    friction = {"hand.coulomb_friction_positive": 4e-3, "hand.coulomb_friction_negative": 2e-3}
    truth = TRUTH | friction
    write_recordings(tmp_path / "data", truth)
    known = {name: {"start": value, "fixed": True} for name, value in TRUTH.items()}
    parameters = known | {
        "hand.coulomb_friction_negative": {"start": 1e-3, "min": 0},
        "hand.coulomb_friction_positive": {"tied": "hand.coulomb_friction_negative", "factor": 2},
    }
    study_file = write_study(tmp_path / "study.yaml", parameters=parameters, truth=truth)
    document = calibrated(study_file, tmp_path / "data", tmp_path / "out")
    positive, negative = (document["parameters"][name] for name in friction)
    assert positive["value"] == 2 * negative["value"] and positive["std"] == 2 * negative["std"]
    assert positive["ci95"] == [2 * end for end in negative["ci95"]] and positive["start"] is None
    for name, value in friction.items():
        low, high = document["parameters"][name]["ci95"]
        assert low <= value <= high
    used = defaults.load(archive.read(tmp_path / "out" / "fmus" / "hand.fmu")[defaults.RESOURCE].decode())
    assert used["coulomb_friction_positive"] == positive["value"]


def write_recordings(folder: Path, truth: Mapping[str, float], noise: float = 2e-4) -> None:
    """The recordings of the small study, of another rig."""
    folder.mkdir()
    for number, (name, mass) in enumerate({"rig_0__a": 0.0, "rig_50__b": 0.05, "rig_100__c": 0.1}.items()):
        angle = simulated(voltage(number), mass, truth) + np.random.default_rng(number).normal(0, noise, COUNT)
        trace = Trace(np.arange(COUNT) * STEP, {"voltage": voltage(number), "angle": angle})
        formats.write(trace, folder / f"{name}.csv")


def test_back_emf_and_viscous_friction_are_named_as_one_sum(data: Path, tmp_path: Path) -> None:
    """The motor sees the speed a step late, which tells the two apart in theory; in practice only their sum is seen."""
    both = {"hand.viscous_friction": {"start": 0.001, "min": 0}, "motor.back_emf": {"start": 5e-5, "min": 0}}
    known = {name: {"start": TRUTH[name], "fixed": True} for name in TRUTH if name not in both}
    study_file = write_study(tmp_path / "study.yaml", parameters=known | both)
    document = calibrated(study_file, data, tmp_path / "out")
    (message,) = document["uncertainty"]["weak"]
    assert "hand.viscous_friction and motor.back_emf: hardly more than a sum of them is seen" in message
    weight = re.search(r"hand\.viscous_friction \+ (\S+) \* motor\.back_emf", message)
    assert weight is not None and float(weight[1]) == pytest.approx(TRUTH["motor.torque_gain"], rel=0.01)
    assert message in document["warnings"]
    total = (
        document["parameters"]["hand.viscous_friction"]["value"] + 8 * document["parameters"]["motor.back_emf"]["value"]
    )
    assert total == pytest.approx(TRUTH["hand.viscous_friction"], rel=0.02)
    assert message in (tmp_path / "out" / "report.html").read_text()
    assert summary(tmp_path / "out") == document


def test_what_has_exactly_the_same_effect_is_named_and_has_no_interval(data: Path, tmp_path: Path) -> None:
    parameters = {name: {"start": TRUTH[name], "fixed": True} for name in TRUTH if name != "motor.torque_gain"}
    parameters |= {
        name: {"start": start, "min": 0.1}
        for name, start in (("motor.torque_gain", 7.0), ("motor.resistance", 2.0), ("hand.gravity", 9.8))
    }
    document = calibrated(write_study(tmp_path / "study.yaml", parameters=parameters), data, tmp_path / "out")
    assert document["uncertainty"]["unseen"] == ["motor.resistance has no effect on the outputs"]
    assert document["uncertainty"]["unseen"][0] in document["warnings"]
    resistance, gain = document["parameters"]["motor.resistance"], document["parameters"]["motor.torque_gain"]
    assert resistance["std"] is None and resistance["ci95"] == [None, None]
    low, high = gain["ci95"]
    assert low <= 8 <= high
    assert summary(tmp_path / "out") == document


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
    verdict = validate_result(tmp_path / "out", tmp_path / "data", tmp_path / "judged", lambda fraction, remark: None)
    assert verdict["held"] is True and verdict["at_least"] is None


def foreign(path: Path) -> Path:
    """The pendulum's FMU as if another tool had made it."""
    targets.build("pendulum", path, target="python")
    files = archive.read(path)
    text = files["modelDescription.xml"].replace(b'generationTool="servotwin"', b'generationTool="Somebody"')
    archive.write(path, files | {"modelDescription.xml": text})
    return path


@pytest.mark.slow
def test_a_foreign_fmu_is_calibrated_by_sets_beside_it_and_validated_with_them(data: Path, tmp_path: Path) -> None:
    source = foreign(tmp_path / "Hand.fmu")
    before = source.read_bytes()
    components = study()["components"] | {"hand": {"fmu": "Hand.fmu", "parameters": {"added_length": LENGTH}}}
    document = calibrated(write_study(tmp_path / "study.yaml", components=components), data, tmp_path / "out")
    fmus = tmp_path / "out" / "fmus"
    names = {"motor.fmu", "hand.fmu", "hand.ssv", "hand.ssp", "hand.provenance.json"}
    assert {path.name for path in fmus.iterdir()} == names
    assert source.read_bytes() == (fmus / "hand.fmu").read_bytes() == before
    values = {
        name.removeprefix("hand."): entry["value"]
        for name, entry in document["parameters"].items()
        if name.startswith("hand.")
    }
    assert read_values(fmus / "hand.ssv") == {"added_length": LENGTH, **values}
    assert read_ssd(str(fmus / "hand.ssp"), validate=True).system.elements[0].source == "resources/Hand.fmu"
    for name, entry in document["parameters"].items():
        low, high = entry["ci95"]
        assert low <= TRUTH[name] <= high, name
    verdict = validate_result(tmp_path / "out", data, tmp_path / "judged", lambda fraction, remark: None)
    assert verdict["fit"]["unseen"] == document["fit"]["validation"]
    inertia = read_values(fmus / "hand.ssv")["inertia"]
    units = {"inertia": "g.m2"}  # as another tool may write it
    changed = parameter_set("changed", {"added_length": LENGTH, **values, "inertia": 1000 * float(inertia)}, units)
    (fmus / "hand.ssv").write_bytes(changed)
    verdict = validate_result(tmp_path / "out", data, tmp_path / "judged", lambda fraction, remark: None)
    assert verdict["fit"]["unseen"]["median"] == pytest.approx(document["fit"]["validation"]["median"], abs=1e-9)
    (fmus / "hand.ssv").write_bytes(changed.replace(b'unit="g.m2"', b'unit="bar"'))
    with pytest.raises(WiringError, match=r"hand\.inertia: bar does not fit kg\.m2"):
        validate_result(tmp_path / "out", data, tmp_path / "judged", lambda fraction, remark: None)


@pytest.mark.slow
def test_choices_given_by_name_are_written_back_too(tmp_path: Path, data: Path) -> None:
    """A source inside the system: its shape is a name in the study and must be a default of its FMU afterwards."""
    driven = {"drive": {"model": "excitation", "parameters": {"shape": "square", "amplitude": 0.01, "frequency": 2.0}}}
    rig: dict[str, Any] = {
        "title": "A driven rig",
        "components": driven
        | {
            "motor": {"model": "dc_motor", "parameters": {"torque_gain": 8.0}},
            "hand": {"model": "pendulum", "parameters": {"inertia": 0.004}},
        },
        "connections": ["drive.signal -> motor.voltage", *study()["connections"]],
    }
    run_rig(tmp_path / "rig.yaml", rig, tmp_path / "driven.csv")
    components = rig["components"] | {"hand": {"model": "pendulum"}, "motor": {"model": "dc_motor"}}
    study_file = write_study(
        tmp_path / "study.yaml",
        components=components,
        connections=rig["connections"],
        inputs=None,
        traces={"files": "driven.csv"},
        outputs={"hand.angle": {"signal": "hand.angle"}},
        truth=None,
        parameters={"hand.inertia": {"start": 0.003, "min": 0.001}, "motor.torque_gain": {"start": 7.0, "min": 0.1}},
    )
    document = calibrated(study_file, tmp_path, tmp_path / "out")
    assert document["parameters"]["hand.inertia"]["value"] == pytest.approx(0.004, rel=1e-3)
    used = defaults.load(archive.read(tmp_path / "out" / "fmus" / "drive.fmu")[defaults.RESOURCE].decode())
    assert (used["shape"], used["amplitude"], used["frequency"]) == (3, 0.01, 2.0)
    verdict = validate_result(tmp_path / "out", tmp_path, tmp_path / "judged", lambda fraction, remark: None)
    assert verdict["fit"]["fitted"] == document["fit"]["train"]
    assert verdict["warnings"] == ["every recording was used in the fit; this judges nothing new"]


def run_rig(scenario: Path, rig: Mapping[str, Any], target: Path) -> None:
    from orchestrator.scenario.run import run_scenario

    scenario.write_text(json.dumps({**rig, "run": {"stop": 1, "step": STEP}, "record": ["hand.angle"]}))
    result = run_scenario(scenario)
    formats.write(result.recorded(result.cases[0]), target)


def test_a_calibrated_fmu_in_another_tool_swings_as_the_true_rig(result: Path) -> None:
    """FMPy alone, nothing set: a released pendulum has the period of the true one."""
    run = simulate_fmu(
        str(result / "fmus" / "hand.fmu"), stop_time=3, output_interval=0.01, start_values={"angle_start": 0.05}
    )
    values = {name.removeprefix("hand."): value for name, value in TRUTH.items() if "hand" in name}
    truth = targets.build("pendulum", result.parent / "true.fmu", parameters=values, target="python")
    other = simulate_fmu(str(truth), stop_time=3, output_interval=0.01, start_values={"angle_start": 0.05})
    assert np.max(np.abs(run["angle"] - other["angle"])) < 5e-4
