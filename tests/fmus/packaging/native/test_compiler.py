"""Compilers: which one is taken, what they are told, and what is said when they fail."""

from __future__ import annotations

import importlib.util
import logging
import stat
import struct
import zipfile
from pathlib import Path

import pytest

from fmus import library
from fmus.errors import ModelError
from fmus.packaging import targets
from fmus.packaging.native import build as native
from fmus.packaging.native import compiler

HERE = compiler.host() if compiler.available() else next(iter(compiler.PLATFORMS.values()))
SOURCES = {"one.c": "int one(void) { return 1; }\n"}
OTHER = next(machine for machine in compiler.PLATFORMS.values() if machine != HERE)

needs_compiler = pytest.mark.skipif(not compiler.available(), reason="no C compiler here")


def script(folder: Path, text: str) -> str:
    path = folder / "mycc"
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def test_the_compiler_of_the_environment_comes_first(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CC", f"{script(tmp_path, 'exit 0')} -m64")
    assert compiler.command_for(HERE) == (str(tmp_path / "mycc"), "-m64")


def test_a_compiler_of_the_environment_that_is_not_there_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(ModelError, match="CC: names 'no-such-compiler', which is not found"):
        compiler.command_for(HERE)
    assert not compiler.available()
    assert targets.preferred() == "python"


def test_without_any_compiler_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ModelError, match=r"no C compiler found; pip install 'servotwin\[cross\]'"):
        compiler.command_for(HERE)


def test_another_platform_without_ziglang_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ModelError, match=rf"no compiler for {OTHER.name}; pip install 'servotwin\[cross\]'"):
        compiler.command_for(OTHER)


def test_a_platform_that_is_not_known_is_refused_with_those_that_are() -> None:
    with pytest.raises(ModelError, match=r"platform 'amiga': is not known; choose host, all, x86_64-linux"):
        compiler.find(["amiga"])


def test_platforms_are_found_once_each() -> None:
    assert compiler.find(["host", HERE.name, "host"]) == (HERE,)
    assert compiler.find(["all"]) == tuple(compiler.PLATFORMS.values())


@needs_compiler
def test_a_compiler_that_fails_is_quoted_and_its_command_logged(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO), pytest.raises(ModelError) as error:
        compiler.compile_library({"bad.c": "int f(void) { return undeclared; }\n"}, "bad", HERE)
    assert "'undeclared'" in str(error.value).replace("‘", "'").replace("’", "'")
    assert str(error.value).startswith(f"model bad, {HERE.name}: ")
    assert "\n" not in str(error.value)
    assert any("-ffp-contract=off" in message and "bad.c" in message for message in caplog.messages)


def test_a_compiler_that_says_nothing_is_an_error_too(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CC", script(tmp_path, "exit 7"))
    with pytest.raises(ModelError, match="failed: it gave no reason; see its command with -v"):
        compiler.compile_library(SOURCES, "one", HERE)


def test_a_failed_build_leaves_no_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CC", script(tmp_path, "echo 'model.c:1: error: no' >&2; exit 1"))
    with pytest.raises(ModelError, match=r"model.c:1: error: no"):
        native.build(library.find("pendulum"), tmp_path / "p.fmu")
    assert not (tmp_path / "p.fmu").exists()


@needs_compiler
def test_the_same_sources_give_the_same_bytes_and_are_compiled_once(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("SERVOTWIN_CACHE", "off")
    first = compiler.compile_library(SOURCES, "one", HERE)
    compiler._kept.cache_clear()
    assert compiler.compile_library(SOURCES, "one", HERE) == first
    monkeypatch.setattr(compiler, "run", lambda *_: pytest.fail("compiled again"))
    assert compiler.compile_library(SOURCES, "one", HERE) == first


@pytest.mark.slow
@pytest.mark.needs("cross")
@pytest.mark.parametrize("fmi", [2, 3])
def test_one_fmu_holds_the_binaries_of_all_platforms(tmp_path: Path, fmi: int) -> None:
    path = native.build(library.find("pendulum"), tmp_path / "p.fmu", fmi=fmi, platforms=("all",))
    with zipfile.ZipFile(path) as archive:
        found = {name: archive.read(name)[:4] for name in archive.namelist() if name.startswith("binaries/")}
    folders = {(machine.folder2 if fmi == 2 else machine.name) for machine in compiler.PLATFORMS.values()}
    assert {name.split("/")[1] for name in found} == folders
    magic = {".so": b"\x7fELF", ".dll": b"MZ", ".dylib": b"\xca\xfe\xba\xbe" if fmi == 2 else b"\xcf\xfa\xed\xfe"}
    for name, start in found.items():
        assert start.startswith(magic[Path(name).suffix]), name


def test_libraries_of_two_processors_lie_in_one_file_at_whole_pages() -> None:
    parts = {"x86_64-darwin": b"x" * 20_000, "aarch64-darwin": b"a" * 5}
    whole = compiler.universal(parts)
    count, *places = struct.unpack(">4xI 8xII4x 8xII4x", whole[:48])
    assert count == 2
    for (offset, size), part in zip((places[:2], places[2:]), parts.values(), strict=True):
        assert offset % (1 << 14) == 0
        assert whole[offset : offset + size] == part


def test_the_python_packaging_refuses_what_it_cannot_do(tmp_path: Path) -> None:
    model = library.find("pendulum")
    for more in ({"fmi": 3}, {"platforms": ("x86_64-windows",)}):
        with pytest.raises(ValueError, match="use --target native"):
            targets.build(model, tmp_path / "p.fmu", target="python", **more)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="target 'rust': is not known; choose native or python"):
        targets.build(model, tmp_path / "p.fmu", target="rust")
