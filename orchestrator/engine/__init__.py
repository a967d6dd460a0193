"""Stepping a system: the plan (order, ticks), the loop, and simulations that are run again and again."""

from orchestrator.engine.plan import CycleSettings, Order, Plan, make_plan
from orchestrator.engine.simulation import Result, Simulation, Timing

__all__ = ["CycleSettings", "Order", "Plan", "Result", "Simulation", "Timing", "make_plan"]
