"""Parameters with a value of their own in each group of recordings, on systems of real FMUs with known truth."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from fmus.errors import ScenarioError
from fmus.packaging import archive, defaults
from identification.calibrate import calibrate, calibrate_study
from identification.estimation.arrow_least_squares import Point
from identification.estimation.groups import Grouped, Grouping, parted
from identification.estimation.parameters import InitialState, Parameter, ParameterSet, Tie
from identification.output_error.search.estimator import estimate
from identification.output_error.search.free_run import known_before
from identification.output_error.search.options import SearchOptions
from identification.output_error.search.problem import Problem, Window
from identification.study import load_study
from identification.validation import validate_result
from orchestrator import formats
from orchestrator.progress import silent
from orchestrator.trace import FloatArray, Trace
from tests.support.identification.small_study import COUNT, NOISE, STEP, TRUTH, simulated, study, voltage, write_study
from tests.support.ssv import read_values

pytestmark = pytest.mark.usefixtures("in_this_process")

Document = dict[str, Any]
FRICTION = "hand.viscous_friction"
WARM, COLD = 0.0015, 0.004
NAMES = {"w0": WARM, "w1": WARM, "c0": COLD, "c1": COLD}
GROUPS = {"warm": ["w0.csv", "w1"], "cold": ["c0", "c1.csv"]}
KNOWN = {name: {"start": value, "fixed": True} for name, value in TRUTH.items() if name != FRICTION}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("recordings"))


@cache
def clean(name: str) -> FloatArray:
    """(K,) angle without noise [rad]."""
    return simulated(voltage(list(NAMES).index(name)), 0.0, {**TRUTH, FRICTION: NAMES[name]})


def record(folder: Path, seed: int = 0) -> Path:
    """The folder, filled with recordings at two temperatures."""
    for number, name in enumerate(NAMES):
        angle = clean(name) + np.random.default_rng([6, seed, number]).normal(0, NOISE, COUNT)
        signals = {"voltage": voltage(number), "angle": angle}
        formats.write(Trace(np.arange(COUNT) * STEP, signals, {"voltage": "V", "angle": "rad"}), folder / f"{name}.csv")
    return folder


def written(folder: Path, by: Any, hold_out: list[str], **changes: Any) -> Path:
    entry = {"start": 0.002, "min": 0.0, "max": 0.05, "by": by}
    kept = {
        "traces": {"files": "*.csv", "hold_out": hold_out},
        "parameters": {**KNOWN, FRICTION: {key: value for key, value in entry.items() if value is not None}},
        "truth": {},
        "validation": {"length": 1},
    }
    return write_study(folder / "study.yaml", **{**kept, **changes})


def calibrated(folder: Path, data: Path, by: Any, hold_out: list[str], **changes: Any) -> Document:
    calibrate_study(written(folder, by, hold_out, **changes), data, folder / "out", silent)
    document: Document = json.loads((folder / "out" / "summary.json").read_text())
    return document


def all_free() -> Document:
    """The parameters of a study that estimates the others, too, but for the gravity that no mass tells."""
    free = {**study()["parameters"], FRICTION: {"start": 0.002, "min": 0.0, "max": 0.05, "by": GROUPS}}
    return {**free, "hand.gravity_torque": KNOWN["hand.gravity_torque"]}


def test_each_group_has_its_value_with_an_interval(data: Path, tmp_path: Path) -> None:
    document = calibrated(tmp_path, data, None, ["w1", "c1"], parameters=all_free())
    for group, truth in {"warm": WARM, "cold": COLD}.items():
        entry = document["parameters"][f"{FRICTION}@{group}"]
        low, high = entry["ci95"]
        assert low < entry["value"] < high and high - low < 0.1 * truth
        assert abs(entry["value"] - truth) < 4 * entry["std"]
        assert (entry["of"], entry["unit"]) == (FRICTION, "N.m.s/rad")
    assert FRICTION not in document["parameters"]
    assert document["fit"]["validation"]["median"] > 0.99


@pytest.mark.slow
def test_intervals_of_groups_hold_the_truth_as_often_as_they_say(tmp_path: Path) -> None:
    draws, inside = 40, 0
    file = written(tmp_path / "study", None, ["w1", "c1"], parameters=all_free())
    for seed in range(draws):
        found = calibrate(file, record(tmp_path, seed)).parameters
        ends = {truth: found[f"{FRICTION}@{group}"]["ci95"] for group, truth in {"warm": WARM, "cold": COLD}.items()}
        inside += sum(low <= truth <= high for truth, (low, high) in ends.items())  # type: ignore[misc, operator]
    assert inside >= stats.binom.ppf(1e-3, 2 * draws, 0.95)


def test_where_nothing_is_shared_the_values_are_those_of_each_group_alone(data: Path, tmp_path: Path) -> None:
    both = calibrated(tmp_path, data, GROUPS, [])["parameters"]
    for group, files in {"warm": "w*.csv", "cold": "c*.csv"}.items():
        alone = calibrated(tmp_path / group, data, None, [], traces={"files": files})["parameters"]
        assert both[f"{FRICTION}@{group}"]["value"] == pytest.approx(alone[FRICTION]["value"], rel=1e-4)


def test_a_set_for_each_group_is_written_and_which_one_the_fmus_have_is_said(data: Path, tmp_path: Path) -> None:
    document = calibrated(tmp_path, data, GROUPS, ["w1"])
    values = {group: document["parameters"][f"{FRICTION}@{group}"]["value"] for group in GROUPS}
    out = tmp_path / "out"
    for group in GROUPS:
        assert read_values(out / "groups" / f"{group}.ssv") == {FRICTION: values[group]}
    assert read_values(out / "parameters.ssv")[FRICTION] == values["warm"]
    held = defaults.load(archive.read(out / "fmus" / "hand.fmu")[defaults.RESOURCE].decode())
    assert held["viscous_friction"] == values["warm"]
    [said] = [warning for warning in document["warnings"] if FRICTION in warning]
    assert said.startswith(f"{FRICTION} has a value for each of warm, cold: FMUs and parameters.ssv have that of warm")


def test_a_validation_gives_each_recording_the_value_of_its_group(data: Path, tmp_path: Path) -> None:
    document = calibrated(tmp_path, data, GROUPS, ["w1", "c1"])
    found = validate_result(tmp_path / "out", data, tmp_path / "validation", silent)
    assert found["fit"]["unseen"]["traces"] == pytest.approx(document["fit"]["validation"]["traces"], abs=1e-6)


def test_by_trace_each_recording_has_a_value_and_others_have_the_mean_which_is_said(data: Path, tmp_path: Path) -> None:
    document = calibrated(tmp_path, data, "trace", ["c1"])
    assert set(document["parameters"]) == {*KNOWN, *(f"{FRICTION}@{name}" for name in ("w0", "w1", "c0"))}
    mean = np.mean([document["parameters"][f"{FRICTION}@{name}"]["value"] for name in ("w0", "w1", "c0")])
    compared = calibrated(tmp_path / "same", data, "trace", ["c1"], compare={"mean": {FRICTION: float(mean)}})["fit"]
    assert compared["compared"]["mean"]["median"] == pytest.approx(document["fit"]["validation"]["median"], abs=1e-9)
    assert any("in no group have the mean of all in the judgement: c1" in one for one in document["warnings"])


def test_what_is_tied_goes_with_each_group(data: Path, tmp_path: Path) -> None:
    parameters = {
        **KNOWN,
        FRICTION: {"start": 0.002, "min": 0.0, "max": 0.05, "by": GROUPS},
        "hand.coulomb_friction_positive": {"tied": FRICTION, "factor": 0.0},
    }
    found = calibrated(tmp_path, data, None, [], parameters=parameters)["parameters"]
    assert found["hand.coulomb_friction_positive@cold"]["value"] == 0.0
    assert found["hand.coulomb_friction_positive@cold"]["of"] == "hand.coulomb_friction_positive"


def test_a_clock_that_is_off_by_recording_is_found(data: Path, tmp_path: Path) -> None:
    """Of the recordings of one group the angle is written 20 ms late."""
    late = tmp_path / "late"
    late.mkdir()
    for name in NAMES:
        trace = formats.read(data / f"{name}.csv").trace
        angle = trace["angle"]
        if name in ("c0", "c1"):
            angle = np.concatenate([np.zeros(2), angle[:-2]])
        formats.write(
            Trace(trace.time, {"voltage": trace["voltage"], "angle": angle}, trace.units), late / f"{name}.csv"
        )
    parameters = {
        **KNOWN,
        FRICTION: {"start": 0.002, "min": 0.0, "max": 0.05, "by": GROUPS},
        "lag": {"start": 0.005, "min": 0.0, "max": 0.05, "by": GROUPS},
    }
    outputs = {"hand.angle": {"signal": "angle", "delay": "lag"}}
    found = calibrated(tmp_path, late, None, ["w1", "c1"], parameters=parameters, outputs=outputs)["parameters"]
    assert found["lag@warm"]["value"] == pytest.approx(0.0, abs=1e-3)
    assert found["lag@cold"]["value"] == pytest.approx(0.02, abs=1e-3)
    assert found["lag@cold"]["unit"] == "s"


@pytest.mark.parametrize(
    ("by", "said"),
    [
        (
            {"warm": ["w0", "w1"], "cold": ["c0", "c7"]},
            r"by\.cold: there is no recording 'c7'; there are c0, c1, w0, w1",
        ),
        ({"warm": ["w0", "w1"]}, r"by: recording c0 is in no group; add it to one of warm"),
        ({"warm": ["w0", "c0"], "cold": ["c0"]}, r"by\.cold: c0 is in warm, too"),
        ({"warm": ["w0", "c0"], "cold": ["c1"]}, r"by\.cold: holds no recording that is fitted"),
    ],
)
def test_groups_that_are_not_those_of_the_recordings_are_refused(
    data: Path, tmp_path: Path, by: Document, said: str
) -> None:
    with pytest.raises(ScenarioError, match=rf"parameters\.{FRICTION}\.{said}"):
        calibrated(tmp_path, data, by, ["w1", "c1"])


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ({"start": 1.0, "fixed": True, "by": "trace"}, "`by` is of a free parameter"),
        ({"start": 1.0, "min": 0, "around": {"std": 1.0}}, "`around` is of values that `by` tells apart"),
        ({"start": 1.0, "min": 0, "by": {"../warm": ["w0"]}}, "should match pattern"),
    ],
)
def test_entries_that_mean_nothing_are_refused_at_their_line(tmp_path: Path, entry: Document, said: str) -> None:
    file = write_study(tmp_path / "study.yaml", parameters={FRICTION: entry})
    with pytest.raises(ScenarioError, match=rf"study\.yaml:\d+: .*{said}"):
        load_study(file)


TIME = np.linspace(0.1, 1.0, 30)


class Lines:
    """y = slope * t, with the slope of each window."""

    def simulate(self, window: int, values: dict[str, float]) -> FloatArray:
        assert set(values) == {"line.slope"}
        return values["line.slope"] * TIME[:, None]

    def close(self) -> None: ...


def lines(around: float | None) -> tuple[Problem, FloatArray]:
    """Three recordings of lines whose slopes differ, and what is measured of each (3, K)."""
    rng = np.random.default_rng(4)
    measured = np.array([1.0, 1.4, 2.1])[:, None] * TIME + rng.normal(0, 0.2, (3, len(TIME)))
    windows = tuple(Window(name, name, one[:, None], np.ones(1)) for name, one in zip("abc", measured, strict=True))
    alone = ParameterSet((Parameter("line.slope", 1.0),))
    parameters, grouped = parted(alone, {"line.slope": Grouping(None, around)}, list("abc"), {})
    return Problem(parameters, windows, ("y",), grouped=grouped), measured


@pytest.mark.parametrize("around", [0.02, 0.3, 5.0])
def test_values_about_a_common_mean_are_those_of_the_penalised_least_squares(around: float) -> None:
    """Against least squares with rows for the spread about the mean, by the noise that is left over without them."""
    problem, measured = lines(around)
    found = estimate(problem, Lines, SearchOptions(cost_tolerance=1e-12, step_tolerance=1e-10))
    values = np.array([found.values[f"line.slope@{name}"] for name in "abc"])
    apart = measured @ TIME / (TIME @ TIME)
    noise = np.sqrt(np.sum((measured - apart[:, None] * TIME) ** 2) / (measured.size - 3))
    centring = (np.eye(3) - 1 / 3) * noise / around
    rows = np.vstack([np.kron(np.eye(3), TIME[:, None]), centring])
    expected = np.linalg.lstsq(rows, np.concatenate([measured.ravel(), np.zeros(3)]))[0]
    assert values == pytest.approx(expected, rel=1e-4)


def test_rows_of_a_common_mean_have_the_derivatives_that_differences_show() -> None:
    problem, _ = lines(0.3)
    at, step = np.array([0.1, -0.2, 0.4]), 1e-6
    block = known_before(problem, Point(at, np.zeros((3, 0))), 0.7)
    for column in range(3):
        moved = at + step * np.eye(3)[column]
        slope = (known_before(problem, Point(moved, np.zeros((3, 0))), 0.7).residual - block.residual) / step
        assert block.parameters[:, column] == pytest.approx(slope, abs=1e-6)


def test_a_recording_moves_with_the_value_of_its_group_or_with_the_mean_where_it_has_none() -> None:
    grouped = Grouped("m.k", {"warm": "m.k@warm", "cold": "m.k@cold"}, {"w0": "warm"})
    moved = {"m.k@cold": 3.0}
    assert [grouped.slopes(trace, moved) for trace in ("w0", "x0")] == [0.0, 1.5]


def test_a_group_that_few_windows_have_is_not_taken_for_silent() -> None:
    """Where starts are tried on a few windows only, each group is among them."""
    names = [f"w{number}" for number in range(30)]
    windows = tuple(Window(name, name, (TIME * 2.0)[:, None], np.ones(1)) for name in names)
    alone = ParameterSet((Parameter("line.slope", 1.0),), (Tie("line.other", "line.slope"),))
    groups = {"many": tuple(names[:-1]), "few": (names[-1],)}
    parameters, grouped = parted(ParameterSet(alone.parameters), {"line.slope": Grouping(groups)}, names, {})
    problem = Problem(parameters, windows, ("y",), (InitialState("s", (0.0,) * 30),)[:0], grouped=grouped)
    assert 29 in problem.with_all_groups((0, 5, 10))
    found = estimate(problem, Lines)
    assert found.converged and found.values["line.slope@few"] == pytest.approx(2.0)
