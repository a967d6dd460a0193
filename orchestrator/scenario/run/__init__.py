"""A scenario run: each case stepped, judged and kept as it is wanted."""

from orchestrator.scenario.run.keeping import Execute, Keeping
from orchestrator.scenario.run.outcome import (
    HEADERS,
    CaseResult,
    CaseState,
    ScenarioFailed,
    ScenarioInterrupted,
    ScenarioResult,
    nonfinite,
)
from orchestrator.scenario.run.overrides import parse_override
from orchestrator.scenario.run.same_system import hashes_of
from orchestrator.scenario.run.scenario import run_scenario

__all__ = [
    "HEADERS",
    "CaseResult",
    "CaseState",
    "Execute",
    "Keeping",
    "ScenarioFailed",
    "ScenarioInterrupted",
    "ScenarioResult",
    "hashes_of",
    "nonfinite",
    "parse_override",
    "run_scenario",
]
