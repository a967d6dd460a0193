"""Subspace studies from their files to FMUs: the model that is written is the one that was found."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from fmus.errors import IdentificationError, ScenarioError, TraceError
from identification import tune
from identification.calibrate import calibrate_study
from identification.linear.modes import modes
from identification.study import load_study
from identification.tuning.sources.calibrated_model import CalibratedPlant
from identification.validation import validate_result
from orchestrator import formats
from orchestrator.info import about
from orchestrator.progress import silent
from orchestrator.trace import Trace
from tests.support.identification.linear_fits import STEP, eigenvalue, model_of, white

PLANT = model_of([eigenvalue(9.0, 0.03), eigenvalue(23.0, 0.05), 0.98], outputs=2)
STUDY = """\
title: A plant with two modes
method: subspace
traces: {files: "*.csv", hold_out: [third]}
inputs: [u]
outputs: [y, z]
block: 15
weightings: [orse, n4sid]
order: {best: [3, 7]}
initial_states: false
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    """A study file beside three recordings of the plant."""
    for number, name in enumerate(("first", "second", "third")):
        u = white(1200, seed=number)
        y = PLANT.simulate(u)
        signals = {"u": u[:, 0], "y": y[:, 0], "z": y[:, 1]}
        units = {"u": "V", "y": "rad", "z": "m"}
        formats.write(Trace(STEP * np.arange(len(u)), signals, units, name), tmp_path / f"{name}.csv")
    file = tmp_path / "study.yaml"
    file.write_text(STUDY)
    return file


def calibrated(file: Path, more: str = "") -> dict[str, object]:
    file.write_text(STUDY + more)
    return calibrate_study(file, file.parent, file.parent / "out", silent)


@pytest.mark.slow
def test_the_fmu_that_is_written_runs_as_the_plant_does(study: Path) -> None:
    document = calibrated(study)
    assert document["fit"]["validation"]["median"] > 0.9999  # type: ignore[index]
    u = white(300, seed=9)
    time = STEP * np.arange(len(u))
    driven = np.array(list(zip(time, u[:, 0], strict=True)), dtype=[("time", float), ("u", float)])
    result = fmpy.simulate_fmu(
        str(study.parent / "out" / "fmus" / "plant.fmu"),
        input=driven,
        stop_time=time[-1],
        output_interval=STEP,
        output=["y", "z"],
    )
    expected = PLANT.simulate(u)
    found = np.column_stack([result["y"], result["z"]])
    errors = [np.abs(found[late : late + 250] - expected[:250]).max() for late in (0, 1)]
    assert min(errors) < 1e-3 * np.abs(expected).max()


@pytest.mark.slow
def test_the_model_that_is_written_has_to_reach_the_target_on_the_traces_kept_aside(study: Path) -> None:
    verdicts = [calibrated(study, f"at_least: {target}\n")["verdict"] for target in (0.99, 1.1)]
    assert [verdict["held"] for verdict in verdicts] == [True, False]  # type: ignore[index]
    assert "MISSED: median FIT, unseen, 1.0000, at least 1.1 asked for" in verdicts[1]["said"]  # type: ignore[index]


@pytest.mark.slow
def test_irregular_stamps_are_refused_and_put_on_a_grid_where_one_is_given(study: Path) -> None:
    raw = formats.read(study.parent / "first.csv").trace
    jittered = raw.time + STEP * np.random.default_rng(0).uniform(-0.3, 0.3, len(raw))
    formats.write(Trace(jittered, raw.signals, raw.units, "first"), study.parent / "first.csv")
    with pytest.raises(TraceError, match="resample it"):
        calibrated(study)
    assert calibrated(study, f"sample: {STEP}\n")["models"]


@pytest.mark.slow
def test_modes_of_the_refined_model_come_with_their_uncertainty(study: Path) -> None:
    document = calibrated(study, "refine: true\n")
    modes = document["models"]["refined"]["modes"]  # type: ignore[index]
    frequencies = sorted(mode["frequency"] for mode in modes if mode["frequency_std"] is not None)
    assert min(abs(f - 9.0) for f in frequencies) < 1e-3
    assert all(mode["frequency_std"] >= 0 for mode in modes if mode["frequency_std"] is not None)


@pytest.mark.slow
def test_a_report_is_drawn_where_models_of_high_order_are_unstable(study: Path) -> None:
    for number, name in enumerate(("first", "second", "third")):
        file = study.parent / f"{name}.csv"
        trace = formats.read(file).trace
        noisy = {**trace.signals, "y": trace["y"] + 1e-3 * white(1200, seed=9 + number)[:, 0]}
        formats.write(Trace(trace.time, noisy, trace.units, name), file)
    assert calibrated(study, "preparation: {compensation: 0.01}\n")["models"]


@pytest.mark.slow
def test_a_reduced_model_has_the_order_that_was_asked_for(study: Path) -> None:
    document = calibrated(study, "reduce: {order: 3, by: mrm, update: input}\n")
    assert document["models"]["reduced"]["order"] <= 3  # type: ignore[index]
    assert document["method"] == "subspace (reduced)"


