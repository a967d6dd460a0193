"""Misbehaving FMUs for tests of isolation, after which nothing may be left."""

from __future__ import annotations

import secrets
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.fmus import brute, moody
from tests.support.tools.own_processes import MARK, started


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """The brutal FMU by version of FMI."""
    folder = tmp_path_factory.mktemp("brute")
    return {version: brute.build(folder / f"brute{version}.fmu", version) for version in (2, 3)}


@pytest.fixture(scope="module")
def moody_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return moody.build(tmp_path_factory.mktemp("moody"))


@pytest.fixture(autouse=True)
def nothing_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """After each test none of the processes is there that it has started, directly or not, and no temporary folder."""
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setenv(MARK, secrets.token_hex(8))
    monkeypatch.setenv("TMPDIR", str(scratch))
    monkeypatch.setattr("tempfile.tempdir", str(scratch))
    monkeypatch.chdir(tmp_path)
    yield
    deadline = time.monotonic() + 10
    while (there := [*started(), *scratch.iterdir()]) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert there == []
