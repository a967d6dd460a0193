"""FMUs of the whole library, built once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fmus.packaging import targets
from fmus.packaging.native import compiler


@pytest.fixture(scope="session")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """name -> the Python FMU of that model of the library, with its own defaults."""
    folder = tmp_path_factory.mktemp("fmus")

    def build(name: str) -> Path:
        path = folder / f"{name}.fmu"
        return path if path.exists() else targets.build(name, path, target="python")

    return build


@pytest.fixture(scope="session")
def native_fmu(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], Path]:
    """(name, FMI version) -> the native FMU of that model of the library, with its own defaults."""
    if not compiler.available():
        pytest.skip("no C compiler here")
    folder = tmp_path_factory.mktemp("native")

    def build(name: str, fmi: int) -> Path:
        path = folder / f"{name}{fmi}.fmu"
        return path if path.exists() else targets.build(name, path, target="native", fmi=fmi)

    return build


@pytest.fixture(scope="session")
def source_fmu(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], Path]:
    """(name, FMI version) -> the same FMU without a library: its description and its sources, and nothing compiled."""
    folder = tmp_path_factory.mktemp("sources")

    def build(name: str, fmi: int) -> Path:
        path = folder / f"{name}{fmi}.fmu"
        return path if path.exists() else targets.build(name, path, target="native", fmi=fmi, platforms=())

    return build
