"""Stepping a system: the plan (order, ticks), the loop, and simulations that are run again and again."""

from orchestrator.engine.account import Account, Share, shares
from orchestrator.engine.compiled import Engine
from orchestrator.engine.iterated import StepControl, TakenSteps
from orchestrator.engine.live import LiveRun
from orchestrator.engine.planning.plan import REFUSED, CycleSettings, Order, Plan, make_plan
from orchestrator.engine.profile import RunProfile
from orchestrator.engine.recording import Sink
from orchestrator.engine.run import Interrupted, Result, Run, RunFailed, Timing
from orchestrator.engine.simulation import Simulation
from orchestrator.engine.tuned import Tuned, ValueChange

__all__ = [
    "REFUSED",
    "Account",
    "CycleSettings",
    "Engine",
    "Interrupted",
    "LiveRun",
    "Order",
    "Plan",
    "Result",
    "Run",
    "RunFailed",
    "RunProfile",
    "Share",
    "Simulation",
    "Sink",
    "StepControl",
    "TakenSteps",
    "Timing",
    "Tuned",
    "ValueChange",
    "make_plan",
    "shares",
]
