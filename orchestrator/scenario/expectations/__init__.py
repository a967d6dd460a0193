"""What must hold in a run: one file a kind behind the contract of `base`, read by `schema`."""

from orchestrator.scenario.expectations.base import Check, DrawnTraces, Draws, ExpectationScope, Expected, Ran, Tube
from orchestrator.scenario.expectations.on_signal import OnSignal

__all__ = ["Check", "DrawnTraces", "Draws", "ExpectationScope", "Expected", "OnSignal", "Ran", "Tube"]
