"""Logs of every format come back as they were written, and what a format cannot hold is named."""

from __future__ import annotations

import struct
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from fmus.errors import TraceError
from orchestrator.can import logs
from orchestrator.can.frames import Flag, Frames, from_messages
from orchestrator.can.logs.findings import COARSE
from orchestrator.can.logs.frame_count import FrameCount, moment
from tests.support.can.can_samples import START, all_of, any_frames, different, latest_difference, rig_frames

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work

MF4 = pytest.param(".mf4", marks=pytest.mark.needs("mf4"))
SUFFIXES = [MF4 if form == ".mf4" else form for form in logs.SUFFIXES]
RESOLUTION = {".asc": 1e-6, ".blf": 1e-6, ".csv": 0.0, ".db": 0.0, ".log": 1e-6, ".mf4": 1e-6, ".trc": 1.5e-6}  # [s]
LOSES = {
    ".asc": {"what error frames hold", "that error frames were sent"},
    ".blf": {"that error frames were sent"},
    ".csv": {"CAN FD frames", "that frames were sent", "channels"},
    ".db": {"CAN FD frames", "that frames were sent", "channels"},
    ".log": {"what error frames hold", "that error frames were sent"},
    ".mf4": set(),
    ".trc": {"CAN FD frames", "remote frames", "error frames"},
}


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


NANO = 1.0 + np.arange(40) * (1e-3 + 137e-9)


def test_stamps_in_nanoseconds_are_kept_where_no_date_is_beside_them(tmp_path: Path) -> None:
    logs.write(tmp_path / "a.blf", [replace(rig_frames(20), time=NANO)])
    log = logs.read(tmp_path / "a.blf")
    assert np.abs(all_of(log).time - NANO).max() < 1e-12 and not log.findings.notes


def test_what_a_date_costs_stamps_in_nanoseconds_is_told(tmp_path: Path) -> None:
    """Of BLF (its head has got a date), of ASC, and of candump's; what a live bus gave, in doubles, costs nothing."""
    logs.write(tmp_path / "a.blf", [replace(rig_frames(20), time=NANO)])
    content = bytearray((tmp_path / "a.blf").read_bytes())
    struct.pack_into("<8H", content, 40, 2023, 11, 2, 14, 22, 13, 20, 250)
    (tmp_path / "a.blf").write_bytes(content)
    lines = "date Tue Nov 14 22:13:20.250 2023\nbase hex timestamps absolute\n"
    (tmp_path / "a.asc").write_text(lines + "".join(f" {t:.9f} 1 100 Rx d 1 01\n" for t in NANO))
    (tmp_path / "a.log").write_text("".join(f"(17000000{t + 0.25:012.9f}) can0 100#01\n" for t in NANO))
    for suffix in (".blf", ".asc", ".log"):
        log = logs.read(tmp_path / f"a{suffix}")
        since_first = all_of(log).time - START
        assert 1e-9 < np.abs(since_first - NANO).max() < 0.25e-6 and COARSE in log.findings.notes
    live = replace(rig_frames(20), time=START + NANO)
    logs.write(tmp_path / "live.blf", [live])
    log = logs.read(tmp_path / "live.blf")
    assert np.array_equal(all_of(log).time, live.time) and COARSE not in log.findings.notes
