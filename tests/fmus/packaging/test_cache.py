"""The cache of built FMUs: never stale, never half there, never larger than allowed, and never in the way."""

from __future__ import annotations

import logging
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fmus import library
from fmus.modelling.model import Model, Table
from fmus.packaging import cache, targets
from fmus.packaging.cache import Cache
from fmus.packaging.native import compiler, sources
from fmus.packaging.native.network import Network

needs_compiler = pytest.mark.skipif(not compiler.available(), reason="no C compiler here")
EXCITATION = library.find("excitation")
KEY, OTHER, THIRD = (letter * 64 for letter in "abc")
PLAYED = Table("playback", (0.0, 1.0), (0.0, 2.0))
BUILD = """
import sys
from fmus.packaging import targets
targets.build(sys.argv[1], sys.argv[2], target=sys.argv[3])
print("sympy" in sys.modules)
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of this test alone."""
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path / "cache"))
    cache._complain.cache_clear()
    return tmp_path / "cache"


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The packagings that have really been at work."""
    done: list[str] = []
    build = targets._Order.build

    def counting(order: Any, path: Path) -> Path:
        done.append(order.target)
        return build(order, path)

    monkeypatch.setattr(targets._Order, "build", counting)
    return done


def in_another_process(model: str, path: Path, target: str, **environment: str) -> bool:
    """Build there; whether SymPy was loaded for it."""
    done = subprocess.run(
        [sys.executable, "-c", BUILD, model, path, target],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip() == "True"


def test_what_is_there_is_handed_out_without_sympy(tmp_path: Path) -> None:
    assert in_another_process("pendulum", tmp_path / "first.fmu", "python")
    assert not in_another_process("pendulum", tmp_path / "again.fmu", "python")
    assert (tmp_path / "first.fmu").read_bytes() == (tmp_path / "again.fmu").read_bytes()


@pytest.mark.slow
@needs_compiler
def test_what_is_there_is_handed_out_without_compiler(tmp_path: Path) -> None:
    log = tmp_path / "calls"
    script = tmp_path / "mycc"
    script.write_text(
        f'#!/bin/sh\necho called >> {log}\nexec {shutil.which(compiler.command_for(compiler.host())[0])} "$@"\n'
    )
    script.chmod(0o755)
    assert in_another_process("pendulum", tmp_path / "first.fmu", "native", CC=str(script))
    assert log.read_text() == "called\n"
    assert not in_another_process("pendulum", tmp_path / "again.fmu", "native", CC=str(script))
    assert log.read_text() == "called\n"
    assert (tmp_path / "first.fmu").read_bytes() == (tmp_path / "again.fmu").read_bytes()


@pytest.mark.slow
@needs_compiler
def test_other_values_of_one_model_are_compiled_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SERVOTWIN_CACHE", str(tmp_path / "cache"))
    compiler._kept.cache_clear()
    targets.build(EXCITATION, tmp_path / "a.fmu", target="native")
    compiler._kept.cache_clear()
    monkeypatch.setattr(compiler, "run", lambda *_: pytest.fail("compiled again"))
    targets.build(EXCITATION, tmp_path / "b.fmu", target="native", parameters={"seed": 5}, tables={"playback": PLAYED})
    assert (tmp_path / "a.fmu").read_bytes() != (tmp_path / "b.fmu").read_bytes()


def test_anything_else_asked_for_is_built(tmp_path: Path, built: list[str]) -> None:
    """One order after the other, and each again: the second one comes from the cache."""
    doubled = Table("playback", (0.0, 1.0), (0.0, 4.0))
    orders: list[dict[str, Any]] = [
        {},
        {"parameters": {"seed": 2}},
        {"parameters": {"seed": 2, "offset": 1.0}},
        {"tables": {"playback": PLAYED}},
        {"tables": {"playback": doubled}},
    ]
    contents = []
    for order in orders:
        for name in ("first.fmu", "again.fmu"):
            targets.build(EXCITATION, tmp_path / name, target="python", **order)
        contents.append((tmp_path / "first.fmu").read_bytes())
        assert (tmp_path / "again.fmu").read_bytes() == contents[-1]
    assert len(built) == len(orders) == len({*contents})


def test_a_value_that_is_the_default_is_no_other_order(tmp_path: Path, built: list[str]) -> None:
    targets.build(EXCITATION, tmp_path / "a.fmu", target="python")
    targets.build(EXCITATION, tmp_path / "b.fmu", target="python", parameters={"seed": 1, "offset": 0})
    assert built == ["python"]


def test_an_edited_model_file_is_built_again(tmp_path: Path, built: list[str]) -> None:
    """Edited within one tick of a file system's clock, and to the same length."""
    text = Path(str(library.source_file(EXCITATION))).read_text()
    for gain, path in (("0.5", "a.fmu"), ("0.7", "b.fmu"), ("0.7", "c.fmu"), ("0.5", "d.fmu")):
        (tmp_path / "source.py").write_text(text.replace("offset + p.amplitude", f"offset + {gain} * p.amplitude"))
        os.utime(tmp_path / "source.py", (1e9, 1e9))
        targets.build(tmp_path / "source.py", tmp_path / path, target="python")
    a, b, c, d = ((tmp_path / f"{name}.fmu").read_bytes() for name in "abcd")
    assert a == d != b == c
    assert built == ["python", "python"]


