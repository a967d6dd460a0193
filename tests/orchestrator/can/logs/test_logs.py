"""Logs of every format come back as they were written, what a format cannot hold is named, and damage is located."""

from __future__ import annotations

import sqlite3
import sys
import tracemalloc
from collections import Counter
from contextlib import closing
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from can.io import MF4Writer
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus.errors import TraceError
from orchestrator.can import logs
from orchestrator.can.frames import Flag, Frames, from_messages
from orchestrator.can.logs.frame_count import FrameCount, moment
from orchestrator.can.logs.mf4 import reading as mf4
from tests.support.can.can_samples import all_of, any_frames, different, latest_difference, rig_frames

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work

MF4 = pytest.param(".mf4", marks=pytest.mark.needs("mf4"))
SUFFIXES = [MF4 if form == ".mf4" else form for form in logs.SUFFIXES]
TEXT = (".asc", ".log", ".trc", ".csv")
RESOLUTION = {".asc": 1e-6, ".blf": 1e-6, ".csv": 0.0, ".db": 0.0, ".log": 1e-6, ".mf4": 1e-6, ".trc": 1.5e-6}  # [s]
LOSES = {
    ".asc": {"what error frames hold", "that error frames were sent"},
    ".blf": {"that error frames were sent"},
    ".csv": {"CAN FD frames", "that frames were sent", "channels"},
    ".db": {"CAN FD frames", "that frames were sent", "channels"},
    ".log": {"how many bytes remote frames ask for", "what error frames hold", "that error frames were sent"},
    ".mf4": set(),
    ".trc": {"CAN FD frames", "remote frames", "error frames"},
}
fuzzing = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def holdable(frames: Frames, suffix: str) -> Frames:
    """The frames without what the format cannot hold."""
    error, remote, fd = frames.has(Flag.ERROR), frames.has(Flag.REMOTE), frames.has(Flag.FD)
    flags, length, identifier = frames.flags.copy(), frames.length.copy(), frames.id.copy()
    channel, data = frames.channel.copy(), frames.data.copy()
    if suffix != ".mf4":
        flags[error] &= ~np.uint8(Flag.SENT)
    if suffix == ".asc":
        length[error], data[error] = 0, 0
    if suffix in (".asc", ".log"):
        identifier[error] = 0
        flags[error] |= np.uint8(Flag.EXTENDED)  # python-can's default
    if suffix == ".log":
        length[remote] = 0
    if suffix in (".csv", ".db"):
        flags &= ~np.uint8(Flag.SENT)
        channel[:] = 0
    kept = np.ones(len(frames), bool)
    if suffix in (".csv", ".db", ".trc"):
        kept &= ~fd
    if suffix == ".trc":
        kept &= ~(error | remote)
    return Frames(frames.time, identifier, flags, channel, length, data)[kept]


