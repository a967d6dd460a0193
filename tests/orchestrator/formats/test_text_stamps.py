"""Dates and times of day in tables of text, as people write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas
import pytest

from fmus.errors import TraceError
from orchestrator.formats import Layout, read

TIME = np.array([0.0, 0.5, 1.5, 2.0])
SPEED = np.array([1.5, 1234.25, -0.125, 7.0])


def written(folder: Path, text: str) -> Path:
    path = folder / "log.csv"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "stamp",
    [
        "2026-11-28 09:15:{:06.3f}",
        "2026-11-28T09:15:{:06.3f}Z",
        "2026-11-28T10:15:{:06.3f}+01:00",
        "28.11.2026 09:15:{:06.3f}",
        "28-Nov-2026 09:15:{:06.3f}",
        "11/28/2026 9:15:{:06.3f} AM",
        "28/11/2026 09:15:{:06.3f}",
        "20261128T0915{:06.3f}",
        "20261128T1015{:06.3f}+0100",
        "20261128 09:15:{:06.3f}",
    ],
)
def test_dates_become_seconds_and_their_first_is_told(tmp_path: Path, stamp: str) -> None:
    rows = [f"{stamp.format(t)},{v}" for t, v in zip(TIME, SPEED, strict=True)]
    recording = read(written(tmp_path, "\n".join(["Timestamp,speed", *rows])))
    assert recording.trace.time.tolist() == TIME.tolist()
    assert recording.start == pandas.Timestamp("2026-11-28T09:15:00Z").timestamp()
    told = stamp.endswith(("Z", "+01:00", "+0100"))
    assert told or any("taken as UTC" in note for note in recording.notes)


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        ("time,a\n2026-W01-5T09:15:00,1\n2026-W01-5T09:15:01,2\n", "holds text, no times; write them as 2026-01-02T"),
        ("time,a\n2026-002T09:15:00,1\n2026-002T09:15:01,2\n", "holds text, no times; write them as 2026-01-02T"),
        ("time,a\n20260102091500,1\n20260102091501,2\n", "look like dates and times of day; write them as 2026"),
        ("date,time,a\n2026-01-02,091559.5,1\n2026-01-02,091600.5,2\n", "may be hours, minutes and seconds"),
        ("date,time,a\n20260102,091559,1\n20260102,091600,2\n", "may be hours, minutes and seconds"),
    ],
)
def test_times_that_are_written_otherwise_are_refused_with_what_to_write(
    tmp_path: Path, rows: str, problem: str
) -> None:
    with pytest.raises(TraceError, match=problem):
        read(written(tmp_path, rows))


def test_what_is_finer_than_nanoseconds_is_told(tmp_path: Path) -> None:
    recording = read(written(tmp_path, "time,a\n2026-01-02T09:15:00.1234567891,1\n2026-01-02T09:15:00.1234567902,2\n"))
    assert recording.trace.time.tolist() == [0.0, 1e-9] and "its times are cut at nanoseconds" in recording.notes


@pytest.mark.parametrize(("scale", "unit", "digits"), [(1, "ns", 0), (10**9, "s", 9)])
def test_what_a_double_does_not_keep_of_times_since_1970_is_told(
    tmp_path: Path, scale: int, unit: str, digits: int
) -> None:
    stamps = 1767323045123456789 + np.arange(4) * 1_000_037
    told = (f"{n // scale}.{n % scale:0{digits}d}".rstrip(".") if digits else str(n) for n in stamps.tolist())
    path = written(tmp_path, "time,a\n" + "".join(f"{text},{k}\n" for k, text in enumerate(told)))
    recording = read(path, Layout(units={"time": unit}))
    assert np.abs(recording.trace.time - stamps / 1e9).max() < 0.3e-6
    assert "its times have more than 17 digits, of which the last are not kept" in recording.notes


def test_all_digits_of_short_times_are_kept(tmp_path: Path) -> None:
    path = written(tmp_path, "time,a\n0.00012345678901234567,1\n0.00022345678901234567,2\n1e-3,3\n")
    assert read(path).notes == ()


def test_whole_numbers_that_a_double_does_not_tell_apart_are_told(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", time=1767323045123456789 + np.arange(4) * 1_000_037, a=np.arange(4.0))
    notes = read(tmp_path / "a.npz", Layout(units={"time": "ns"})).notes
    assert "its times are kept to 3e-07 s" in notes


@pytest.mark.parametrize(
    ("head", "step", "told"), [("time", 10, True), ("time [ms]", 10, False), ("time", 1, False), ("time", 0.5, False)]
)
def test_times_in_whole_numbers_without_a_unit_are_told_to_be_taken_for_seconds(
    tmp_path: Path, head: str, step: float, told: bool
) -> None:
    (tmp_path / "x.csv").write_text(f"{head},u\n" + "".join(f"{step * k:g},{k}\n" for k in range(30)))
    recording = read(tmp_path / "x.csv")
    assert recording.trace.time[-1] == pytest.approx(29 * step * (1e-3 if "ms" in head else 1))
    assert any("is taken to be in seconds (`units: {time: ms}`)" in note for note in recording.notes) is told