BUS = Network("lines", (), b"")


def key(model: Model = EXCITATION, **changes: Any) -> str | None:
    order = {"target": "native", "fmi": 2, "parameters": {}, "tables": {}, "platforms": ("host",)} | changes
    return targets._Order(model, **order).key()


@needs_compiler
def test_whatever_a_native_fmu_is_made_of_is_in_its_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = shutil.which(compiler.command_for(compiler.host())[0])
    assert found is not None
    wrapper = tmp_path / "mycc"
    wrapper.write_text(f'#!/bin/sh\nexec {found} "$@"\n')
    wrapper.chmod(0o755)
    texts = sources.fixed(2)
    monkeypatch.setattr(targets, "_fixed", targets._fixed.__wrapped__)  # which a process asks once
    keys = {"as it is": key(), "FMI": key(fmi=3), "packaging": key(target="python"), "model": key(library.find("pd"))}
    keys |= {"bus": key(fmi=3, network=BUS), "database": key(fmi=3, network=replace(BUS, database=b" "))}
    changes: dict[str, Callable[[pytest.MonkeyPatch], None]] = {
        "flags": lambda here: here.setattr(compiler, "FLAGS", (*compiler.FLAGS, "-O1")),
        "compiler": lambda here: here.setenv("CC", str(wrapper)),
        "a flag of the command": lambda here: here.setenv("CC", f"{wrapper} -m64"),
        "a folder of headers": lambda here: here.setenv("CPATH", str(tmp_path)),
        "runtime": lambda here: here.setattr(sources, "fixed", lambda *_: texts | {"ops.c": texts["ops.c"] + "\n"}),
        "SymPy": lambda here: here.setattr(targets, "version", lambda name: f"{name} 0.1"),
        "Python": lambda here: here.setattr(sys, "version", "4.0"),
    }
    for name, change in changes.items():
        with monkeypatch.context() as here:
            change(here)
            keys[name] = key()
    monkeypatch.setenv("CC", str(wrapper))
    wrapper.write_text(f'#!/bin/sh\nexec {found} -g "$@"\n')
    keys["another compiler of that name"] = key()
    assert None not in keys.values()
    assert len({*keys.values()}) == len(keys), keys


def test_the_code_that_writes_fmus_is_in_the_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = tmp_path / "fmus"
    shutil.copytree(targets._ROOT, root, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(targets, "_ROOT", root)
    monkeypatch.setattr(targets, "_BEGAN", float("inf"))
    keys = [key(target="python")]
    for name in ("modelling/ops.py", "packaging/python/slave.py", "packaging/native/c/ops.h", "models/__init__.py"):
        (root / name).write_text((root / name).read_text() + "\n")
        keys.append(key(target="python"))
    (root / "models" / "controllers" / "pd.py").write_text("")  # a model is what is in memory
    assert key(target="python") == keys[-1]
    assert len({*keys}) == 5


def test_nothing_is_kept_once_the_code_has_changed_under_a_running_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, built: list[str], folder: Path
) -> None:
    monkeypatch.setattr(targets, "_BEGAN", 0.0)
    for name in ("a.fmu", "b.fmu"):
        targets.build(EXCITATION, tmp_path / name, target="python")
    assert built == ["python", "python"]
    assert not folder.exists()


def test_a_model_that_holds_an_object_is_built_each_time(tmp_path: Path, built: list[str]) -> None:
    class Gain:
        value = 2.0

    gain = Gain()
    model = Model(
        "scaled", "Scaled", EXCITATION.of("output"), outputs=lambda t, x, u, p: {"signal": gain.value * t}, call="MODEL"
    )
    for gain.value in (2.0, 3.0):
        assert key(model) is None
        targets.build(model, tmp_path / "s.fmu", target="python")
    assert built == ["python", "python"]


@pytest.mark.parametrize("off", ["", "off"])
def test_it_can_be_switched_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, built: list[str], off: str) -> None:
    monkeypatch.setenv(cache.VARIABLE, off)
    for name in ("a.fmu", "b.fmu"):
        targets.build(EXCITATION, tmp_path / name, target="python")
    assert built == ["python", "python"]
    assert cache.current() is None