@pytest.fixture(params=SUFFIXES)
def suffix(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.mark.parametrize("seed", [1, 2])
def test_what_a_format_can_hold_comes_back_and_the_rest_is_counted(tmp_path: Path, suffix: str, seed: int) -> None:
    frames, lost = any_frames(400, seed), Counter[str]()
    path = tmp_path / f"a{suffix}"
    count = logs.write(path, [frames[:150], frames[150:]], lost=lost)
    log = logs.read(path)
    back, expected = all_of(log), holdable(frames, suffix)
    assert different(back, expected) == []
    assert latest_difference(back, expected) <= RESOLUTION[suffix]
    assert set(lost) == LOSES[suffix] and log.damage == [] and log.findings.skipped == 0
    assert count == len(expected) == len(frames) - sum(lost[what] for what in (*LOSES[".trc"],))


def test_what_a_format_cannot_hold_is_refused_unless_it_is_counted(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    if LOSES[suffix]:
        with pytest.raises(TraceError, match="the format does not hold"):
            logs.write(path, [any_frames(400)])
        assert list(tmp_path.iterdir()) == []
    frames = rig_frames(50)
    assert logs.write(path, [frames]) == 100
    assert different(all_of(logs.read(path)), frames) == []


def test_stamps_that_are_no_dates_come_back(tmp_path: Path, suffix: str) -> None:
    frames = rig_frames(50, start=5.5)
    path = tmp_path / f"a{suffix}"
    logs.write(path, [frames])
    assert latest_difference(all_of(logs.read(path)), frames) <= RESOLUTION[suffix] + 1e-9


def test_stamps_before_the_first_are_kept_or_counted(tmp_path: Path, suffix: str) -> None:
    frames = rig_frames(3)
    backwards = frames[np.array([2, 3, 0, 1, 4, 5])]
    lost = Counter[str]()
    logs.write(tmp_path / f"a{suffix}", [backwards], lost=lost)
    back = all_of(logs.read(tmp_path / f"a{suffix}"))
    if suffix in (".csv", ".db", ".trc"):
        assert not lost and latest_difference(back, backwards) <= RESOLUTION[suffix]
    elif suffix == ".mf4":
        assert not lost and np.ptp(back.time) == pytest.approx(np.ptp(frames.time), abs=1e-6)
    else:
        assert lost == {"stamps before the first frame's": 2}
        assert back.time.min() == pytest.approx(backwards.time[0], abs=1e-3)


@pytest.mark.parametrize("milliseconds", [0, 7, 70, 700, 999])
def test_an_asc_log_keeps_the_time_of_day_to_the_millisecond(tmp_path: Path, milliseconds: int) -> None:
    frames = rig_frames(2, start=1_700_000_000 + milliseconds / 1000)
    logs.write(tmp_path / "a.asc", [frames])
    assert latest_difference(all_of(logs.read(tmp_path / "a.asc")), frames) <= 1e-3


def test_an_empty_log_is_written_and_read(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    assert logs.write(path, []) == 0
    if path.stat().st_size:
        assert len(all_of(logs.read(path))) == 0
    else:
        with pytest.raises(TraceError, match="is empty"):
            logs.read(path)


@pytest.mark.parametrize("form", [MF4, ".db", ".blf"])
def test_python_can_reads_what_is_written_here(tmp_path: Path, form: str) -> None:
    frames = any_frames(100, fd=False)
    path = tmp_path / f"a{form}"
    logs.write(path, [frames], lost=Counter())
    with can.LogReader(path) as opened:
        theirs = from_messages(opened)
    expected = holdable(frames, form)
    assert len(theirs) == len(expected) and np.array_equal(theirs.id, expected.id)
    assert np.array_equal(theirs.data[:, :8], expected.data[:, :8])


@pytest.mark.needs("mf4")
def test_an_mf4_log_of_python_can_is_read(tmp_path: Path) -> None:
    frames = any_frames(60)
    writer = MF4Writer(tmp_path / "a.mf4")
    for message in frames.messages():
        writer.on_message_received(message)
    writer.stop()
    back = all_of(logs.read(tmp_path / "a.mf4"))
    assert different(back, frames) == [] and latest_difference(back, frames) < 1e-5


def test_without_asammdf_an_mf4_log_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.mf4").write_bytes(b"MDF     4.10 CAN_DataFrame")
    monkeypatch.setitem(sys.modules, "asammdf", None)
    for work in (lambda: all_of(logs.read(tmp_path / "a.mf4")), lambda: logs.write(tmp_path / "b.mf4", [])):
        with pytest.raises(TraceError, match=r"pip install servotwin\[mf4\]"):
            work()


def test_files_that_are_no_logs_are_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    with pytest.raises(TraceError, match="no such file"):
        logs.read(path)
    path.write_bytes(b"")
    with pytest.raises(TraceError, match="is empty"):
        logs.read(path)
    path.write_bytes(b"this is\nno log\n" * 20)
    with pytest.raises(TraceError, match=r"no frame that can be read|no readable|no log of CAN frames"):
        all_of(logs.read(path))
    (tmp_path / f"folder{suffix}").mkdir()
    with pytest.raises(TraceError, match="is a folder"):
        logs.read(tmp_path / f"folder{suffix}")


def test_unknown_formats_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("x")
    with pytest.raises(TraceError, match=r"use .asc, .blf"):
        logs.read(tmp_path / "a.xyz")
    with pytest.raises(TraceError, match=r"use .asc, .blf"):
        logs.write(tmp_path / "b.xyz", [])


def test_only_a_csv_with_columns_of_frames_is_a_log(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("time [s],angle [rad]\n0,1\n1,2\n")
    logs.write(tmp_path / "b.csv", [rig_frames(2)])
    assert not logs.is_log(tmp_path / "a.csv") and logs.is_log(tmp_path / "b.csv")
    assert not logs.is_log(tmp_path / "none.csv") and logs.is_log(tmp_path / "none.BLF")
    with pytest.raises(TraceError, match="first lines are those of no format"):
        logs.read(tmp_path / "a.csv")


@pytest.mark.parametrize("form", TEXT)
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


@pytest.mark.parametrize("form", TEXT)
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


@pytest.mark.parametrize("form", TEXT)
def test_a_cut_last_line_is_said(tmp_path: Path, form: str) -> None:
    path = tmp_path / f"a{form}"
    logs.write(path, [rig_frames(5)])
    lines = path.read_bytes().splitlines(keepends=True)
    last = lines[-2 if form == ".asc" else -1]
    path.write_bytes(b"".join(lines[: lines.index(last)]) + last[:-4])
    log = logs.read(path)
    assert len(all_of(log)) in (9, 10) and "may be cut" in log.damage[0].problem


def test_an_asc_log_without_the_line_on_internal_events_loses_no_frame(tmp_path: Path) -> None:
    """python-can takes the first line behind its header for one."""
    lines = "date Tue Nov 14 22:13:20.250 2023\nbase hex timestamps absolute\n// version 9\n"
    lines += "".join(f" {n}.5 1 10{n} Rx d 2 01 02\n" for n in range(3)) + " 4.0 1 Statistic: D 0 R 0\n"
    (tmp_path / "a.asc").write_text(lines)
    log = logs.read(tmp_path / "a.asc")
    frames = all_of(log)
    assert frames.id.tolist() == [0x100, 0x101, 0x102] and log.findings.skipped == 1 and not log.damage


def test_an_asc_log_with_a_date_that_cannot_be_read_keeps_its_frames(tmp_path: Path) -> None:
    lines = "date Xyz 99 foo\nbase hex timestamps absolute\ninternal events logged\n 1.5 1 100 Rx d 1 01\n"
    (tmp_path / "a.asc").write_text(lines)
    log = logs.read(tmp_path / "a.asc")
    assert all_of(log).time.tolist() == [1.5] and log.damage[0].line == 1


def test_candump_tells_channels_and_every_error_frame(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(
        "(1.5) can2 20000004#0008000000000000\n(1.6) vcan1 123#R\n(1.7) slcan 12345678##1AB\n"
    )
    frames = all_of(logs.read(tmp_path / "a.log"))
    assert frames.channel.tolist() == [2, 1, 0]
    assert frames.has(Flag.ERROR).tolist() == [True, False, False]
    assert frames.flags[2] == Flag.EXTENDED | Flag.FD | Flag.BITRATE_SWITCH


def test_logs_that_were_put_together_repeat_their_header(tmp_path: Path) -> None:
    for form in TEXT:
        path = tmp_path / f"a{form}"
        logs.write(path, [rig_frames(5)])
        path.write_bytes(path.read_bytes() * 2)
        log = logs.read(path)
        assert len(all_of(log)) == 20 and not log.damage


@pytest.mark.parametrize("version", ["1.0", "1.1", "1.3"])
def test_earlier_versions_of_trc_are_read(tmp_path: Path, version: str) -> None:
    rows = {
        "1.0": "     1)    10 0100 2 01 02\n     2)    20 FFFFFFFF 4 00 00 00 08\n",
        "1.1": "     1)        10.0  Rx        0100  2  01 02\n     2)  20.0 Warng FFFFFFFF  4  00 00 00 08\n",
        "1.3": "     1)        10.0 2  Rx        0100 -  2    01 02\n     2)  20.0 1 Warng FFFFFFFF - 4  00 00 00 08\n",
    }[version]
    (tmp_path / "a.trc").write_text(f";$FILEVERSION={version}\n;$STARTTIME=45244.0\n;\n{rows}")
    log = logs.read(tmp_path / "a.trc")
    frames = all_of(log)
    assert (frames.id.tolist(), frames.channel.tolist()) == ([0x100], [1 if version == "1.3" else 0])
    assert log.findings.skipped == 1 and not log.damage


def test_long_frames_of_formats_that_do_not_know_them_are_can_fd(tmp_path: Path) -> None:
    """python-can writes them without saying so."""
    long = can.Message(timestamp=1.0, arbitration_id=1, is_extended_id=False, is_fd=True, data=bytes(range(64)))
    for suffix, writer in ((".csv", can.CSVWriter), (".db", can.SqliteWriter)):
        with writer(tmp_path / f"a{suffix}") as opened:
            opened.on_message_received(long)
        frames = all_of(logs.read(tmp_path / f"a{suffix}"))
        assert frames.flags.tolist() == [Flag.FD] and frames.data[0].tolist() == list(range(64))


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


def test_a_log_is_there_as_a_whole_or_not_at_all(tmp_path: Path, suffix: str) -> None:
    def failing() -> Any:
        yield rig_frames(10)
        raise RuntimeError("unplugged")

    (tmp_path / f"a{suffix}").write_bytes(b"before")
    with pytest.raises(RuntimeError):
        logs.write(tmp_path / f"a{suffix}", failing())
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [b"before"]


@pytest.mark.parametrize("form", [".asc", ".blf", ".trc", MF4])
def test_stamps_that_are_no_dates_at_all_are_refused(tmp_path: Path, form: str) -> None:
    with pytest.raises(TraceError, match="cannot hold these time stamps"):
        logs.write(tmp_path / f"a{form}", [rig_frames(1, start=1e14)])


def test_progress_rises_to_one(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    logs.write(path, [rig_frames(9_000)])
    told: list[float] = []
    doing: set[str] = set()

    def tell(fraction: float, words: str) -> None:
        told.append(fraction)
        doing.add(words)

    all_of(logs.read(path, tell))
    assert told == sorted(told) and told[-1] == 1.0 and len(told) > 1
    assert doing == {f"reading a{suffix}"}


def test_a_frame_count_has_identifiers_and_their_periods() -> None:
    frame_count = FrameCount()
    frames = rig_frames(1000)
    for first in range(0, 2000, 300):
        frame_count.feed(frames[first : first + 300])
    document = frame_count.document()
    assert document["frames"] == 2000 and document["start"] == "2023-11-14T22:13:20.250Z"
    assert document["identifiers"] == [
        {"id": "100", "frames": 1000, "period": pytest.approx(1e-3)},
        {"id": "101", "frames": 1000, "period": pytest.approx(1e-3)},
    ]
    assert moment(12.5) == "12.5 s" and moment(1e300) == "1e+300 s"


def written(folder: Path, form: str) -> bytearray:
    """A whole log of 60 frames of all kinds that the format holds."""
    path = folder / f"whole{form}"
    if not path.exists():
        logs.write(path, [any_frames(60, fd=form in (".asc", ".log", ".mf4"))], lost=Counter())
    return bytearray(path.read_bytes())


@pytest.mark.parametrize("form", [*TEXT, ".db"])
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


@pytest.mark.parametrize("form", [*TEXT, ".db", ".blf"])
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
