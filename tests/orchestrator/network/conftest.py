"""Network FMUs, and scenarios of them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from orchestrator.engine import Result
from orchestrator.scenario.run import run_scenario
from tests.support.fmus import bus_nodes

Run = Callable[..., Result]


@pytest.fixture(scope="session")
def node(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """What builds a network FMU."""
    folder = tmp_path_factory.mktemp("nodes")
    return lambda *replacements, **more: bus_nodes.build(folder, *replacements, **more)


@pytest.fixture
def scenario(tmp_path: Path) -> Callable[..., Path]:
    """What writes a scenario of FMUs, each with its parameters, on buses."""

    def write(parts: dict[str, tuple[Path, dict[str, Any]]], buses: dict[str, Any], **run: Any) -> Path:
        components = {name: {"fmu": str(file), "parameters": values} for name, (file, values) in parts.items()}
        more = run.pop("more", {})
        document = {"title": "a bus", "components": components, "buses": buses, "run": {"stop": 1, "step": 0.05} | run}
        file = tmp_path / "bus.yaml"
        file.write_text(json.dumps(document | more))
        return file

    return write


@pytest.fixture
def run(scenario: Callable[..., Path]) -> Run:
    """What runs such a scenario."""

    def result(*given: Any, **more: Any) -> Result:
        found = run_scenario(scenario(*given, **more)).cases[0].result
        assert found is not None
        return found

    return result
