"""Logs that are damaged, cut, changed at random or no logs at all: what is left is read, and the place is said."""

from __future__ import annotations

import gzip
import sqlite3
import tracemalloc
from collections import Counter
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus.errors import TraceError
from orchestrator.can import logs
from orchestrator.can.frames import Flag
from orchestrator.can.logs.mf4 import reading as mf4
from tests.support.can.can_samples import TEXT_LOGS, all_of, any_frames, rig_frames

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work

fuzzing = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.mark.parametrize("form", TEXT_LOGS)
def test_a_broken_line_is_located_and_costs_no_other(tmp_path: Path, form: str) -> None:
    frames = rig_frames(20)
    path = tmp_path / f"a{form}"
    logs.write(path, [frames])
    lines = path.read_bytes().splitlines(keepends=True)
    place = len(lines) - 10
    lines[place] = lines[place][: len(lines[place]) // 2] + b"?&\xff zz\n"
    path.write_bytes(b"".join(lines))
    log = logs.read(path)
    back = all_of(log)
    missing = set(np.round(frames.time * 1e4).tolist()) - set(np.round(back.time * 1e4).tolist())
    assert len(back) == 39 and len(missing) in (1, 2)  # rounding
    assert [(damage.offset, damage.line) for damage in log.damage] == [(len(b"".join(lines[:place])), place + 1)]


@pytest.mark.parametrize("form", TEXT_LOGS)
def test_a_packed_log_that_is_cut_begins_as_the_whole_one_does(tmp_path: Path, form: str) -> None:
    logs.write(tmp_path / f"a{form}", [rig_frames(200)])
    whole = all_of(logs.read(tmp_path / f"a{form}"))
    packed = gzip.compress((tmp_path / f"a{form}").read_bytes())
    (tmp_path / f"b{form}.gz").write_bytes(packed[: len(packed) * 2 // 3])
    log = logs.read(tmp_path / f"b{form}.gz")
    left = all_of(log)
    assert 50 < len(left) < len(whole)
    assert left.time.tolist() == whole.time[: len(left)].tolist()
    assert left.id.tolist() == whole.id[: len(left)].tolist()
    assert "cannot be unpacked from about here on" in str(log.damage[0])
    assert not any("no time stamps" in line for line in log.findings.lines())


@pytest.mark.parametrize("form", TEXT_LOGS)
def test_a_line_without_end_is_passed_over_in_bounded_memory(tmp_path: Path, form: str) -> None:
    path = tmp_path / f"a{form}"
    logs.write(path, [rig_frames(5)])
    content = path.read_bytes()
    with path.open("ab") as file:
        for _ in range(30):
            file.write(b"0" * (1 << 20))
        file.write(b"\n")
    tracemalloc.start()
    log = logs.read(path)
    assert len(all_of(log)) == 10
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 4 << 20
    assert [damage.offset for damage in log.damage] == [len(content)] and "bytes is no frame" in log.damage[0].problem


@pytest.mark.parametrize("form", TEXT_LOGS)
def test_a_cut_last_line_is_said(tmp_path: Path, form: str) -> None:
    path = tmp_path / f"a{form}"
    logs.write(path, [rig_frames(5)])
    lines = path.read_bytes().splitlines(keepends=True)
    last = lines[-2 if form == ".asc" else -1]
    path.write_bytes(b"".join(lines[: lines.index(last)]) + last[:-4])
    log = logs.read(path)
    assert len(all_of(log)) in (9, 10) and "may be cut" in log.damage[0].problem


def test_a_damaged_database_gives_the_rows_that_can_be_read(tmp_path: Path) -> None:
    frames = rig_frames(5000)
    path = tmp_path / "a.db"
    logs.write(path, [frames])
    content = bytearray(path.read_bytes())
    page = 4096 * (len(content) // 4096 // 2)
    content[page : page + 4096] = b"\xa5" * 4096
    path.write_bytes(content)
    log = logs.read(path)
    back = all_of(log)
    assert 9000 < len(back) < 10_000 and np.isin(back.time, frames.time).all()
    assert log.damage and "row " in str(log.damage[0])


def test_a_database_with_odd_values_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    path = tmp_path / "a.db"
    logs.write(path, [rig_frames(1)])
    odd = [
        ("x", 1, 0, 0, 0, 0, b""),
        (1.0, 1 << 40, 0, 0, 0, 0, b""),
        (None, 1, 0, 0, 0, 0, b""),
        (1.0, 1, 0, 0, 0, 9, b"123456789" * 9),
        (1.0, 1, 0, 0, 0, 3, "abc"),
    ]
    with closing(sqlite3.connect(path)) as database, database:
        database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?, ?, ?, ?)", odd)
    log = logs.read(path)
    assert len(all_of(log)) == 2 and [damage.line for damage in log.damage] == [3, 4, 5, 6, 7]


def test_a_database_that_computes_is_not_asked(tmp_path: Path) -> None:
    """A view can run for ever."""
    with closing(sqlite3.connect(tmp_path / "a.db")) as database, database:
        database.execute(
            "CREATE VIEW messages AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x+1 FROM c) "
            "SELECT x AS ts, 1, 0, 0, 0, 0, x'00' FROM c"
        )
    with pytest.raises(TraceError, match="no table 'messages'"):
        all_of(logs.read(tmp_path / "a.db"))


def written(folder: Path, form: str) -> bytearray:
    """A whole log of 60 frames of all kinds that the format holds."""
    path = folder / f"whole{form}"
    if not path.exists():
        logs.write(path, [any_frames(60, fd=form in (".asc", ".log", ".mf4"))], lost=Counter())
    return bytearray(path.read_bytes())


@pytest.mark.parametrize("form", [*TEXT_LOGS, ".db"])
@fuzzing
@given(
    changes=st.lists(st.tuples(st.integers(0, 10**6), st.binary(min_size=1, max_size=6)), min_size=1, max_size=12),
    cut=st.integers(0, 3000),
)
def test_reading_a_changed_log_ends_with_frames_or_a_message(
    tmp_path: Path, form: str, changes: list[tuple[int, bytes]], cut: int
) -> None:
    content = written(tmp_path, form)
    for number, new in changes:
        place = number % len(content)
        content[place : place + len(new)] = new
    path = tmp_path / f"a{form}"
    path.write_bytes(bytes(content[: max(1, len(content) - cut)]))
    check(path)


@pytest.mark.parametrize("form", [*TEXT_LOGS, ".db", ".blf"])
@fuzzing
@given(content=st.binary(min_size=1, max_size=400) | st.text(min_size=1, max_size=400).map(str.encode))
def test_reading_anything_ends_with_frames_or_a_message(tmp_path: Path, form: str, content: bytes) -> None:
    path = tmp_path / f"a{form}"
    path.write_bytes(content)
    check(path)
    head = {".csv": b"timestamp,arbitration_id,extended,remote,error,dlc,data\n", ".trc": b";$FILEVERSION=2.1\n"}
    path.write_bytes(head.get(form, b"") + content)
    check(path)


@pytest.mark.needs("mf4")
@pytest.mark.parametrize("seed", range(4))
def test_reading_a_changed_mf4_log_ends_with_frames_or_a_message(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    content = written(tmp_path, ".mf4")
    for place in rng.integers(0, len(content), 1 + 5 * (seed % 2)):
        content[place : place + 8] = rng.bytes(8)
    path = tmp_path / "a.mf4"
    path.write_bytes(bytes(content[: len(content) - (0, 0, 500, 5000)[seed]]))
    check(path)


@pytest.mark.needs("mf4")
@pytest.mark.parametrize(
    ("does", "patience", "problem"),
    [("os._exit(1)", 300.0, "broke down"), ("time.sleep(300)", 0.3, "gave no answer")],
)
def test_an_mf4_log_on_which_asammdf_dies_or_hangs_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, does: str, patience: float, problem: str
) -> None:
    (tmp_path / "a.mf4").write_bytes(b"MDF     4.10 CAN_DataFrame")
    monkeypatch.setattr(mf4, "_BOOT", f"import os, time; {does}")
    monkeypatch.setattr(mf4, "PATIENCE", patience)
    with pytest.raises(TraceError, match=f"no frame that can be read .*{problem}"):
        all_of(logs.read(tmp_path / "a.mf4"))


def check(path: Path) -> None:
    """Reading gives frames as they can be, or says in one line what is wrong."""
    try:
        frames = all_of(logs.read(path))
    except TraceError as error:
        assert "\n" not in str(error) and str(path) in str(error)
        return
    assert np.isfinite(frames.time).all()
    assert (frames.id < np.where(frames.has(Flag.EXTENDED), 1 << 29, 1 << 11)).all() or path.suffix in (".mf4", ".blf")
