"""What scenario files may say, and how they are read."""

from orchestrator.scenario.schema.scenario import PartBlock, ScenarioBlock, load_scenario

__all__ = ["PartBlock", "ScenarioBlock", "load_scenario"]
