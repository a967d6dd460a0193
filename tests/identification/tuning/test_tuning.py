"""Studies of tuning: the optimum is the known one, is written back, and what cannot be had is told."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import InputError
from fmus.json_document import json_text
from identification import tune
from identification.calibrate import calibrate_study, study_without_data
from identification.tuning.goals.table import MEASURES
from identification.tuning.summary import TuningSummary
from orchestrator.info import about
from orchestrator.progress import silent
from tests.support.commands import servotwin
from tests.support.identification.tuning_study import STEP, lagging, study, write

SCENARIO = Path(__file__).parents[3] / "scenarios" / "flexible_arm" / "control" / "tuning" / "pdp.yaml"


def tuned(folder: Path, **changes: Any) -> TuningSummary:
    return study_without_data("tune", write(folder, study(**changes)), folder / "out", silent)  # type: ignore[return-value]


def test_a_margin_that_binds_gives_the_gain_of_its_closed_form(tmp_path: Path) -> None:
    """Sampled every T and held, gain k / (s (lag s + 1)) crosses 1 where its phase is -120 degrees."""
    found = tuned(tmp_path)
    gain = found["parameters"]["controller.kp"]["value"]
    assert found["feasible"]
    [margin, _] = found["goals"]
    assert margin["figures"]["light"] == pytest.approx(60, abs=1e-4)
    assert margin["figures"]["heavy"] > 60  # type: ignore[operator]
    assert margin["binding"] == ["light"]
    given = lagging(2.0)
    a, b, c = (np.array(given[name]) for name in "ABC")

    def response(omega: float) -> complex:
        return complex((c @ np.linalg.solve(np.exp(1j * omega * STEP) * np.eye(2) - a, b))[0, 0])

    low, high = 0.1, 100.0
    for _ in range(80):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if np.angle(response(middle)) > -math.pi * 2 / 3 else (low, middle)
    assert gain == pytest.approx(1 / abs(response(low)), rel=1e-5)


def test_the_values_are_in_the_controllers_fmu_and_its_parameter_set(tmp_path: Path) -> None:
    found = tuned(tmp_path)
    [kp] = [port for port in about(tmp_path / "out" / "fmus" / "controller.fmu")["parameters"] if port["name"] == "kp"]
    assert float(kp["start"]) == found["parameters"]["controller.kp"]["value"]
    assert "controller.kp" in (tmp_path / "out" / "parameters.ssv").read_text()
    assert json.loads((tmp_path / "out" / "summary.json").read_text()) == json.loads(json_text(found))
    assert "phase margin at least 60 deg" in (tmp_path / "out" / "report.html").read_text()


def test_starts_that_lead_to_one_optimum_are_counted(tmp_path: Path) -> None:
    design = {"unknowns": {"kp": {"min": 0.01, "max": 20}}, "starts": [{"kp": 0.1}, {"kp": 2}], "more": 1}
    found = tuned(tmp_path, design=design)
    assert len(found["starts"]) == found["agree"] == 3


def test_a_start_from_an_unstable_loop_finds_the_same(tmp_path: Path) -> None:
    design = {"unknowns": {"kp": {"start": 19.9, "min": 0.01, "max": 20}}}
    assert tuned(tmp_path, design=design)["parameters"]["controller.kp"]["value"] == pytest.approx(
        tuned(tmp_path)["parameters"]["controller.kp"]["value"], rel=1e-4
    )


def test_what_cannot_be_had_is_missed_least_and_told(tmp_path: Path) -> None:
    """Fast and with much margin: both are missed by the same share, so that neither could be missed less."""
    goals = [{"measure": "phase margin", "at_least": 80}, {"measure": "decay rate", "at_least": 4}]
    found = tuned(tmp_path, goals=goals, minimise=None)
    assert not found["feasible"]
    margin, rate = found["goals"]
    least_margin, least_rate = (min(goal["figures"].values()) for goal in (margin, rate))  # type: ignore[type-var]
    assert (80 - least_margin) / 80 == pytest.approx((4 - least_rate) / 4, abs=1e-3)  # type: ignore[operator]
    assert margin["binding"] == ["light"]
    assert rate["binding"] == ["heavy"]
    assert "INFEASIBLE" in found["verdict"]["said"]
    assert "phase margin at least 80 deg" in found["verdict"]["said"]


@pytest.mark.slow
def test_the_command_leaves_with_1_where_goals_are_missed(tmp_path: Path) -> None:
    goals = [{"measure": "phase margin", "at_least": 80}, {"measure": "decay rate", "at_least": 4}]
    for document, code in ((study(), 0), (study(goals=goals), 1)):
        done = servotwin("tune", write(tmp_path, document), "--out", tmp_path / "out", "--json")
        assert done.exit_code == code, done.output
        assert json.loads(done.stdout)["feasible"] == (code == 0)


@pytest.mark.slow
def test_a_soft_goal_gives_way_to_a_hard_one(tmp_path: Path) -> None:
    soft = {"measure": "settling time", "at_most": "0.5 s", "soft": True}
    found = tuned(tmp_path, goals=[{"measure": "phase margin", "at_least": 60}, soft], minimise=None)
    assert found["feasible"]
    assert [goal["held"] for goal in found["goals"]] == [True, False]


@pytest.mark.slow
def test_a_delay_takes_its_phase(tmp_path: Path) -> None:
    """A later command asks for a lower gain at the same margin."""
    gains = [tuned(tmp_path, delay=delay)["parameters"]["controller.kp"]["value"] for delay in (0, 0.004, 0.03)]
    assert gains[0] > 1.01 * gains[1] > 1.1 * gains[2]


def test_each_command_sends_the_others_studies_away(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a study of the method 'tune'; give it to `servotwin tune`"):
        calibrate_study(write(tmp_path, study()), None, tmp_path / "out", silent)
    other = SCENARIO.with_name("plant.yaml")
    with pytest.raises(InputError, match="is a study of the method 'subspace'; give it to `servotwin calibrate`"):
        tune(other)


def changed(key: str, **inner: Any) -> dict[str, Any]:
    return {key: study()[key] | inner}


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        (
            changed("controller", parameters={"sample_time": 0.02}),
            r"plants\.light: is sampled every 0\.01 s, and the controller every 0\.02 s; set the controller's",
        ),
        (
            {"plants": {"light": {"matrices": lagging(2.0) | {"outputs": {"position": "N"}}}}},
            r"plant\.position -> controller\.position: .*N",
        ),
        (
            {
                "plants": {
                    "a": {"matrices": lagging(2.0)},
                    "b": {"matrices": lagging(1.0) | {"outputs": {"position": "mV"}}},
                }
            },
            r"plants\.b: position is in mV, and in V of the first plant; give all plants the same units",
        ),
        (
            {"plants": {"light": {"matrices": lagging(2.0) | {"B": [[0.0], [0.0]]}}}},
            r"plants\.light: has the pole 1\+?.*is not controllable from its commands",
        ),
        (
            {"plants": {"light": {"matrices": lagging(2.0) | {"C": [[0.0, 1.0]]}}}},
            r"plants\.light: has the pole 1.*is not seen in what is measured",
        ),
        (
            {"design": {"unknowns": {"kq": {"min": 0, "max": 1}}}},
            r"unknowns\.kq: is no real parameter of the controller",
        ),
        ({"design": {"unknowns": {"kp": {"min": 2, "max": 1}}}}, r"unknowns\.kp: has the bounds 2 and 1"),
        (
            {"design": {"unknowns": {"kp": {"start": 3, "min": 0, "max": 1}}}},
            r"unknowns\.kp: starts at 3, outside \[0, 1\]",
        ),
        (
            {"design": {"unknowns": {"kp": {"min": 0, "max": 1, "scale": "log"}}}},
            r"unknowns\.kp: is searched in a log scale from 0",
        ),
        ({"connections": ["controller.voltage -> plant.u"]}, r"connections: make no loop; connect plant -> controller"),
        ({"tracked": "plant.speed"}, r"tracked: no variable 'speed' in 'plant'"),
        ({"reference": "plant.position"}, r"plant\.position"),
        (
            {"goals": [{"measure": "phase margin", "at_least": "1 s"}]},
            r"goals\.0\.at_least: .*",
        ),
        (
            {"goals": [{"measure": "overshoot", "of": "plant.u", "at_most": 1}]},
            r"goals\.0\.of: 'plant\.u' follows nothing",
        ),
        (
            {"goals": [{"measure": "saturation", "at_most": 0}]},
            r"goals\.0: asks for saturation, and `step` has no `limit`",
        ),
        (
            {"goals": [{"measure": "gain margin", "at_least": 6, "opened": "plant.u -> controller.position"}]},
            r"goals\.0\.opened: .* is none of the connections",
        ),
        (
            {"goals": [{"measure": "gain margin", "at_least": 9, "at_most": 6}]},
            r"goals\.0: asks for at least 9 and at most 6",
        ),
        (
            {"goals": [{"measure": "phase margni", "at_least": 9}]},
            r"'phase margni' is no measure; there are gain margin",
        ),
        ({"goals": [{"measure": "phase margin"}]}, r"give `at_least` or `at_most`"),
        (
            {"goals": [{"measure": "phase margin", "of": "plant.u", "at_least": 1}]},
            r"`of` means nothing for 'phase margin'",
        ),
        ({"goals": None, "minimise": None}, r"asks for nothing"),
        (changed("controller", model="excitation", parameters={}), r"model 'excitation' is no sampled controller"),
        (
            {"plants": {"light": {"matrices": lagging(2.0) | {"A": [[1.0]]}}}},
            r"`B` is not 1 x 1",
        ),
        ({"plants": {"light": {}}}, r"give one of `fmu`, `calibrated`, `matrices` and `components`"),
        ({"plants": {"light": {"calibrated": "nowhere"}}}, r"nowhere: holds no summary\.json"),
        (
            {"plants": {"light": {"fmu": "a.fmu", "calibration": {"folder": "."}}}},
            "`calibration` belongs to `components`",
        ),
    ],
)
def test_what_does_not_fit_together_is_refused(tmp_path: Path, changes: dict[str, Any], problem: str) -> None:
    with pytest.raises(InputError, match=problem) as refused:
        tune(write(tmp_path, study(**changes)))
    assert "study.yaml" in str(refused.value)


def test_compensation_without_a_band_has_no_linear_model(tmp_path: Path) -> None:
    controller = {"model": "pdpc", "parameters": {"sample_time": STEP, "error_band": 0, "speed_band": 0}}
    with pytest.raises(InputError, match=r"controller\.voltage: jumps or bends where the controller rests"):
        tune(write(tmp_path, study(controller=controller)))


@pytest.mark.slow
def test_the_thesis_starts_lead_to_one_optimum_within_its_margins(tmp_path: Path) -> None:
    found = tune(SCENARIO).summary
    assert found["feasible"]  # type: ignore[typeddict-item]
    assert found["agree"] == len(found["starts"]) == 3  # type: ignore[typeddict-item]
    values = [found["parameters"][f"controller.{name}"]["value"] for name in ("kp", "kd")]
    assert values == pytest.approx([0.6493, 4.4115], rel=1e-3)


def test_values_that_are_given_are_judged_and_written_as_they_are(tmp_path: Path) -> None:
    sought = tuned(tmp_path)
    gain = sought["parameters"]["controller.kp"]["value"]
    controller = {"model": "pi", "parameters": {"sample_time": STEP, "ki": 0, "kp": gain}}
    given = tuned(tmp_path, controller=controller, design={"by": "given"})
    assert given["feasible"]
    assert given["parameters"] == {}
    assert [goal["figures"] for goal in given["goals"]] == [pytest.approx(goal["figures"]) for goal in sought["goals"]]
    [kp] = [port for port in about(tmp_path / "out" / "fmus" / "controller.fmu")["parameters"] if port["name"] == "kp"]
    assert float(kp["start"]) == gain
    faster = controller | {"parameters": controller["parameters"] | {"kp": 2 * gain}}  # type: ignore[operator]
    missed = tuned(tmp_path, controller=faster, design={"by": "given"})
    assert "phase margin at least 60 deg" in missed["verdict"]["said"]


@pytest.mark.slow
def test_one_setting_has_less_phase_margin_the_heavier_the_payload_and_the_same_gain_margin() -> None:
    """Figure 4-8, but for its gain margin."""
    found = tune(SCENARIO.with_name("trial.yaml")).summary
    gain, phase = ([goal["figures"][f"{load} g"] for load in (0, 200, 400)] for goal in found["goals"][:2])  # type: ignore[typeddict-item]
    assert phase[0] > 1.3 * phase[1] > 1.5 * phase[2]
    assert max(gain) - min(gain) < 1.0
    assert found["verdict"]["held"]


@pytest.mark.slow
def test_every_measure_can_be_a_goal_in_its_own_unit(tmp_path: Path) -> None:
    """The overshoot binds: the light plant goes as far beyond as it may."""
    asked: list[dict[str, Any]] = [
        {"measure": "overshoot", "at_most": "2 %"},
        {"measure": "phase margin", "at_least": "0.5 rad"},
        {"measure": "gain margin", "at_least": "6 dB", "opened": "controller.voltage -> plant.u"},
        {"measure": "delay margin", "at_least": "20 ms"},
        {"measure": "modulus margin", "at_least": 0.3},
        {"measure": "disk margin", "at_least": 0.3},
        {"measure": "damping", "at_least": 0.3},
        {"measure": "decay rate", "at_least": 0.1},
        {"measure": "noise gain", "at_most": 50},
        {"measure": "settling time", "at_most": "3000 ms"},
        {"measure": "rise time", "at_most": 3},
        {"measure": "steady error", "at_most": 0.1},
        {"measure": "residual", "at_most": 1},
        {"measure": "peak", "of": "controller.voltage", "at_most": 100},
        {"measure": "effort", "at_most": 100},
        {"measure": "saturation", "at_most": "50 %"},
        {"measure": "itae", "disturbed": "plant.u", "at_most": 1000},
        {"measure": "iae", "at_most": 10},
        {"measure": "ise", "at_most": 10},
    ]
    assert {goal["measure"] for goal in asked} == set(MEASURES)
    found = tuned(tmp_path, goals=asked, step={"duration": 4, "limit": 10})
    assert found["feasible"]
    assert found["goals"][0]["figures"]["light"] == pytest.approx(0.02, abs=1e-6)
    by_name = {goal["measure"]: goal for goal in found["goals"]}
    assert by_name["phase margin"]["at_least"] == pytest.approx(math.degrees(0.5))
    assert by_name["delay margin"]["at_least"] == pytest.approx(0.02)
    gain = found["parameters"]["controller.kp"]["value"]
    assert by_name["peak"]["figures"]["light"] == pytest.approx(gain)
    assert all(figure is not None for goal in found["goals"] for figure in goal["figures"].values())
