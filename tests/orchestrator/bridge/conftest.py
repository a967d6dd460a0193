"""The rig that tests of couplings share."""

from __future__ import annotations

from pathlib import Path

import pytest

from fmus.packaging import targets
from orchestrator.can.database.database import Database
from tests.support.can.coupling_samples import DBC, sample_database


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with FMUs and a database."""
    folder = tmp_path_factory.mktemp("rig")
    for name in ("dc_motor", "pendulum"):
        targets.build(name, folder / f"{name}.fmu")
    (folder / "rig.dbc").write_text(DBC)
    return folder


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Database:
    return sample_database(tmp_path_factory.mktemp("database"))
