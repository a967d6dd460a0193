"""Fixtures shared by tests of identification."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from orchestrator.processes.pool import at_most
from tests.support.identification.small_study import record


@pytest.fixture(scope="module")
def in_this_process() -> Iterator[None]:
    """Simulate here: starting processes takes longer than small calibrations."""
    with at_most(1):
        yield


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of the small rig."""
    return record(tmp_path_factory.mktemp("recordings"))
