"""State feedback from an observer, as the thesis has it: gains by weights, kp from a steady state, ki by a search."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from fmus.errors import InputError
from identification.calibrate import study_without_data
from identification.tuning.summary import TuningSummary
from orchestrator.info import about
from orchestrator.progress import silent
from orchestrator.trace import FloatArray
from tests.support.identification.tuning_study import STEP, lagging, study, write

SHIPPED = Path(__file__).parents[4] / "scenarios" / "flexible_arm" / "control" / "tuning"
DESIGN: dict[str, Any] = {
    "by": "state-feedback",
    "weights": {"Q": {"position": 1}, "R": 0.5},
    "observer": {"Q": {"u": 1}, "R": 0.01},
}
SENSORS = {"position": 1.0, "base_strain": 0.1, "middle_strain": -0.2, "speed": 0.4}


def feedback(**changes: Any) -> dict[str, Any]:
    """A study of the position alone."""
    parts: dict[str, Any] = {
        "controller": {"model": "ilqr", "parameters": {"sample_time": STEP, "ki": 0}},
        "goals": None,
        "design": DESIGN,
    }
    return study(**parts | changes)


def sensed() -> dict[str, Any]:
    """The plant with four sensors, of which the last shows the speed."""
    given = lagging(2.0)
    rows = [[share, 0.3 * share] for share in SENSORS.values()]
    return {**given, "C": rows, "outputs": dict.fromkeys(SENSORS, "V")}


def tuned(folder: Path, **changes: Any) -> TuningSummary:
    return study_without_data("tune", write(folder, feedback(**changes)), folder / "out", silent)  # type: ignore[return-value]


def array(found: TuningSummary, name: str) -> FloatArray:
    """A matrix of the controller, as the summary has it."""
    values = {
        key.partition("[")[2]: entry["value"]
        for key, entry in found["parameters"].items()
        if key.startswith(f"controller.{name}[")
    }
    places = [tuple(int(n) - 1 for n in key.rstrip("]").split(",")) for key in values]
    matrix = np.zeros(tuple(n + 1 for n in max(places)))
    for place, value in zip(places, values.values(), strict=True):
        matrix[place] = value
    return matrix


def plant(gain: float = 2.0) -> tuple[FloatArray, FloatArray, FloatArray]:
    given = lagging(gain)
    a, b, c = (np.array(given[name]) for name in "ABC")
    return a, b, c


def gains(a: FloatArray, b: FloatArray, q: FloatArray, r: FloatArray) -> FloatArray:
    p = solve_discrete_are(a, b, q, r)
    return np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)


@pytest.mark.slow
def test_the_gains_are_scipys_and_stand_in_the_fmu_with_the_model(tmp_path: Path) -> None:
    found = tuned(tmp_path)
    a, b, c = plant()
    k, gain = gains(a, b, c.T @ c, np.array([[0.5]])), gains(a.T, c.T, b @ b.T, np.array([[0.01]])).T
    for name, matrix in {"A": a, "B": b, "C": c, "K": k, "L": gain}.items():
        assert array(found, name) == pytest.approx(matrix, rel=1e-9)
    start = {port["name"]: port["start"] for port in about(tmp_path / "out/fmus/controller.fmu")["parameters"]}
    assert float(start["K[1,2]"]) == found["parameters"]["controller.K[1,2]"]["value"] == pytest.approx(k[0, 1])
    assert float(start["kp"]) == found["parameters"]["controller.kp"]["value"]


@pytest.mark.slow
def test_kp_of_a_run_of_the_fmus_is_that_of_the_closed_form(tmp_path: Path) -> None:
    """An integrating plant stands still without a command, so that kp is what the feedback takes of the position."""
    found = tuned(tmp_path)
    position = np.array([1.0, 0.0])
    closed = float((array(found, "K") @ position)[0])
    assert found["parameters"]["controller.kp"]["value"] == pytest.approx(closed, rel=1e-9)
    assert found["design"]["kp in closed form"] == pytest.approx(closed, rel=1e-9)
    assert found["design"]["kp measured in a run"] == pytest.approx(closed, rel=1e-8)
    assert found["design"]["kp measured in a run"] != found["design"]["kp in closed form"]


@pytest.mark.slow
def test_all_four_sensors_are_weighed_as_scipys_filter_does(tmp_path: Path) -> None:
    links = [f"plant.{name} -> controller.{name}" for name in SENSORS]
    noise = {"position": 0.01, "base_strain": 0.1, "middle_strain": 0.1, "speed": 1}
    found = tuned(
        tmp_path,
        controller={"model": "lqg", "parameters": {"sample_time": STEP}},
        plants={"arm": {"matrices": sensed()}},
        connections=[*links, "controller.voltage -> plant.u"],
        design={**DESIGN, "observer": {"Q": {"u": 1}, "R": noise}},
    )
    a, b, _ = plant()
    c = np.array(sensed()["C"])
    assert array(found, "C") == pytest.approx(c)
    assert array(found, "L") == pytest.approx(gains(a.T, c.T, b @ b.T, np.diag(list(noise.values()))).T, rel=1e-9)
    assert found["loops"]["arm"]["stable"]
    poles = np.sort_complex(np.array([complex(*pole) for pole in found["loops"]["arm"]["poles"]]))
    parts = [a - b @ array(found, "K"), a - array(found, "L") @ c]
    known = np.sort_complex(np.concatenate([np.linalg.eigvals(part) for part in parts]))
    assert poles == pytest.approx(known, rel=1e-6)


@pytest.mark.slow
def test_ki_is_where_the_answer_to_a_disturbance_is_best(tmp_path: Path) -> None:
    best = [{"measure": "itae", "of": "plant.position", "disturbed": "plant.u"}]
    design = {**DESIGN, "ki": {"min": 0.01, "max": 5, "start": 0.1}}
    found = tuned(tmp_path, minimise=best, design=design)
    at = found["parameters"]["controller.ki"]["value"]
    assert 0.02 < at < 4.9
    assert found["design"]["ki a sample"] == pytest.approx(at * STEP)
    for beside in (0.97 * at, 1.03 * at):
        fixed = {"model": "ilqr", "parameters": {"sample_time": STEP, "ki": beside}}
        other = tuned(tmp_path, minimise=best, controller=fixed)
        assert other["objective"] > found["objective"]  # type: ignore[operator]


@pytest.mark.slow
def test_a_delay_is_part_of_the_model_that_is_fed_back(tmp_path: Path) -> None:
    found = tuned(tmp_path, delay=1.5 * STEP)
    assert array(found, "A").shape == (4, 4)
    whole = np.zeros((3, 3))
    whole[:2, :2], whole[1, 2] = [[0, 1], [0, -10]], 20
    late = expm(whole * STEP / 2)[:2, 2]  # of a command that acts over the second half of a period
    assert array(found, "A")[:2, 2] == pytest.approx(late, rel=1e-6)
    assert found["loops"]["light"]["stable"]
    assert found["design"]["kp measured in a run"] == pytest.approx(found["design"]["kp in closed form"], rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("faster", [2, 5])
def test_an_observer_fades_as_much_faster_as_is_asked(faster: float, tmp_path: Path) -> None:
    found = tuned(tmp_path, design={**DESIGN, "observer": {"Q": 1, "R": 1e4, "faster": faster}})
    a, b, c = plant()
    slow = np.abs(np.linalg.eigvals(a - b @ array(found, "K"))).max()
    fast = np.abs(np.linalg.eigvals(a - array(found, "L") @ c)).max()
    assert fast <= slow**faster * (1 + 1e-9)
    assert found["design"]["rate of the observer over that of the feedback"] == pytest.approx(
        np.log(fast) / np.log(slow)
    )
    assert found["warnings"] == []


def test_a_slow_observer_is_told(tmp_path: Path) -> None:
    found = tuned(tmp_path, design={**DESIGN, "observer": {"Q": {"u": 1}, "R": 1e4}})
    assert "as fast as the state feedback" in found["warnings"][0]


def unseen() -> dict[str, Any]:
    """A plant with a mode that fades and that the position does not show."""
    given = lagging(2.0)
    a = np.zeros((3, 3))
    a[:2, :2], a[2, 2] = given["A"], 0.5
    return {**given, "A": a.tolist(), "B": [*given["B"], [1.0]], "C": [[1.0, 0.0, 0.0]]}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"plants": {"light": {"matrices": unseen()}}}, r"plants\.light: has the pole 0\.5.*is not seen; reduce"),
        (
            {"plants": {"light": {"matrices": {**unseen(), "B": [*lagging(2.0)["B"], [0.0]]}}}},
            r"plants\.light: has the pole 0\.5.*not reached by the command; reduce",
        ),
        (
            {"plants": {"light": {"matrices": {**lagging(2.0), "C": [[0.0, 1.0]]}}}},
            r"plants\.light: has the pole 1.*is not seen in what is measured; measure",
        ),
        (
            {"design": {**DESIGN, "weights": {"Q": [1, -0.1]}}},
            r"design\.weights\.Q: is not positive semidefinite.*-0\.1; give weights",
        ),
        ({"design": {**DESIGN, "weights": {"Q": [[1, 2], [2, 1]]}}}, r"Q: is not positive semidefinite.*-1; give"),
        ({"design": {**DESIGN, "weights": {"Q": [[1, 2], [0, 1]]}}}, r"Q: is not symmetric; give"),
        ({"design": {**DESIGN, "weights": {"Q": [1, 1, 1]}}}, r"Q: is 3, and there are 2 to be weighted; give"),
        ({"design": {**DESIGN, "weights": {"Q": {"speed": 1}}}}, r"Q\.speed: is no signal.*; name position"),
        ({"design": {**DESIGN, "weights": {"R": 0}}}, r"weights\.R: is not positive definite.*; give weights above 0"),
        ({"design": {**DESIGN, "observer": {"R": -1}}}, r"observer\.R: is not positive definite"),
        ({"design": {**DESIGN, "weights": {"Q": [0, 1]}}}, r"weights\.Q: has no weights on the mode with the pole 1"),
        ({"design": {**DESIGN, "observer": {"Q": 0}}}, r"observer\.Q: has no noise on the mode with the pole 1"),
        ({"design": {**DESIGN, "plant": "none"}}, r"design\.plant: 'none' is no plant; there are light, heavy"),
        (
            {"controller": {"model": "ilqr", "parameters": {"sample_time": 0.02}}},
            r"plants\.light: is sampled every 0\.01 s, and the controller every 0\.02 s; set",
        ),
        (
            {"controller": {"model": "ilqr", "parameters": {"sample_time": STEP, "A": [[0] * 3] * 3}}},
            r"controller: is for a model of order 3, and the plant of the design is of order 2; leave its arrays",
        ),
        (
            {"controller": {"model": "pi", "parameters": {"sample_time": STEP}}},
            r"controller: has no array A; take a state feedback",
        ),
        (
            {"controller": {"model": "lqg", "parameters": {"sample_time": STEP}}},
            r"connections: takes 4 measurements, and 1 are connected \(position\); connect all",
        ),
    ],
)
def test_what_has_no_gains_is_refused(changes: dict[str, Any], problem: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=problem):
        tuned(tmp_path, **changes)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ilqr", "lqg"])
def test_a_shipped_design_has_both_kp_alike_and_holds_its_goals_and_the_rig(name: str, tmp_path: Path) -> None:
    found: Any = study_without_data("tune", SHIPPED / f"{name}.yaml", tmp_path / "out", silent)
    assert found["feasible"] and found["verdict"]["held"]
    assert found["rigs"][0]["cases"] and found["rigs"][0]["held"]
    design = found["design"]
    assert design["kp measured in a run"] == pytest.approx(design["kp in closed form"], rel=1e-8)
    assert design["rate of the observer over that of the feedback"] >= 2
