"""Fixtures shared by all tests."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path

import pytest


def pytest_configure() -> None:
    """Let Ctrl-C interrupt in the processes of pytest-xdist too: they begin with it ignored, and so would theirs."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _recordings(folder: str) -> Path:
    root = Path(os.environ.get("SERVOTWIN_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not (root / folder).is_dir():
        pytest.skip(f"real recordings not found: {root / folder} (set SERVOTWIN_DATA to their folder)")
    return root / folder


@pytest.fixture
def butterfly_data() -> Path:
    """Folder with the real recordings of the Butterfly robot."""
    return _recordings("butterfly")


@pytest.fixture
def flexible_link_data() -> Path:
    """Folder with the real recordings of the flexible link."""
    return _recordings("flexible-link")
