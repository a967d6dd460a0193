"""Native FMUs read defaults and tables from files that may be missing, broken or hostile."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from fmus import library
from fmus.modelling.model import Table
from fmus.packaging.native import build as native
from fmus.packaging.native import compiler
from tests.support.fmus.either import Either, opened
from tests.support.fmus.natives import VERSIONS

Built = Callable[[str, int], Path]

pytestmark = pytest.mark.skipif(not compiler.available(), reason="no C compiler here")


def altered(source: Path, target: Path, **contents: bytes | None) -> Path:
    """A copy of an FMU in which some resources are other, or missing."""
    names = {f"resources/{key.replace('__', '.')}": value for key, value in contents.items()}
    with zipfile.ZipFile(source) as good, zipfile.ZipFile(target, "w") as bad:
        for name in {*good.namelist(), *names}:
            text = names[name] if name in names else good.read(name)
            if text is not None:
                bad.writestr(name, text)
    return target


BROKEN = {
    "missing": (None, "defaults.txt cannot be read"),
    "no number": (b"inertia = heavy\n", "'heavy' is no value for inertia"),
    "two numbers": (b"inertia = 1 2\n", "'1 2' is no value for inertia"),
    "hexadecimal": (b"inertia = 0x1p3\n", "is no value for inertia"),
    "infinite": (b"inertia = 1e999\n", "is no value for inertia"),
    "unknown": (b"inertai = 1.0\n", "'inertai' is no input or parameter"),
    "output": (b"energy = 1.0\n", "'energy' is no input or parameter"),
    "no assignment": (b"inertia\n", "'inertia' is no assignment"),
    "long line": (b"inertia = " + b"1" * 5000, "a line is longer"),
    "many lines": (b"\n" * 200_000, "more than 100000 lines"),
    "binary": (bytes(range(256)) * 10, ""),
}


@pytest.mark.slow
@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("kind", BROKEN)
def test_broken_defaults_stop_the_instantiation_with_the_reason(
    native_fmu: Built, tmp_path: Path, fmi: int, kind: str
) -> None:
    content, reason = BROKEN[kind]
    path = altered(native_fmu("pendulum", fmi), tmp_path / "broken.fmu", defaults__txt=content)
    message = refusal(path)
    assert message.startswith("pendulum: ")
    assert reason in message


def refusal(path: Path) -> str:
    """What an FMU says when it cannot be instantiated."""
    log: list[tuple[int, str, str]] = []
    with pytest.raises(Exception, match=r"[Ii]nstantiate"), opened(path, log=log):
        pass
    [(status, category, message)] = log
    assert (status, category) == (3, "logStatusError")
    return message


@pytest.mark.slow
@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"time,value\n", "has no samples"),
        (b"", "has no samples"),
        (b"time,value\n0,1\n0,2\n", "increase strictly"),
        (b"time,value\n0;1\n", "no pair of numbers"),
        (b"time,value\n0,nan\n", "no pair of numbers"),
    ],
)
def test_broken_tables_stop_the_instantiation_with_the_reason(
    native_fmu: Built, tmp_path: Path, fmi: int, content: bytes, reason: str
) -> None:
    path = altered(native_fmu("excitation", fmi), tmp_path / "broken.fmu", playback__csv=content)
    assert reason in refusal(path)


@pytest.mark.slow
@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_table_that_is_not_there_plays_zeros_and_a_long_one_is_read_whole(
    native_fmu: Built, tmp_path: Path, fmi: int
) -> None:
    with opened(native_fmu("excitation", fmi)) as fmu:
        fmu.start(shape=8)
        assert fmu.get("signal") == [0.0]
    time = tuple(0.001 * k for k in range(5001))
    table = Table("playback", time, tuple(math.sin(t) for t in time))
    path = native.build(library.find("excitation"), tmp_path / "e.fmu", {"shape": 8}, {"playback": table}, fmi=fmi)
    with opened(path) as fmu:
        fmu.start()
        fmu.step(0.0, 4.9995)
        assert fmu.get("signal") == [table(4.9995)]


@pytest.mark.slow
@pytest.mark.parametrize("fmi", VERSIONS)
def test_resources_are_found_below_a_path_with_blanks_percent_signs_and_umlauts(
    native_fmu: Built, tmp_path: Path, fmi: int
) -> None:
    folder = tmp_path / "a b%20c" / "häß"
    folder.mkdir(parents=True)
    with zipfile.ZipFile(native_fmu("pendulum", fmi)) as archive:
        archive.extractall(folder)
    fmu = Either(native_fmu("pendulum", fmi), str(folder), logging=True)
    assert fmu.get("inertia") == [0.00325]
    assert "häß" in fmu.log[0][2]
    fmu.fmu.freeInstance()
