"""The database that tests of traffic share."""

from __future__ import annotations

from pathlib import Path

import pytest

from orchestrator.can.database.database import Database
from tests.support.can.coupling_samples import sample_database


@pytest.fixture
def rig(tmp_path: Path) -> Database:
    return sample_database(tmp_path)
