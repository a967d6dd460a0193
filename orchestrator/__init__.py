"""Running FMUs together: traces, wiring, stepping, scenarios::

    from orchestrator import Trace, load_scenario, open_system, read, run, write

`read` and `write` move recordings in and out of files, `run`, `sweep`, `accept` and `compare` do what the commands of
these names do, and `open_system` wires FMUs and models without a file. What is named here is loaded when it is used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orchestrator.assembly.assembly import ComponentSpec, OpenSystem, open_system
    from orchestrator.assembly.stimulus import Stimulus
    from orchestrator.batch.sweep.sweep import sweep
    from orchestrator.batch.sweep.told.result import SweepResult
    from orchestrator.comparison.comparison import Tolerance
    from orchestrator.comparison.vocabulary import accept, compare
    from orchestrator.formats import Layout, read, write
    from orchestrator.scenario.run import ScenarioResult
    from orchestrator.scenario.run import run_scenario as run
    from orchestrator.scenario.scenario import Scenario
    from orchestrator.scenario.schema import load_scenario
    from orchestrator.trace import Trace

_PLACES = {
    "ComponentSpec": "assembly.assembly",
    "Layout": "formats",
    "OpenSystem": "assembly.assembly",
    "Scenario": "scenario.scenario",
    "ScenarioResult": "scenario.run",
    "SweepResult": "batch.sweep.told.result",
    "Stimulus": "assembly.stimulus",
    "Tolerance": "comparison.comparison",
    "Trace": "trace",
    "accept": "comparison.vocabulary",
    "compare": "comparison.vocabulary",
    "load_scenario": "scenario.schema",
    "open_system": "assembly.assembly",
    "read": "formats",
    "run": "scenario.run",
    "sweep": "batch.sweep.sweep",
    "write": "formats",
}
__all__ = [
    "ComponentSpec",
    "Layout",
    "OpenSystem",
    "Scenario",
    "ScenarioResult",
    "Stimulus",
    "SweepResult",
    "Tolerance",
    "Trace",
    "accept",
    "compare",
    "load_scenario",
    "open_system",
    "read",
    "run",
    "sweep",
    "write",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'orchestrator' has no attribute '{name}'")
    return getattr(import_module(f"orchestrator.{_PLACES[name]}"), "run_scenario" if name == "run" else name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
