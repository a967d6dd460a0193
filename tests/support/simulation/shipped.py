"""The scenarios that the project ships, found once: to look into every file takes a second."""

from __future__ import annotations

from pathlib import Path

from orchestrator.batch.discovery import find_scenarios
from orchestrator.batch.scenario_judge import ScenarioJudge

SCENARIOS = Path(__file__).parents[3] / "scenarios"
JUDGED = [task.file for task in find_scenarios([SCENARIOS], {}) if isinstance(task.judge, ScenarioJudge)]


def named(file: Path) -> str:
    """What a test of this file is called."""
    return str(file.relative_to(SCENARIOS))
