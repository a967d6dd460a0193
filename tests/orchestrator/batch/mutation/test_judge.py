"""A parameter that is changed by 1 % is seen, unseen, or does not act, as what scenarios ask has it."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from fmus.errors import InputError
from orchestrator.batch.mutation import judge
from orchestrator.batch.mutation.coverage import Coverage, MutationOutcome, outcome_of
from orchestrator.batch.mutation.judge import MutationJudge
from orchestrator.batch.verdict import Verdict
from orchestrator.scenario.schema import load_scenario

GRAVITY = "hand.gravity_torque"


def scenario(folder: Path, name: str = "swing", **more: Any) -> Path:
    """A hand that swings without friction from 0.5 rad."""
    still = {"viscous_friction": 0, "coulomb_friction_positive": 0, "coulomb_friction_negative": 0}
    document = {
        "title": "swing",
        "components": {
            "hand": {"model": "pendulum", "parameters": {"angle_start": 0.5, "inertia": "4e-3 kg.m2"} | still}
        },
        "run": {"stop": 1, "step": 0.01},
        "record": ["hand.angle"],
    } | more
    (folder / f"{name}.yaml").write_text(json.dumps(document))
    return folder / f"{name}.yaml"


def outcomes(file: Path) -> dict[str, MutationOutcome]:
    document = MutationJudge()(file, Path("unused"))
    assert document["passed"] == all(case["passed"] for case in document["cases"])
    return {case["name"]: outcome_of(case) for case in document["cases"]}


def test_a_loose_expectation_sees_no_change_and_a_narrow_one_does(tmp_path: Path) -> None:
    loose = outcomes(scenario(tmp_path, expect=[{"signal": "hand.angle", "below": 3}]))
    narrow = outcomes(scenario(tmp_path, expect=[{"signal": "hand.angle", "below": 0.5001}]))
    assert loose["hand.angle_start"] == MutationOutcome.UNSEEN and narrow["hand.angle_start"] == MutationOutcome.SEEN
    assert loose["hand.inertia"] == narrow["hand.inertia"] == MutationOutcome.UNSEEN


def test_what_moves_no_output_has_no_effect(tmp_path: Path) -> None:
    found = outcomes(scenario(tmp_path))
    assert found["hand.friction_speed"] == MutationOutcome.WITHOUT_EFFECT  # without friction
    assert found[GRAVITY] == MutationOutcome.UNSEEN
    assert "hand.viscous_friction" not in found  # 1 % of nothing


def test_what_is_not_recorded_counts_for_it_is_an_output_all_the_same(tmp_path: Path) -> None:
    components = {
        "hand": {"model": "pendulum", "parameters": {"angle_start": 0.5}},
        "motor": {"model": "dc_motor", "parameters": {"resistance": 2.0}},
    }
    found = outcomes(scenario(tmp_path, components=components, stimuli={"motor.voltage": {"constant": 1.0}}))
    assert found["motor.resistance"] == MutationOutcome.UNSEEN  # of the current


@pytest.mark.slow
def test_what_changes_no_more_than_the_step_does_is_told_from_what_acts(tmp_path: Path) -> None:
    """A drive that is held over each step is off by half of a step, here 5 % of a period; friction by far less."""
    components = {
        "drive": {"model": "excitation", "parameters": {"shape": "sine", "amplitude": 0.002, "frequency": 1}},
        "motor": {"model": "dc_motor", "parameters": {"torque_gain": 2.5}},
        "hand": {"model": "pendulum", "parameters": {"viscous_friction": 1e-3}},
    }
    connections = ["drive.signal -> motor.voltage", "motor.torque -> hand.torque"]
    held = {"components": components, "connections": connections, "run": {"stop": 2, "step": 0.1}}
    coarse = outcomes(scenario(tmp_path, "coarse", **held))
    fine = outcomes(scenario(tmp_path, "fine", **{**held, "run": {"stop": 2, "step": 0.0001}}))
    assert coarse["hand.viscous_friction"] == MutationOutcome.WITHOUT_EFFECT
    assert fine["hand.viscous_friction"] == MutationOutcome.UNSEEN
    assert fine["motor.torque_gain"] == MutationOutcome.UNSEEN


def test_each_case_has_its_own_value_changed_and_one_that_sees_it_is_enough(tmp_path: Path) -> None:
    narrow = [{"signal": "hand.angle", "below": 0.8001}]
    cases = [
        {"name": "low", "expect": [{"signal": "hand.angle", "below": 3}]},
        {"name": "high", "set": {"hand.angle_start": 0.8}, "expect": narrow},
    ]
    (found,) = [
        case
        for case in MutationJudge()(scenario(tmp_path, cases=cases), tmp_path)["cases"]
        if "start" in case["name"] and "angle" in case["name"]
    ]
    assert outcome_of(found) == MutationOutcome.SEEN
    assert found["checks"][0]["found"].startswith("0.8 -> 0.808: high: hand.angle stays below 0.8001 rad, found")


@pytest.mark.slow
@pytest.mark.parametrize("together", [1, 3])
def test_changes_that_are_run_in_one_go_come_out_as_alone(
    together: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cases = [
        {"name": "low", "expect": [{"signal": "hand.angle", "below": 0.5001}]},
        {"name": "high", "set": {"hand.angle_start": 0.8}, "expect": [{"signal": "hand.energy", "below": 0.02}]},
    ]
    file = scenario(tmp_path, cases=cases)
    document = MutationJudge()(file, tmp_path)
    monkeypatch.setattr(judge, "TOGETHER", together)
    assert MutationJudge()(file, tmp_path) == document
    assert {outcome_of(case) for case in document["cases"]} == set(MutationOutcome)


UNTIL = [{"signal": "hand.angle", "before": before, "below": 3} for before in (0.1, 0.115, 0.3, 0.301, 0.9)]


@pytest.mark.parametrize(
    ("more", "stops"),
    [
        ({"expect": UNTIL}, ["0.12", "0.31"]),
        ({"expect": [{"any": UNTIL}]}, []),
        (
            {"expect": [{"any": UNTIL[:3]}, {"in_order": [{"signal": "hand.angle", "crossings": {"level": 0}}] * 2}]},
            ["0.3"],
        ),
        ({"expect": [{"signal": "hand.angle", "below": 3}, {"steps": {"at_least": 1}}]}, []),
        ({"expect": [*UNTIL, {"refused": "too fast"}]}, []),
        ({"expect": UNTIL, "run": {"stop": 1, "step": 0.01, "tell_stop": True}}, []),
    ],
)
def test_a_part_of_a_case_ends_where_some_of_what_is_asked_looks_no_further(
    more: dict[str, Any], stops: list[str], tmp_path: Path
) -> None:
    loaded = load_scenario(scenario(tmp_path, **more))
    assert judge.parts(loaded.cases[0], loaded.timing) == [Fraction(stop) for stop in stops]
    for stop in judge.parts(loaded.cases[0], loaded.timing):
        shortened = loaded.until(stop)
        assert shortened.timing.stop == stop
        assert 0 < len(shortened.cases[0].expected) < len(loaded.cases[0].expected)


@pytest.mark.slow
def test_parts_of_a_case_notice_what_all_of_it_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    narrow = [{"before": 0.1, "below": 0.5001}, {"before": 0.4, "above": 0.0958}, {"after": 0.8, "above": -0.5001}]
    file = scenario(tmp_path, expect=[{"signal": "hand.angle", **asked} for asked in narrow])
    found = outcomes(file)
    monkeypatch.setattr(judge, "parts", lambda case, timing: [])
    assert outcomes(file) == found
    assert {MutationOutcome.SEEN, MutationOutcome.UNSEEN} <= set(found.values())


def test_a_scenario_that_fails_as_it_is_cannot_notice_anything(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not pass as it is"):
        MutationJudge()(scenario(tmp_path, expect=[{"signal": "hand.angle", "below": 0}]), tmp_path)
    assert Coverage.of([]).sentence == "no change was made that acts: there was nothing to notice"


def test_the_share_is_of_changes_that_show_and_names_what_no_file_notices(tmp_path: Path) -> None:
    loose = scenario(tmp_path, "loose")
    narrow = scenario(tmp_path, "narrow", expect=[{"signal": "hand.angle", "below": 0.5001}])
    coverage = Coverage.of(Verdict(file, 1.0, MutationJudge()(file, tmp_path)) for file in (loose, narrow))
    shown = [outcome for outcome in coverage.outcomes.values() if outcome != MutationOutcome.WITHOUT_EFFECT]
    assert coverage.share == shown.count(MutationOutcome.SEEN) / len(shown) and 0 < coverage.share < 1
    assert "hand.angle_start" not in coverage.unnoticed
    assert coverage.unnoticed[GRAVITY] == [loose, narrow]
    assert coverage.unseen["hand.angle_start"] == [loose]
    assert coverage.sentence.startswith(f"{100 * coverage.share:.1f} % of the changes that act are noticed (")
    assert [row[0] for row in coverage.rows()] == [str(loose), str(narrow)]
