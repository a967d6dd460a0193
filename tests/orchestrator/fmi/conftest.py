"""Fixtures that tests of single FMUs share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from fmus.packaging import targets
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.slave import Slave
from tests.support.fmus import moody
from tests.support.simulation.exchanging import Shelf, open_shelf
from tests.support.simulation.slaves import Load
from tests.support.simulation.ssps import gain


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shelf]:
    with open_shelf(tmp_path_factory.mktemp("fmus")) as shelf:
        yield shelf


@pytest.fixture
def load() -> Iterator[Load]:
    """Opens FMUs as slaves, and closes them after the test."""
    with ExitStack() as stack:

        def opened(path: Path, name: str = "fmu") -> Slave:
            slave = Slave(stack.enter_context(FmuFile(path)), name)
            stack.callback(slave.close)
            return slave

        yield opened  # type: ignore[misc]


@pytest.fixture(scope="module")
def moody_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return moody.build(tmp_path_factory.mktemp("moody"))


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return targets.build("pendulum", tmp_path_factory.mktemp("fmu") / "pendulum.fmu", target="python")


@pytest.fixture(scope="module")
def every_type() -> Path:
    """An FMU with parameters of all types."""
    return gain()
