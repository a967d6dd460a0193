"""What must hold in a run: one file a kind behind the contract of `base`, read by `schema`."""

from orchestrator.scenario.expectations.base import Check, Draws, Expected, Ran, Tube, Wiring
from orchestrator.scenario.expectations.on_signal import OnSignal

__all__ = ["Check", "Draws", "Expected", "OnSignal", "Ran", "Tube", "Wiring"]