def test_without_a_name_it_lies_where_the_system_has_caches(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(cache.VARIABLE)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    found = cache.current()
    assert found is not None
    if sys.platform == "linux":
        assert found.folder == tmp_path / "servotwin" / "built"


@pytest.mark.parametrize("damage", [lambda b: b[:-1], lambda b: b"", lambda b: b[:50] + bytes([b[50] ^ 1]) + b[51:]])
def test_a_damaged_entry_is_built_again(
    tmp_path: Path, folder: Path, built: list[str], damage: Callable[[bytes], bytes]
) -> None:
    targets.build(EXCITATION, tmp_path / "a.fmu", target="python")
    [entry] = folder.iterdir()
    whole = entry.read_bytes()
    entry.write_bytes(damage(whole))
    targets.build(EXCITATION, tmp_path / "b.fmu", target="python")
    assert (tmp_path / "a.fmu").read_bytes() == (tmp_path / "b.fmu").read_bytes()
    assert built == ["python", "python"]
    assert entry.read_bytes() == whole


@pytest.mark.skipif(os.name != "posix", reason="processes are killed by signals of POSIX")
def test_what_a_killed_process_left_is_neither_used_nor_kept_for_ever(folder: Path) -> None:
    """Killed with half of the entry on the disk, before it has its name."""
    code = """
import os, signal, sys
from fmus import files
from fmus.packaging import cache
def half(path, content, for_good):
    path.write_bytes(content[: len(content) // 2])
    os.kill(os.getpid(), signal.SIGKILL)
files._write = half
cache.current().put(sys.argv[1], b"x" * 1000)
"""
    done = subprocess.run([sys.executable, "-c", code, KEY], check=False)
    assert done.returncode == -signal.SIGKILL
    [part] = folder.iterdir()
    kept = Cache(folder)
    assert kept.get(KEY) is None
    assert kept.entries() == []
    kept.put(KEY, b"whole")
    assert kept.get(KEY) == b"whole"
    assert part.exists()  # another process may be writing it
    os.utime(part, (1e9, 1e9))
    kept.put(OTHER, b"other")
    assert not part.exists()


def test_processes_that_build_the_same_at_once_leave_one_entry(tmp_path: Path, folder: Path) -> None:
    commands = [[sys.executable, "-c", BUILD, "pd", tmp_path / f"{i}.fmu", "python"] for i in range(2)]
    running = [subprocess.Popen(command) for command in commands]
    assert [process.wait() for process in running] == [0, 0]
    contents = {(tmp_path / f"{i}.fmu").read_bytes() for i in range(2)}
    assert len(contents) == len(list(folder.iterdir())) == 1


def test_those_entries_go_first_that_were_not_used_for_longest(tmp_path: Path) -> None:
    kept = Cache(tmp_path, largest=2 * (32 + 100))
    for number, name in enumerate((KEY, OTHER)):
        kept.put(name, bytes(100))
        os.utime(kept._path(name), (number, number))
    assert kept.get(KEY) == bytes(100)
    kept.put(THIRD, bytes(100))
    assert kept.get(OTHER) is None
    assert kept.get(KEY) == kept.get(THIRD) == bytes(100)
    kept.put(OTHER, bytes(1000))
    assert kept.get(OTHER) is None
    assert sum(entry.size for entry in kept.entries()) <= kept.largest


def test_a_folder_that_cannot_be_written_is_said_once_and_no_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, built: list[str]
) -> None:
    (tmp_path / "file").write_text("in the way")  # root may write wherever permissions say no
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path / "file" / "cache"))
    with caplog.at_level(logging.WARNING):
        for name in ("a.fmu", "b.fmu"):
            targets.build(EXCITATION, tmp_path / name, target="python")
    assert (tmp_path / "a.fmu").read_bytes() == (tmp_path / "b.fmu").read_bytes()
    assert built == ["python", "python"]
    [record] = caplog.records
    assert "FMUs are built anew each time, unless SERVOTWIN_CACHE names another folder" in record.getMessage()


def test_a_folder_that_cannot_be_listed_is_empty(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    for place in (tmp_path / "file", tmp_path / "nothing"):
        assert Cache(place).entries() == []
        assert Cache(place).clear() == 0
        assert Cache(place).get(KEY) is None


def test_clearing_leaves_other_files_alone(tmp_path: Path) -> None:
    kept = Cache(tmp_path)
    kept.put(KEY, b"x")
    mine = tmp_path / "mine.built"
    mine.write_text("x")
    assert kept.clear() == 1
    assert list(tmp_path.iterdir()) == [mine]
