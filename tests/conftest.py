"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def _recordings(folder: str) -> Path:
    root = Path(os.environ.get("SERVOTWIN_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not (root / folder).is_dir():
        pytest.skip(f"real recordings not found: {root / folder} (set SERVOTWIN_DATA to their folder)")
    return root / folder


@pytest.fixture
def butterfly_data() -> Path:
    """Folder with the real recordings of the Butterfly robot."""
    return _recordings("butterfly")
