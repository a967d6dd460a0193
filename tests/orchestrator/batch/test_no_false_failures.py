"""What does not change a system fails no shipped scenario: half the step, the other packaging, the other loop."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from orchestrator.comparison.sides import WAYS
from orchestrator.scenario.run import run_scenario
from orchestrator.scenario.scenario import Scenario
from orchestrator.scenario.schema import load_scenario

SCENARIOS = Path(__file__).parents[3] / "scenarios"
SHORT = ("butterfly/sine.yaml", "butterfly/energy_control.yaml", "flexible_arm/control/payload.yaml")
CHEAP = SCENARIOS / "butterfly" / "energy_control_refused.yaml"


def judging() -> list[Path]:
    """The shipped scenarios that are run by themselves and ask for something."""
    texts = {file: file.read_text() for file in sorted(SCENARIOS.rglob("*.yaml"))}
    return [file for file, text in texts.items() if "\nrun:" in text and "\ncan:" not in text and "expect:" in text]


def failures(scenario: Scenario, way: str, folder: Path) -> list[str]:
    """What does not hold of a scenario that is run in another way."""
    rows = run_scenario(WAYS[way](scenario, folder)).rows()
    return [f"{case}: {text}, found {found}" for case, text, held, found in rows if held == "NO"]


@pytest.mark.parametrize("way", ["half-step", "python", "python-loop"])
def test_a_short_scenario_passes_in_every_way(way: str, tmp_path: Path) -> None:
    assert failures(load_scenario(CHEAP), way, tmp_path) == []


@pytest.mark.slow
@pytest.mark.shipped
@pytest.mark.parametrize("file", judging(), ids=lambda file: str(file.relative_to(SCENARIOS)))
def test_half_the_step_fails_no_scenario(file: Path, tmp_path: Path) -> None:
    assert failures(load_scenario(file), "half-step", tmp_path) == []


def ends_of(file: Path) -> Scenario:
    """The first case of a scenario and its last."""
    scenario = load_scenario(file)
    ends = scenario.cases[0].name, scenario.cases[-1].name
    return replace(scenario, cases=tuple(case for case in scenario.cases if case.name in ends))


@pytest.mark.slow
@pytest.mark.shipped
@pytest.mark.parametrize("file", judging(), ids=lambda file: str(file.relative_to(SCENARIOS)))
def test_the_loop_in_python_fails_no_scenario(file: Path, tmp_path: Path) -> None:
    assert failures(ends_of(file), "python-loop", tmp_path) == []


@pytest.mark.slow
@pytest.mark.shipped
@pytest.mark.parametrize("name", SHORT)
def test_the_packaging_in_python_fails_no_scenario(name: str, tmp_path: Path) -> None:
    """Of those that are short: a step takes a hundred times as long."""
    assert failures(ends_of(SCENARIOS / name), "python", tmp_path) == []
