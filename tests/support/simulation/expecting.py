"""An expectation as a file has it, asked of a trace made for the purpose."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fmus.errors import WiringError
from orchestrator.fmi.interface import Port
from orchestrator.scenario.expectations import Check, ExpectationScope, Ran
from orchestrator.scenario.expectations.schema import ExpectationBlock
from orchestrator.trace import Trace


def wiring(trace: Trace, discrete: bool = False) -> ExpectationScope:
    """Variables with the units of a trace's signals, on lines between samples or held."""

    def port(name: str, place: str) -> Port:
        if name not in trace.names:
            raise WiringError(place, f"there is no {name}")
        variability = "discrete" if discrete else "continuous"
        return Port(name, 0, "Float64", "output", trace.unit(name), variability=variability)

    return ExpectationScope(port)


def asked(fields: dict[str, Any], trace: Trace, base: Path = Path(), discrete: bool = False) -> Check:
    """How an expectation with these keys turns out for a trace, as in a run."""
    expected = ExpectationBlock(**fields).expectation(base).brought(wiring(trace, discrete))
    expected.check_covered(trace.time)
    return expected.check(Ran(trace))
