"""Fixtures shared by tests of the commands."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from orchestrator.processes.pool import at_most
from tests.support.simulation.swing import write_scenario


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Simulate in this process, and leave nothing in the working directory."""
    monkeypatch.chdir(tmp_path)
    with at_most(1):
        yield


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    return write_scenario(tmp_path)
