"""What scenario files may say, and how they are read."""

from orchestrator.scenario.schema.scenario import ScenarioBlock, ScenarioPartBlock, load_scenario

__all__ = ["ScenarioBlock", "ScenarioPartBlock", "load_scenario"]
