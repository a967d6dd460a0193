"""Fixtures shared by all tests."""

from __future__ import annotations

import gc
import logging
import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Callable, Generator, Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import settings

from orchestrator.processes.pool import Processes, calling

settings.register_profile("any load", deadline=None)
settings.load_profile("any load")

POOLS = {"identification", "batch"}  # folders of tests many of which work in pools of processes
AHEAD = ["orchestrator.batch.ahead", "orchestrator.batch.suite", "identification.output_error.free_runs.simulator"]

# What a test may need beyond the extra `dev` -> the module or the program that shows that it is there.
MODULES = {
    "mf4": "asammdf",
    "formats": "nptdms",
    "canopen": "canopen",
    "dist": "cyclonedx_py",
    "cross": "ziglang",
    "dask": "distributed",
    "sensitivity": "SALib",
    "tools": "fmuloader",
    "browser": "playwright",
}
PROGRAMS = {"chromium": "chromium", "java": "javac"}


def pytest_configure(config: pytest.Config) -> None:
    """Let signals end in the processes of pytest-xdist too: they begin with some ignored, and so would theirs.

    All processes of one session share a cache of built FMUs. It begins empty, unless SERVOTWIN_CACHE names one to be
    used again: what is built anew is tested then. The many commands that are run find the project compiled.
    """
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for number in (signal.SIGHUP, signal.SIGQUIT):  # ignored where a shell has started the tests in the background
            signal.signal(number, signal.SIG_DFL)
    if not hasattr(config, "workerinput") and "SERVOTWIN_CACHE" not in os.environ:
        folder = tempfile.mkdtemp(prefix="servotwin-tests-")
        os.environ["SERVOTWIN_CACHE"] = folder
        config.add_cleanup(lambda: shutil.rmtree(folder, ignore_errors=True))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Have the garbage collector look at what tests make, not at all that was made in order to find them."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_finish(session: pytest.Session) -> None:
    """Have the processes of all pools forked from a server that has loaded what most of them need.

    There is one server for all pools of a process, and whoever starts it says what it loads: after a test whose pool
    needs nothing, each process of every later pool would load NumPy, SciPy and the project by itself.
    """
    if session.config.option.collectonly:
        return
    if POOLS & {part for item in session.items for part in item.path.parts}:
        with Processes[Callable[[], int], int](calling, 1, AHEAD) as pool:
            list(pool.answers([os.getpid]))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what needs an extra or a program that is not there, and say which."""
    for marker in item.iter_markers("needs"):
        for need in marker.args:
            there = shutil.which(PROGRAMS[need]) if need in PROGRAMS else find_spec(MODULES[need])
            if there is None:
                pytest.skip(f"`{need}` is not there (.ci/run installs what it names)")


@pytest.fixture(autouse=True)
def same_folder() -> Iterator[None]:
    """No test leaves the process in another working directory, where the next ones would fail."""
    here = Path.cwd()
    yield
    try:
        there = Path.cwd()
    except FileNotFoundError:
        there = None
    os.chdir(here)
    assert there == here, "the test left the process in another working directory"


@pytest.fixture(autouse=True)
def same_log() -> Iterator[None]:
    """No command that ran in this process decides what is logged in the tests that follow."""
    root = logging.getLogger()
    level, handlers = root.level, [*root.handlers]
    yield
    root.setLevel(level)
    root.handlers[:] = handlers


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


@pytest.fixture
def emps_data() -> Path:
    """Folder with the real recording of the linear axis."""
    return _recordings("emps")
