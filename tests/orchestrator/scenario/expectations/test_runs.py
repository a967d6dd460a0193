"""Expectations of the run, of others, and of events of several signals."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from fmus.errors import FmuError, ScenarioError
from orchestrator import formats
from orchestrator.engine import Account, Engine, Result
from orchestrator.engine.loop import Statistics
from orchestrator.scenario.expectations import Check, Ran
from orchestrator.scenario.expectations.on_run import KINDS
from orchestrator.scenario.expectations.schema import AGAINST, FIGURES, FIRST, TOGETHER, ExpectationBlock
from orchestrator.trace import Trace
from tests.orchestrator.scenario.expectations.test_kinds import KINDS as OF_A_SIGNAL
from tests.support.simulation.expecting import asked

TIME = np.linspace(0.0, 10.0, 1001)
TRACE = Trace(TIME, {"y": TIME, "u": np.clip(TIME, 0.0, 4.0), "mode": np.floor(TIME / 3)}, {}, "run")


def result(**more: Any) -> Result:
    account = Account(Engine.COMPILED, "", 1000, 0.01, 0.0, 10.0, 0.5)
    given = {"warnings": {"hand": 0, "motor": 0}, "iterations": 7} | more
    statistics = {"hand": Statistics(1000, 0.2), "motor": Statistics(500, 0.1)}
    return Result(TRACE, statistics, account=account, **given)


def ran(**more: Any) -> Ran:
    return Ran(TRACE, **{"result": result(), "processor": 0.4, "case": "run"} | more)


def judged(run: Ran, base: Path = Path(), **fields: Any) -> Check:
    return ExpectationBlock(**fields).expectation(base).check(run)


BUS = {"frames lost": 3, "late steps": 5}
# kind -> what is asked and held, the same for another run; and that other run.
RUNS: dict[str, tuple[dict[str, Any], Ran, Ran]] = {
    "warnings": ({"warnings": "none"}, ran(), ran(result=result(warnings={"hand": 2, "motor": 0}))),
    "steps": ({"steps": {"component": "hand", "near": 1000, "within": 0}}, ran(), ran(result=result())),
    "iterations": ({"iterations": {"at_most": 7}}, ran(), ran(result=result(iterations=8))),
    "real_time_factor": ({"real_time_factor": {"at_least": 20}}, ran(), ran()),
    "processor_time": ({"processor_time": {"seconds": "0.3 s", "at_most": 1.5}}, ran(), ran(processor=0.5)),
    "frames_lost": ({"frames_lost": "none"}, ran(bus={**BUS, "frames lost": 0}), ran(bus=BUS)),
    "late_steps": ({"late_steps": {"at_most": 4}}, ran(bus={**BUS, "late steps": 4}), ran(bus=BUS)),
}
BROKEN = {"steps": {"steps": {"at_most": 1499}}, "real_time_factor": {"real_time_factor": {"at_least": 20.1}}}


def test_each_kind_of_a_run_is_in_the_table() -> None:
    assert set(RUNS) == set(KINDS)


@pytest.mark.parametrize("kind", RUNS)
def test_a_kind_holds_of_a_good_run_and_not_of_another(kind: str) -> None:
    fields, good, other = RUNS[kind]
    assert judged(good, **fields).held
    failed = judged(other, **BROKEN.get(kind, fields))
    assert not failed.held
    assert failed.failed == (kind != "late_steps")
    assert failed.margin is not None and failed.margin < 0


@pytest.mark.parametrize("kind", RUNS)
def test_no_figure_holds_of_a_run_that_failed(kind: str) -> None:
    check = judged(Ran(None, FmuError("hand", "step")), **RUNS[kind][0])
    assert (check.held, check.found) == (False, "hand: step")


def test_what_is_asked_of_a_bus_is_no_question_where_there_is_none() -> None:
    check = judged(ran(), frames_lost="none")
    assert (check.held, check.found, check.figure) == (True, "not on a bus", None)


def test_a_stored_processor_time_is_read_from_the_manifest_by_the_name_of_the_case(tmp_path: Path) -> None:
    cases = [{"name": "other", "processor": 9.0}, {"name": "run", "processor": 0.2}]
    (tmp_path / "manifest.json").write_text(json.dumps({"cases": cases}))
    asking = {"manifest": "manifest.json", "at_most": 2.1}
    assert judged(ran(), tmp_path, processor_time=asking).figure == pytest.approx(2.0)
    for text in ('{"cases": [{"name": "run"}]}', "[]", "no json", '{"cases": [{"name": "run", "processor": 0}]}'):
        (tmp_path / "manifest.json").write_text(text)
        with pytest.raises(ScenarioError, match=r"manifest\.json: has no processor time of case run"):
            judged(ran(), tmp_path, processor_time=asking)


def test_an_unknown_component_is_named() -> None:
    with pytest.raises(ScenarioError, match="there is no component arm; known are hand, motor"):
        judged(ran(), warnings={"component": "arm", "at_most": 0})


GOOD, BAD = {"signal": "y", "below": 11}, {"signal": "y", "below": 9}


@pytest.mark.parametrize(
    ("fields", "held"),
    [
        ({"all": [GOOD, GOOD]}, True),
        ({"all": [GOOD, BAD]}, False),
        ({"any": [BAD, GOOD]}, True),
        ({"any": [BAD, BAD]}, False),
        ({"some": {"least": 2, "of": [GOOD, BAD, GOOD]}}, True),
        ({"some": {"least": 2, "of": [GOOD, BAD, BAD]}}, False),
        ({"all": [{"any": [BAD, GOOD]}, {"warn": BAD}]}, True),
        ({"all": [{"signals": ["y", "u"], "below": 11}]}, True),
        ({"all": [{"signals": ["y", "u"], "below": 9}]}, False),
        ({"any": [{"refused": "rest"}, GOOD]}, True),
    ],
)
def test_expectations_are_combined(fields: dict[str, Any], held: bool) -> None:
    assert judged(ran(), **fields).held == held


SAYING = Trace(TIME, {"word": np.repeat([0.0, 1.0], [500, 501])}, {}, "run", texts={"word": ("idle", "ready")})
NOISY = {"signal": "y", "below": 10.5, "seeds": 2, "share": 1}
REFERENCE = {"signal": "y", "reference": {"file": "reference.csv"}}


def draws(*heights: float) -> dict[tuple[str, ...], list[Trace]]:
    return {(): [Trace(TIME, {"y": TIME + height}, {}, "draw") for height in heights]}


# kind -> what is asked, of which run, and a run that is broken.
OTHERS: dict[str, tuple[dict[str, Any], Ran, Ran]] = {
    "refused": ({"refused": "too fast"}, Ran(None, FmuError("hand", "goes too fast")), ran()),
    "equals": (
        {"signal": "word", "after": 6, "equals": "ready"},
        Ran(SAYING),
        Ran(replace(SAYING, texts={"word": ("ready", "idle")})),
    ),
    "band": (
        {**REFERENCE, "band": {"seeds": 5}},
        ran(draws=draws(-0.2, -0.1, 0.1, 0.2, 0.3)),
        ran(draws=draws(1.0, 1.1, 1.2, 1.3, 1.4)),
    ),
    "seeds": (NOISY, ran(draws=draws(0.1, 0.2)), ran(draws=draws(0.1, 0.7))),
    "all": ({"all": [GOOD, {"warnings": "none"}]}, ran(), ran(result=result(warnings={"hand": 2}))),
    "any": ({"any": [BAD, {"warnings": "none"}]}, ran(), ran(result=result(warnings={"hand": 2}))),
    "some": (
        {"some": {"least": 2, "of": [GOOD, BAD, {"warnings": "none"}]}},
        ran(),
        ran(result=result(warnings={"hand": 2})),
    ),
    "warn": ({"warn": {"warnings": "none"}}, ran(), ran(result=result(warnings={"hand": 2}))),
    "in_order": (
        {"in_order": [{"signal": "y", "crossings": {"level": 3.5}}, {"signal": "u", "crossings": {"level": 3.9}}]},
        ran(),
        Ran(Trace(TIME, {"y": TIME, "u": 2 * TIME}, {}, "run")),
    ),
}


@pytest.mark.parametrize("kind", OTHERS)
def test_every_other_kind_holds_of_a_good_run_and_not_of_a_broken_one(kind: str, tmp_path: Path) -> None:
    formats.write(Trace(TIME, {"y": TIME}, {}, "reference"), tmp_path / "reference.csv")
    fields, good, broken = OTHERS[kind]
    held, failed = (judged(run, tmp_path, **fields) for run in (good, broken))
    assert held.held, held
    assert not failed.held and failed.found, failed
    assert failed.failed == (kind != "warn")


def test_a_warning_fails_nothing_and_is_told() -> None:
    check = judged(ran(), warn=BAD)
    assert (check.held, check.failed, check.found) == (False, False, "NOT largest 10")
    assert check.text == "warn: y stays below 9"


def test_a_combination_wants_the_signals_of_all_its_parts_and_may_be_refused_where_one_may() -> None:
    expected = ExpectationBlock(any=[{"refused": "rest"}, {"all": [GOOD, {"signal": "u", "above": 0}]}]).expectation(
        Path()
    )
    assert expected.signals == ("y", "u") and expected.refuses
    assert expected.check(Ran(None, FmuError("hand", "step", "at rest"))).held


def test_events_of_several_signals_come_in_order() -> None:
    first = {"signal": "y", "crossings": {"level": 3.5}}
    second = {"signal": "u", "saturations": {"low": -4, "high": 4}}
    third = {"signal": "mode", "mode_changes": {}}
    held = asked({"in_order": [first, second, third]}, TRACE)
    assert (held.held, held.found) == (True, "at 3.5, 4, 6 s")
    failed = asked({"in_order": [second, first, third]}, TRACE)
    assert (failed.held, failed.found) == (False, "step 2: no crossings of 3.5 of y after 4 s")
    assert not asked({"in_order": [first, second, third], "before": 5}, TRACE).held


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"some": {"least": 3, "of": [GOOD]}}, "`least` is 3 of 1"),
        ({"all": []}, "at least 1 item"),
        ({"all": [GOOD], "after": 1}, "`after` and `before` do not go with `all`"),
        ({"signal": "y", "all": [GOOD]}, "`signal` goes with everything but"),
        ({"signal": "y", "signals": ["u"], "below": 1}, "give `signal` or `signals`"),
        ({"processor_time": {"at_most": 2}}, "give `seconds` or `manifest`"),
        ({"signal": "y", "rms": {}}, "give `at_most`, `at_least`, or `near` and `within`"),
        ({"signal": "y", "rms": {"near": 1}}, "`near` and `within` go together"),
        ({"signal": "y", "rms": {"near": 1, "within": "-1 rad"}}, "`within` must not be negative"),
        ({"signal": "y", "limit_cycle": {}}, "give `amplitude` or `period` or both, or else `none_above`"),
        ({"signal": "y", "crossings": {"level": 1, "count": 1, "at_least": 1}}, "give one of `count`"),
        ({"signal": "y", "crossings": {"level": 1, "times": [1]}}, "`times` and `within` go together"),
        ({"signal": "y", "crossings": {"level": 1, "times": [2, 1], "within": 1}}, "`times` must ascend"),
        ({"signal": "y", "mode_changes": {"modes": [1, 2], "count": 1}}, "`modes` say how many"),
        ({"signal": "y", "range": [{"below": 1}, {"to": 3, "below": 1}]}, "only the last with the run"),
        ({"signal": "y", "range": [{"to": 3}]}, "give `below`, `above` or both"),
        ({"signal": "y", "overshoot": {"target": 1, "at_most": "5 kg"}}, None),
        ({"signal": "y", "settling_time": {"target": 1, "band": 0.1, "at_most": 1, "over": 2}}, "Extra inputs"),
        ({"signal": "y", "final_value": {"over": "2 kg", "at_most": 1}}, "'2 kg' is no time; give seconds"),
        ({"signal": "y", "monotone": "risen"}, "write rising or falling, or keys: direction, slack"),
        ({"signal": "y", "limit_cycle": "some"}, "write none, or keys: amplitude"),
        ({"frames_lost": {"component": "y", "at_most": 0}}, "Extra inputs"),
        ({"signal": "y", "below": 1, "above": 0}, "or of the other kinds, not below and above"),
        ({"signal": "y", "funnel": {"value": 1}}, "`funnel` goes with `reference`"),
        ({"in_order": [{"signal": "y"}, {"signal": "u"}]}, "give one of crossings, saturations, mode_changes"),
    ],
)
def test_what_makes_no_sense_is_refused(fields: dict[str, Any], problem: str | None) -> None:
    if problem is None:
        with pytest.raises(Exception, match="kg does not fit"):
            asked(fields, TRACE)
        return
    with pytest.raises(ValidationError, match=problem):
        ExpectationBlock(**fields)


def test_a_figure_that_cannot_be_told_of_a_signal_does_not_hold_and_says_why() -> None:
    flat = Trace(TIME, {"y": np.zeros_like(TIME)}, {}, "flat")
    check = asked({"signal": "y", "distortion": {"frequency": "1 Hz", "at_most": 0.1}}, flat)
    assert (check.held, check.found) == (False, "harmonics: there is no fundamental of 6.28319 rad/s")
    assert asked({"signal": "y", "damping": {"at_least": 0.1}}, flat).found == "no damping"


def test_every_key_of_an_expectation_has_a_broken_copy_in_a_table_or_says_of_what_and_when() -> None:
    said = {"signal", "signals", "after", "before", "share", "vary", "reference"}
    assert set(ExpectationBlock.model_fields) - said == {*OF_A_SIGNAL, *RUNS, *OTHERS}
    assert {*OF_A_SIGNAL, *RUNS, *OTHERS} - {"seeds"} == {*FIRST, *FIGURES, *AGAINST, *KINDS, *TOGETHER} - said


def test_the_guide_has_a_row_for_every_kind_and_for_nothing_else() -> None:
    guide = (Path(__file__).parents[4] / "docs" / "guides" / "scenarios.md").read_text(encoding="utf-8")
    table = guide.partition("| asked of | kinds")[2].partition("\n\n")[0]
    kinds = {*FIRST, *FIGURES, *AGAINST, *KINDS, *TOGETHER}
    settings = {"value", "relative", "of_range", "time", "leading", "lagging", "none", "seeds", "share"}
    assert set(re.findall(r"`(\w+)`", table)) - settings == kinds
