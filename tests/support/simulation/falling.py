"""A scenario of a falling pendulum, run or refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from fmus.errors import InputError, ServotwinError
from orchestrator.fmi.interface import Value
from orchestrator.scenario.run import ScenarioResult, run_scenario
from orchestrator.trace import Trace

FALLING = """
title: A pendulum falls
components:
  hand: {model: pendulum, parameters: {viscous_friction: 0.0}}
run: {stop: 1, step: 0.01}
"""


def run(folder: Path, text: str, **overrides: Value) -> ScenarioResult:
    path = folder / "scenario.yaml"
    path.write_text(text)
    return run_scenario(path, {name.replace("__", "."): value for name, value in overrides.items()})


def refused(folder: Path, text: str, kind: type[ServotwinError] = InputError) -> str:
    """The refusal without the file's name."""
    with pytest.raises(kind) as failed:
        run(folder, text)
    message = str(failed.value)
    assert "\n" not in message
    return message.removeprefix(str(folder / "scenario.yaml"))


def trace_of(result: ScenarioResult, number: int = 0) -> Trace:
    made = result.cases[number].result
    assert made is not None
    return made.trace