def test_summary_and_report_are_in_the_folder(study: Path) -> None:
    calibrated(study)
    folder = study.parent / "out"
    assert set(json.loads((folder / "summary.json").read_text())["models"]) == {"orse", "n4sid"}
    assert "Stabilisation diagram" in (folder / "report.html").read_text()


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        ("take: refined\n", "`take` is one of orse, n4sid"),
        ("preparation: {zero_mean: [w]}\n", "w is no output"),
        ("reduce: {order: 3, by: mrmc}\n", "belong to `by: mrmc`"),
        ("name: 2 plants\n", "letters, digits and underscores"),
    ],
)
def test_studies_that_do_not_fit_together_are_refused(study: Path, more: str, problem: str) -> None:
    study.write_text(STUDY + more)
    with pytest.raises(ScenarioError, match=problem):
        load_study(study)


@pytest.mark.parametrize("rule", ["{}", "{threshold: 0.1, gap: [1, 4]}", "{gap: [5, 2]}"])
def test_an_order_needs_one_rule(study: Path, rule: str) -> None:
    study.write_text(STUDY.replace("{best: [3, 7]}", rule))
    with pytest.raises(ScenarioError):
        load_study(study)


def test_a_result_is_judged_on_recordings_that_it_has_not_seen(study: Path) -> None:
    """The same free runs of the model in the FMU; those of the fitted recordings count apart."""
    document = calibrated(study)
    judged = validate_result(study.parent / "out", study.parent, study.parent / "judged", silent)
    found, told = judged["fit"], document["fit"]
    assert found["unseen"]["median"] == pytest.approx(told["validation"]["median"], abs=1e-6)  # type: ignore[index]
    assert found["fitted"]["median"] == pytest.approx(told["train"]["median"], abs=1e-6)  # type: ignore[index]
    assert judged["held"] and (study.parent / "judged" / "report.html").is_file()


def test_a_result_tells_its_models_and_which_was_written(study: Path) -> None:
    document = calibrated(study)
    told = about(study.parent / "out")
    assert {one["name"]: one["order"] for one in told["models"]} == {  # type: ignore[attr-defined]
        name: model["order"]
        for name, model in document["models"].items()  # type: ignore[attr-defined]
    }
    assert told["written"] == document["written"]


@pytest.mark.slow
def test_what_is_excluded_is_a_gap_whose_sides_still_give_the_plant(study: Path) -> None:
    """Two hundred samples of the first record are someone else's; the states after them are not those of a rest."""
    first = formats.read(study.parent / "first.csv").trace
    spoilt = {name: np.where(np.abs(first.time - 500 * STEP) < 100 * STEP, 3.0, first[name]) for name in ("y", "z")}
    formats.write(Trace(first.time, {**first.signals, **spoilt}, first.units), study.parent / "first.csv")
    wrong = calibrated(study)
    left_out = f"exclude: [{{trace: first, from: {400 * STEP}, to: {600 * STEP}}}]"
    study.write_text(STUDY.replace("[third]", f"[third], {left_out}"))
    found = calibrate_study(study, study.parent, study.parent / "out", silent)
    assert wrong["fit"]["validation"]["median"] < 0.99  # type: ignore[index]
    assert found["fit"]["validation"]["median"] > 0.9999  # type: ignore[index]
    assert set(found["fit"]["train"]["traces"]) == {"first", "second"} and found["fit"]["train"]["windows"] == 3
    (marked,) = [trace for trace in found["data"] if "marks" in trace]
    assert marked["trace"] == "first" and marked["left_out"] == pytest.approx(202 * STEP)


def test_a_record_of_which_nothing_is_left_is_refused(study: Path) -> None:
    study.write_text(STUDY.replace("[third]", "[third], exclude: [{trace: third, from: 0}]"))
    with pytest.raises(TraceError, match=r"third\.csv: 60 samples in a row are not left beside excluded from"):
        calibrate_study(study, study.parent, study.parent / "out", silent)


def noisy(study: Path) -> None:
    """The recordings with noise, all in volts."""
    noise = np.random.default_rng(7)
    for name in ("first", "second", "third"):
        raw = formats.read(study.parent / f"{name}.csv").trace
        added = {key: (key != "u") * 0.05 * np.std(y) * noise.standard_normal(len(y)) for key, y in raw.signals.items()}
        signals = {key: y + added[key] for key, y in raw.signals.items()}
        formats.write(Trace(raw.time, signals, dict.fromkeys(signals, "V"), name), study.parent / f"{name}.csv")


@pytest.mark.slow
def test_draws_of_a_refined_model_have_the_spread_of_its_modes(study: Path) -> None:
    """Over draws frequency and damping have the standard deviations of the first order, which are found otherwise."""
    noisy(study)
    document = calibrated(study, "refine: true\ntake: refined\n")
    plant = CalibratedPlant(study.parent / "out")
    assert plant.uncertain
    model = plant.linear("plant", STEP).model
    drawn = [modes(one) for one in plant.drawn("plant", STEP, 400, np.random.default_rng(0))]
    for number, mode in enumerate(document["models"]["refined"]["modes"][:2]):  # type: ignore[index]
        frequency, damping = (np.array([getattr(m[number], key) for m in drawn]) for key in ("frequency", "damping"))
        assert modes(model)[number].frequency == pytest.approx(mode["frequency"])
        assert frequency.std() == pytest.approx(mode["frequency_std"], rel=0.15)
        assert damping.std() == pytest.approx(mode["damping_std"], rel=0.15)


