"""Experiments that are designed: those of textbooks, within limits, with intervals that come out as predicted."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruamel.yaml import YAML

from fmus.errors import IdentificationError, ScenarioError
from identification import calibrate, design, load_study
from identification.design.criteria import covariance, figure, half_widths, unseen
from identification.design.design import Design, name_of
from identification.design.study import ListedValues, ValueRange
from orchestrator import read, run
from orchestrator.cli.schemas import schema_of
from tests.support.commands import servotwin

ROOT = Path(__file__).parents[3]
LAG = '''"""A first-order lag: T x' = K u - x; what is beyond 2 of the input counts more."""

from . import Model, State, input_, ops, output, parameter

MODEL = Model(
    name="lag",
    description="A first-order lag",
    variables=(
        input_("u", "1", "Input"),
        output("x", "1", "Output"),
        parameter("gain", "1", 1.0, "K"),
        parameter("time_constant", "s", 0.5, "T", minimum=1e-3),
        parameter("beyond", "1", 1.0, "How much more what is beyond 2 counts"),
    ),
    states=(State("x", 0.0),),
    derivatives=lambda t, x, u, p: {
        "x": (p.gain * (u.u + p.beyond * ops.maximum(u.u - 2, 0.0)) - x.x) / p.time_constant
    },
    solver_step=lambda p: 0.2 * p.time_constant,
)
'''


def lagging(folder: Path, families: dict[str, Any], **changes: Any) -> Path:
    """A study of a lag whose gain and time constant are sought from 10 s of its steady state, with known noise."""
    (folder / "lag.py").write_text(LAG)
    yaml = YAML()
    rig = {
        "title": "A lag that is recorded",
        "components": {"drive": {"model": "excitation"}, "lag": {"model": "lag.py"}},
        "connections": ["drive.signal -> lag.u"],
        "run": {"stop": 30, "step": 0.01},
        "recorder": {"signals": {"u": "lag.u", "x": "lag.x"}, "every": 0.01, "jitter": 0, "first": 0.01},
    }
    study = {
        "title": "The lag, calibrated",
        "method": "output-error",
        "components": {"lag": {"model": "lag.py"}},
        "step": 0.01,
        "traces": {"files": "*.csv"},
        "inputs": {"lag.u": {"signal": "u"}},
        "outputs": {"lag.x": {"signal": "x"}},
        "windows": {"length": 30},
        "parameters": {
            "lag.gain": {"min": 0.1, "max": 10, "start": 1},
            "lag.time_constant": {"min": 0.01, "max": 5, "start": 0.5},
        },
    }
    document = {
        "title": "What to drive the lag with",
        "method": "design",
        "calibration": "study.yaml",
        "scenario": "rig.yaml",
        "duration": 30.5,
        "families": families,
        "noise": {"lag.x": 0.01},
        **changes,
    }
    for name, content in {"rig": rig, "study": study, "design": document}.items():
        yaml.dump(content, folder / f"{name}.yaml")
    return folder / "design.yaml"


def sine(**changes: Any) -> dict[str, Any]:
    return {"drive.shape": "sine", "drive.amplitude": 1.0, **changes}


@pytest.mark.slow
def test_the_d_optimal_multisine_of_a_lag_is_the_one_line_that_theory_gives(tmp_path: Path) -> None:
    """det F of a line of given power is x^2 / (1 + x^2)^4 of x = w T, largest at x^2 = 1/3; more lines add nothing."""
    frequency = {"min": 0.02, "max": 5.0}
    multisine = {"drive.shape": "multisine", "drive.amplitude": 1.0, "drive.frequency": frequency}
    search = {"candidates": 40, "rounds": 6, "neighbours": 8}
    one, more = (
        design(lagging(tmp_path, {"multisine": multisine | {"drive.lines": lines}}, search=search)).result
        for lines in (1, [2, 3, 4])
    )
    [experiment] = one.experiments.values()
    assert experiment.tried.values["drive.frequency"] == pytest.approx(1 / (2 * math.pi * 0.5 * math.sqrt(3)), rel=0.05)
    assert one.found.figures[-1] < 1.02 * more.found.figures[-1]  # periods that the recording's end cuts are worth that
    assert one.found.figures == sorted(one.found.figures, reverse=True)


def in_windows(folder: Path, length: float, **changes: Any) -> Path:
    """The same study, its calibration in windows that all begin at rest, under a sine of as many periods."""
    steady = {"sine": sine(**{"drive.frequency": 2 / length})}
    file = lagging(folder, steady, search={"candidates": 1, "rounds": 0}, **changes)
    yaml = YAML()
    study = yaml.load(folder / "study.yaml")
    study["windows"] = {"length": length}
    yaml.dump(study, folder / "study.yaml")
    return file


@pytest.mark.slow
def test_the_shortest_duration_is_the_one_whose_windows_suffice(tmp_path: Path) -> None:
    """Each window tells as much: half-widths go with one over the root of their number."""
    known: Design = design(in_windows(tmp_path, 2.0, duration=20.5)).result
    [ten] = {float(known.relative(known.after).max())}
    assert known.trials == () and known.reached

    def sought(windows: int, **changes: Any) -> Design:
        target = 1.02 * ten * math.sqrt(10 / windows)
        asked = {"between": ["4.5 s", "36.5 s"], "half_width": target, "within": 2.0, **changes}
        found: Design = design(in_windows(tmp_path, 2.0, duration=asked)).result
        return found

    for windows in (4, 10, 17):
        found = sought(windows)
        assert float(found.study.duration) == 2.0 * windows + 0.5
        assert found.reached and len(found.trials) <= 2 + math.ceil(math.log2(16))
        assert [one.of_target <= 1 for one in found.trials] == [
            float(one.duration) > 2.0 * windows for one in found.trials
        ]
    least = sought(1)
    assert float(least.study.duration) == 4.5 and len(least.trials) == 2
    gain = known.names.index("lag.gain")
    each = sought(10, half_width={"lag.gain": 1.02 * float(known.after[gain])})
    assert float(each.study.duration) == 20.5


@pytest.mark.slow
def test_a_duration_that_no_length_reaches_is_missed_and_short_ones_are_told(tmp_path: Path) -> None:
    file = in_windows(tmp_path, 2.0, duration={"between": [1.0, 5.0], "half_width": "0.001 %"})
    done = servotwin("design", file, "--out", tmp_path / "out")
    assert done.exit_code == 1 and "MISSED: after 5 s a half-width is" in done.stdout
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert not summary["duration"]["reached"] and summary["duration"]["seconds"] == 5
    reached = in_windows(tmp_path, 2.0, duration={"between": [1.0, 5.0], "half_width": "50 %", "within": 1})
    done = servotwin("design", reached, "--out", tmp_path / "out", "--json")
    told = json.loads(done.stdout)["duration"]
    assert done.exit_code == 0 and told["reached"] and told["seconds"] == 3
    assert [(one["duration"], one["of_target"] is None) for one in told["tried"]] == [
        (1.0, True),
        (2.0, True),
        (3.0, False),
        (5.0, False),
    ]
    assert "too short" in told["tried"][0]["problem"]
    assert YAML().load(tmp_path / "out" / "experiments.yaml")["run"]["stop"] == "3"


@pytest.mark.parametrize(
    ("duration", "problem"),
    [
        ({"between": [3, 1], "half_width": 0.1}, "two times above 0"),
        ({"between": [1, 3], "half_width": {}}, "a share above 0"),
        ({"between": [1, 3], "half_width": {"lag.nothing": 1.0}}, "is no parameter of the calibration"),
        ({"between": [1, 3]}, "half_width"),
        (-1, "must be positive"),
    ],
)
def test_durations_that_cannot_be_sought_are_refused(tmp_path: Path, duration: Any, problem: str) -> None:
    with pytest.raises(ScenarioError, match=problem):
        design(in_windows(tmp_path, 2.0, duration=duration))


@pytest.mark.slow
def test_predicted_half_widths_of_a_lag_are_those_of_its_frequency_response(tmp_path: Path) -> None:
    """K samples of a sine with amplitude a: F = K a^2 / (2 s^2) Re(g* g^T), g the response's slopes by ln K, ln T."""
    frequency, samples = 0.2, 3001
    found: Design = design(
        lagging(tmp_path, {"sine": sine(**{"drive.frequency": frequency})}, search={"candidates": 1, "rounds": 0})
    ).result
    x = 2 * math.pi * frequency * 0.5
    response = 1 / (1 + 1j * x)
    slopes = np.array([response, -1j * x * response**2])
    known = samples / (2 * 0.01**2) * np.real(np.outer(slopes.conj(), slopes))
    expected = 1.96 * np.sqrt(np.diag(np.linalg.inv(known))) * np.array([1.0, 0.5])
    assert found.after == pytest.approx(expected, rel=0.03)  # which has a transient of half a second
    assert found.names == ["lag.gain", "lag.time_constant"]


@pytest.mark.slow
def test_what_no_allowed_input_excites_is_refused_with_place_and_fix(tmp_path: Path) -> None:
    file = lagging(tmp_path, {"sine": sine(**{"drive.frequency": [0.1, 0.2]})})
    yaml = YAML()
    study = yaml.load(tmp_path / "study.yaml")
    study["parameters"]["lag.beyond"] = {"min": 0, "max": 5, "start": 1}
    yaml.dump(study, tmp_path / "study.yaml")
    with pytest.raises(
        IdentificationError,
        match=r"parameters\.lag\.beyond: nothing that is allowed shows it .* allow others by `families`",
    ):
        design(file)
    beyond = {"sine": sine(**{"drive.frequency": [0.1, 0.2]})}
    with pytest.raises(IdentificationError, match=r"limits\.lag\.x: is exceeded in all .* allow smaller amplitudes"):
        design(lagging(tmp_path, beyond, limits={"lag.x": {"below": 0.1}}))
    with pytest.raises(IdentificationError, match=r"noise\.lag\.x: the sensors .* add none; give `noise"):
        design(lagging(tmp_path, beyond, noise={}))


@pytest.mark.slow
def test_limits_are_kept_by_smaller_amplitudes_in_the_runs_that_are_written(tmp_path: Path) -> None:
    families = {
        "sine": sine(**{"drive.frequency": {"min": 0.05, "max": 1.0}, "drive.amplitude": {"min": 0.1, "max": 5}})
    }
    file = lagging(
        tmp_path,
        families,
        amplitude="drive.amplitude",
        limits={"lag.x": {"above": -0.6, "below": 0.6}, "lag.u": {"below": 0.9, "above": -0.9}},
        experiments=2,
        search={"candidates": 8, "rounds": 2, "neighbours": 4},
    )
    made = design(file)
    found: Design = made.result
    assert found.found.exceeded
    folder = made.write(tmp_path / "next")
    result = run(folder / "experiments.yaml")
    assert result.passed
    assert [case.name for case in result.cases] == ["design_1", "design_2"]
    for name, case in zip(found.experiments, result.cases, strict=True):
        played = read(folder / f"{name}_playback.csv").trace
        assert case.trace is not None
        assert played["u"] == pytest.approx(case.trace["lag.u"], abs=1e-12)
    assert load_study(folder / "calibration.yaml").block.parameters["lag.gain"].start == 1


@pytest.mark.slow
def test_what_is_known_already_counts(tmp_path: Path) -> None:
    """A calibration of the designed recording, as what is known, makes the next intervals by root two narrower."""
    file = lagging(tmp_path, {"sine": sine(**{"drive.frequency": 0.2})}, search={"candidates": 1, "rounds": 0})
    folder = design(file).write(tmp_path / "next")
    recorded = run(folder / "experiments.yaml").cases[0].trace
    assert recorded is not None
    noise = 0.01 * np.random.default_rng(3).standard_normal(len(recorded))
    rows = np.column_stack([recorded.time, recorded["lag.u"], recorded["lag.x"] + noise])
    (tmp_path / "data").mkdir()
    np.savetxt(tmp_path / "data" / "design_1.csv", rows, delimiter=",", header="time [s],u,x", comments="")
    known = calibrate(folder / "calibration.yaml", tmp_path / "data").write(tmp_path / "known")
    first: Design = design(file).result
    both: Design = design(
        lagging(
            tmp_path,
            {"sine": sine(**{"drive.frequency": 0.2})},
            result=str(known),
            search={"candidates": 1, "rounds": 0},
        )
    ).result
    assert both.before == pytest.approx(first.after, rel=0.1)
    assert both.after == pytest.approx(first.after / math.sqrt(2), rel=0.1)


@pytest.mark.slow
def test_priors_of_the_calibration_are_known_already(tmp_path: Path) -> None:
    """One that is far narrower than what a recording tells stays; one that is far wider does not count."""
    file = lagging(tmp_path, {"sine": sine(**{"drive.frequency": 0.2})}, search={"candidates": 1, "rounds": 0})
    without: Design = design(file).result
    yaml = YAML()
    study = yaml.load(tmp_path / "study.yaml")
    study["parameters"]["lag.gain"]["prior"] = {"mean": 1, "std": 1e-6}
    study["parameters"]["lag.time_constant"]["prior"] = {"mean": 0.5, "std": 1.0}
    yaml.dump(study, tmp_path / "study.yaml")
    found: Design = design(file).result
    assert found.before == pytest.approx([1.96e-6, 1.96], rel=1e-3)
    assert found.after[0] == pytest.approx(1.96e-6, rel=1e-3)
    assert 0.5 * without.after[1] < found.after[1] <= without.after[1]


@pytest.mark.slow
def test_start_values_that_are_read_are_told_to_make_predictions_rough(tmp_path: Path) -> None:
    file = lagging(tmp_path, {"sine": sine(**{"drive.frequency": 0.2})}, search={"candidates": 1, "rounds": 0})
    assert design(file).summary["warnings"] == []
    yaml = YAML()
    study = yaml.load(tmp_path / "study.yaml")
    study["initial"] = {"lag.beyond": {"signal": "x", "half_width": 0.05}}
    yaml.dump(study, tmp_path / "study.yaml")
    [warning] = design(file).summary["warnings"]
    assert "start values are read and not estimated (lag.beyond)" in warning


@pytest.mark.slow
@pytest.mark.shipped
def test_the_shipped_design_keeps_its_word_on_the_rig(tmp_path: Path) -> None:
    """Half-widths come out within 20 % of those predicted, and the limits are kept."""
    made = design(ROOT / "scenarios" / "butterfly" / "design.yaml")
    folder = made.write(tmp_path / "next")
    recorded = servotwin("run", folder / "experiments.yaml", "--out", tmp_path / "recordings")
    assert recorded.exit_code == 0, recorded.output  # all limits are kept
    parameters = calibrate(folder / "calibration.yaml", tmp_path / "recordings").parameters
    found: Design = made.result
    for name, predicted in zip(found.names, found.after, strict=True):
        low, high = parameters[name]["ci95"] or (None, None)
        assert low is not None
        assert high is not None
        assert (high - low) / 2 == pytest.approx(predicted, rel=0.2), name
    assert found.relative(found.compared["sweeps"]).max() > 2 * found.relative(found.after).max()


@pytest.mark.slow
def test_the_command_tells_half_widths_and_writes_what_it_tells_with_json(tmp_path: Path) -> None:
    file = lagging(tmp_path, {"sine": sine(**{"drive.frequency": [0.2]})}, search={"candidates": 1, "rounds": 0})
    told = servotwin("design", file, "--out", tmp_path / "out")
    assert told.exit_code == 0, told.output
    for part in ("half-widths", "lag.time_constant", "design_1: drive.shape sine", "worst half-width, after"):
        assert part in told.output
    answer = servotwin("design", file, "--out", tmp_path / "out", "--json")
    document = json.loads(answer.stdout)
    assert document == json.loads((tmp_path / "out" / "summary.json").read_text())
    assert document["half_widths"]["lag.gain"]["after"] == pytest.approx(
        document["parameters"]["lag.gain"]["std"] * 1.96, rel=1e-3
    )
    refused = servotwin("calibrate", file)
    assert "servotwin design" in refused.output


def test_criteria_are_those_of_the_ellipsoid() -> None:
    axes = np.diag([1.0, 4.0, 0.25])
    turned = np.linalg.qr(np.arange(9.0).reshape(3, 3) + np.eye(3))[0]
    information = turned @ axes @ turned.T
    every = range(3)
    spread = np.linalg.inv(information)
    assert covariance(information) == pytest.approx(spread)
    assert figure(information, "D", every) == pytest.approx(np.linalg.det(spread) ** (1 / 6))
    assert figure(information, "A", every) == pytest.approx(math.sqrt(np.trace(spread) / 3))
    assert figure(information, "E", every) == pytest.approx(2.0)
    assert figure(information, "worst", every) == pytest.approx(math.sqrt(np.diag(spread).max()))
    assert figure(information, "A", [1]) == pytest.approx(math.sqrt(spread[1, 1]))
    assert half_widths(information) == pytest.approx(1.96 * np.sqrt(np.diag(spread)), rel=1e-4)


def test_what_is_not_seen_is_named() -> None:
    assert unseen(np.diag([1.0, 0.0, 2.0])) == 1
    both = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    assert unseen(both) in (0, 1)
    assert covariance(both) is None
    assert figure(both, "D", range(3)) == math.inf


@given(st.floats(0, 1), st.floats(1e-3, 10), st.floats(1.01, 1e4))
def test_a_choice_lies_between_its_ends(share: float, low: float, ratio: float) -> None:
    assert low * (1 - 1e-9) <= ValueRange(low, low * ratio).at(share) <= low * ratio * (1 + 1e-9)
    assert ListedValues((1, 2, 3)).at(share) in (1, 2, 3)


def test_names_tell_values_in_units() -> None:
    assert name_of("{hand.added_mass g}g_design_{number}", 2, {"hand.added_mass": 0.1205}) == "120.5g_design_2"
    with pytest.raises(ScenarioError, match=r"name: {hand\.mass} is no value that differs"):
        name_of("{hand.mass}", 1, {})
    with pytest.raises(ScenarioError, match="no number in a unit that is known"):
        name_of("{hand.mass stones}", 1, {"hand.mass": 1.0})


def test_a_study_that_names_what_is_not_there_is_refused(tmp_path: Path) -> None:
    file = lagging(tmp_path, {"sine": sine()}, parameters=["lag.inertia"])
    with pytest.raises(ScenarioError, match=r"parameters\.lag\.inertia: is no parameter of the calibration"):
        design(file)
    with pytest.raises(ScenarioError, match=r"family sine gives no range of drive\.amplitude"):
        load_study(lagging(tmp_path, {"sine": sine()}, amplitude="drive.amplitude"))


def test_the_schema_has_a_kind_of_its_own() -> None:
    assert schema_of("design")["properties"]["criterion"]["enum"] == ["D", "A", "E", "worst"]
