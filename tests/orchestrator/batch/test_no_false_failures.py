"""What does not change a system fails no shipped scenario: half the step, the other packaging, the other loop."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from orchestrator.batch.mutation.judge import parts
from orchestrator.comparison.sides import WAYS
from orchestrator.scenario.run import run_scenario
from orchestrator.scenario.scenario import Scenario
from orchestrator.scenario.schema import load_scenario
from tests.support.simulation.shipped import JUDGED, SCENARIOS, named

SHORT = ("butterfly/sine.yaml", "butterfly/energy_control.yaml", "flexible_arm/control/payload.yaml")
MOST = 5000  # steps with FMUs in Python
CHEAP = SCENARIOS / "butterfly" / "energy_control_refused.yaml"


def failures(scenario: Scenario, way: str, folder: Path) -> list[str]:
    """What does not hold of a scenario that is run in another way."""
    rows = run_scenario(WAYS[way](scenario, folder)).rows()
    return [f"{case}: {text}, found {found}" for case, text, held, found in rows if held == "NO"]


@pytest.mark.parametrize("way", ["half-step", "python", "python-loop"])
def test_a_short_scenario_passes_in_every_way(way: str, tmp_path: Path) -> None:
    assert failures(load_scenario(CHEAP), way, tmp_path) == []


@pytest.mark.slow
@pytest.mark.shipped
@pytest.mark.parametrize("file", JUDGED, ids=named)
def test_half_the_step_fails_no_scenario(file: Path, tmp_path: Path) -> None:
    assert failures(load_scenario(file), "half-step", tmp_path) == []


def ends_of(file: Path) -> Scenario:
    """The first case of a scenario and its last."""
    scenario = load_scenario(file)
    ends = scenario.cases[0].name, scenario.cases[-1].name
    return replace(scenario, cases=tuple(case for case in scenario.cases if case.name in ends))


@pytest.mark.slow
@pytest.mark.shipped
@pytest.mark.parametrize("file", JUDGED, ids=named)
def test_the_loop_in_python_fails_no_scenario(file: Path, tmp_path: Path) -> None:
    assert failures(ends_of(file), "python-loop", tmp_path) == []


def opening_of(file: Path) -> Scenario:
    """The case of a scenario that is held against what was accepted, or else the first, up to where some of what is
    asked of it looks no further: a step of FMUs in Python takes a hundred times as long."""
    scenario = load_scenario(file)
    accepted = (case for case in scenario.cases if any(asked.accepted for asked in case.expected))
    case = next(accepted, scenario.cases[0])
    one, timing = replace(scenario, cases=(case,), record=()), scenario.timing
    stops = parts(case, timing)
    return (
        one.until(max([stop for stop in stops if stop <= timing.start + MOST * timing.step] or stops[:1]))
        if stops
        else one
    )


@pytest.mark.slow
@pytest.mark.shipped
@pytest.mark.parametrize("way", ["python", "python-loop"])
@pytest.mark.parametrize("file", JUDGED, ids=named)
def test_neither_packaging_nor_loop_in_python_fail_a_scenario_where_it_was_accepted(
    file: Path, way: str, tmp_path: Path
) -> None:
    opening = opening_of(file)
    assert opening.cases[0].expected
    assert failures(opening, way, tmp_path) == []


@pytest.mark.slow
@pytest.mark.shipped
@pytest.mark.parametrize("name", SHORT)
def test_the_packaging_in_python_fails_no_short_scenario_to_its_end(name: str, tmp_path: Path) -> None:
    assert failures(ends_of(SCENARIOS / name), "python", tmp_path) == []