@pytest.mark.slow
def test_a_controller_is_tuned_for_draws_of_an_identified_model(study: Path) -> None:
    noisy(study)
    study.write_text(STUDY.replace("{best: [3, 7]}", "5") + "refine: true\ntake: refined\n")
    calibrate_study(study, study.parent, study.parent / "out", silent)
    tuning = {
        "title": "PI for what was identified",
        "method": "tune",
        "controller": {"model": "pi", "parameters": {"sample_time": STEP, "ki": 0}},
        "plants": {"identified": {"calibrated": "out"}},
        "connections": ["plant.y -> controller.position", "controller.voltage -> plant.u"],
        "reference": "controller.reference",
        "tracked": "plant.y",
        "goals": [{"measure": "modulus margin", "at_least": 0.5}],
        "minimise": [{"measure": "iae"}],
        "delay": STEP,
        "draws": {"count": 50, "share": 0.9},
        "design": {"unknowns": {"kp": {"start": 0.01, "min": 0.001, "max": 10}}},
    }
    (study.parent / "tuning.yaml").write_text(json.dumps(tuning))
    found: Any = tune(study.parent / "tuning.yaml").summary
    assert found["draws"]["held"] >= 0.9
    least, *_, most = found["draws"]["unseen"]["goals"][0]["percentiles"]
    assert least < found["goals"][0]["figures"]["identified"] < most


@pytest.mark.slow
@pytest.mark.parametrize("more", ["", "refine: true\ntake: reduced\nreduce: {order: 4, by: msv, update: output}\n"])
def test_a_model_that_is_not_refined_last_has_no_draws(study: Path, more: str) -> None:
    calibrated(study, more)
    assert not CalibratedPlant(study.parent / "out").uncertain


def test_a_spread_of_another_model_is_refused(study: Path) -> None:
    calibrated(study)
    file = study.parent / "out" / "summary.json"
    summary = json.loads(file.read_text())
    for changes, problem in (
        ([{name: [[1.0]] for name in "abcd"}], "of another model than its FMU's"),
        ([{"a": [[1.0]]}], "that are none"),
        ({"a": 1}, "that are no list"),
    ):
        file.write_text(json.dumps(summary | {"changes": changes}))
        with pytest.raises(IdentificationError, match=problem):
            CalibratedPlant(file.parent).drawn("plant", STEP, 2, np.random.default_rng(0))


def rewritten(file: Path, rows: slice = slice(None), **signals: Any) -> None:
    """The recording with other signals, or of every so manieth row."""
    trace = formats.read(file).trace
    columns = {name: values[rows] for name, values in {**trace.signals, **signals}.items()}
    formats.write(Trace(trace.time[rows], columns, trace.units, trace.name), file)


@pytest.mark.parametrize("name", ["second", "third"])
def test_recordings_at_different_rates_are_refused_fitted_ones_and_those_kept_aside(study: Path, name: str) -> None:
    rewritten(study.parent / f"{name}.csv", slice(None, None, 2))
    said = rf"{name}: is sampled every {2 * STEP:g} s, first every {STEP:g} s; give `sample: {STEP:g}`"
    with pytest.raises(IdentificationError, match=said):
        calibrated(study)


def test_an_input_that_never_moves_is_named_and_not_the_outputs(study: Path) -> None:
    for name in ("first", "second"):
        rewritten(study.parent / f"{name}.csv", u=np.zeros(1200))
    with pytest.raises(IdentificationError, match=r"first\.u: never moves"):
        calibrated(study)


@pytest.mark.parametrize("more", ["outputs: [y, y]", "outputs: [u, z]"])
def test_a_signal_that_is_named_twice_is_refused_with_its_line(study: Path, more: str) -> None:
    study.write_text(STUDY.replace("outputs: [y, z]", more))
    with pytest.raises(ScenarioError, match=r"`inputs` and `outputs`: [uy] is named twice; name each signal once"):
        load_study(study)


@pytest.mark.slow
def test_samples_without_a_value_are_told_and_other_rates_are_not_judged(study: Path) -> None:
    y = formats.read(study.parent / "second.csv").trace["y"].copy()
    y[500:550] = np.nan
    rewritten(study.parent / "second.csv", y=y)
    told = "second: 50 samples have no value of y and are left out"
    assert any(warning.startswith(told) for warning in calibrated(study)["warnings"])  # type: ignore[attr-defined]
    rewritten(study.parent / "third.csv", slice(None, None, 2))
    with pytest.raises(
        IdentificationError, match=f"third: is sampled every {2 * STEP:g} s, the model every {STEP:g} s"
    ):
        validate_result(study.parent / "out", study.parent / "third.csv", study.parent / "judged", silent)
