"""An interrupt keeps the cases that are done, part of the one that runs, and lists the others."""

from __future__ import annotations

import pickle
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import FmuError
from orchestrator.engine import Result, Run, Simulation
from orchestrator.processes.interrupts import Interrupts
from orchestrator.scenario.run import ScenarioInterrupted, ScenarioResult, run_scenario
from tests.support.simulation.falling import FALLING, run, trace_of

pytestmark = pytest.mark.usefixtures("scratch")


def stopped_at(folder: Path, text: str, fraction: float) -> ScenarioResult:
    """What a scenario leaves that is interrupted when so much of it is done."""

    def interrupt(done: float, doing: str) -> None:
        if done >= fraction:
            raise KeyboardInterrupt

    path = folder / "scenario.yaml"
    path.write_text(text)
    with pytest.raises(ScenarioInterrupted) as stopped:
        run_scenario(path, progress=interrupt)
    assert type(pickle.loads(pickle.dumps(stopped.value))) is KeyboardInterrupt
    return stopped.value.result


EXPECT = "expect: [{signal: hand.angle, below: 9}]\n"
THREE = FALLING + EXPECT + "cases: [{name: a}, {name: b, set: {hand.angle_start: 0.2}}, {name: c}]\n"


def test_an_interrupt_keeps_the_cases_that_are_done_and_the_one_that_runs(tmp_path: Path) -> None:
    result = stopped_at(tmp_path, THREE, 0.5)
    assert [(case.name, case.state) for case in result.cases] == [("a", "done"), ("b", "interrupted"), ("c", "not run")]
    assert [case.passed for case in result.cases] == [True, False, False]
    assert [len(case.checks) for case in result.cases] == [1, 0, 0]
    assert result.interrupted and not result.passed
    whole = run(tmp_path, THREE)
    assert np.array_equal(trace_of(result)["hand.angle"], trace_of(whole)["hand.angle"])
    part = trace_of(result, 1)
    assert np.array_equal(part["hand.angle"], trace_of(whole, 1)["hand.angle"][: len(part)]) and len(part) > 0


def test_an_interrupt_before_anything_was_stepped_leaves_nothing(tmp_path: Path) -> None:
    path = tmp_path / "scenario.yaml"
    path.write_text(FALLING)
    with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt) as stopped:
        patch.setattr(Simulation, "check_record", interrupt_now)
        run_scenario(path)
    assert not isinstance(stopped.value, ScenarioInterrupted)


def test_an_interrupt_between_two_cases_lists_those_that_have_not_begun(tmp_path: Path) -> None:
    def between(simulation: Simulation, run: Run, *more: Any) -> Result:
        if run.values == {"hand.viscous_friction": 0.0, "hand.angle_start": 0.2}:
            raise KeyboardInterrupt
        return execute(simulation, run, *more)

    execute: Any = Simulation.execute
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Simulation, "execute", between)
        result = stopped_at(tmp_path, THREE, 2.0)
    assert [case.state for case in result.cases] == ["done", "not run", "not run"]


def test_an_interrupt_when_all_is_done_loses_nothing(tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Simulation, "close", interrupt_now)
        result = stopped_at(tmp_path, THREE, 2.0)
    assert [case.state for case in result.cases] == ["done"] * 3
    assert result.interrupted and result.passed


def test_the_error_with_which_an_fmu_answers_an_interrupt_is_no_refusal(tmp_path: Path) -> None:
    """Also where a case expects one: the cases after it do not run."""

    def fail(*_: object) -> None:
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        raise FmuError("hand", "returned fatal error")

    path = tmp_path / "scenario.yaml"
    path.write_text(FALLING + "cases: [{name: a, expect: [{refused: fatal}]}, {name: b}]")
    with pytest.MonkeyPatch.context() as patch, Interrupts(), pytest.raises(KeyboardInterrupt):
        patch.setattr("orchestrator.engine.simulation.initialise", fail)
        run_scenario(path)


def interrupt_now(*_: object) -> None:
    raise KeyboardInterrupt
