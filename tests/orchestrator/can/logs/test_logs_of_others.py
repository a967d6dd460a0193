"""Logs as other tools write them: versions, dialects, and logs that were put together."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import can
import pytest
from can.io import MF4Writer

from orchestrator.can import logs
from orchestrator.can.frames import Flag
from tests.support.can.can_samples import TEXT_LOGS, all_of, any_frames, different, latest_difference, rig_frames

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work


@pytest.mark.needs("mf4")
def test_an_mf4_log_of_python_can_is_read(tmp_path: Path) -> None:
    frames = any_frames(60)
    writer = MF4Writer(tmp_path / "a.mf4")
    for message in frames.messages():
        writer.on_message_received(message)
    writer.stop()
    back = all_of(logs.read(tmp_path / "a.mf4"))
    assert different(back, frames) == [] and latest_difference(back, frames) < 1e-5


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


def test_a_frame_that_is_commented_out_of_a_trc_is_none_in_a_long_log_either(tmp_path: Path) -> None:
    lines = [f"{';' * (n == 7)}{n})  {n}.0 Rx 0123 1 {n:02X}\n" for n in range(40)]
    (tmp_path / "a.trc").write_text(";$FILEVERSION=1.1\n" + "".join(lines))
    assert all_of(logs.read(tmp_path / "a.trc")).data[:, 0].tolist() == [n for n in range(40) if n != 7]


def test_candump_prints_bytes_as_binary_digits_and_last_first(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(
        " (1.0)  can0  123   [2]  00000010 11101000\n"
        " (1.1)  can0  123   [1]  00000010\n"
        " (1.2)  can0  123   [3]  03`02`01   '...'\n"
        " (1.3)  can0  123   [2]  11101000`00000010\n"
        " (1.4)  can0  123   [2]  0002 01\n"
    )
    log = logs.read(tmp_path / "a.log")
    frames = all_of(log)
    assert [bytes(row[:length]) for row, length in zip(frames.data, frames.length, strict=True)] == [
        b"\x02\xe8",
        b"\x02",
        b"\x01\x02\x03",
        b"\x02\xe8",
    ]
    assert [damage.line for damage in log.damage] == [5]


def test_a_log_of_canking_is_read_where_its_numbers_are_surely_hexadecimal(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(
        "Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n"
        " 0    0000014B         2  10  FF                              16.570498 R\n"
        " 1    00002102 X       1  60                                  16.572000 T\n"
        " 0    00000065 R       4                                      16.573000 R\n"
        " 0    ErrorFrame                                              16.574000 R\n"
        " 0         331         2  16 255                              16.575000 R\n"
        "Logging stopped\n"
    )
    log = logs.read(tmp_path / "a.txt")
    frames = all_of(log)
    assert frames.time.tolist() == [16.570498, 16.572, 16.573, 16.574] and frames.id.tolist() == [
        0x14B,
        0x2102,
        0x65,
        0,
    ]
    assert frames.flags.tolist() == [0, Flag.EXTENDED | Flag.SENT, Flag.REMOTE, Flag.ERROR | Flag.EXTENDED]
    assert frames.channel.tolist() == [0, 1, 0, 0] and frames.length.tolist() == [2, 1, 4, 0]
    assert frames.data[0, :2].tolist() == [0x10, 0xFF]
    assert [damage.line for damage in log.damage] == [6, 7] and "hexadecimal" in log.damage[0].problem


def test_logs_that_were_put_together_repeat_their_header(tmp_path: Path) -> None:
    for form in TEXT_LOGS:
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


@pytest.mark.parametrize(
    ("head", "start"),
    [
        (";   Start time: 11.09.2002 16:04:58.123\n", "2002-09-11T16:04:58.123"),
        (";$FILEVERSION=1.1\n;   Start time: 24.03.2003 12:52:32.484.1\n", "2003-03-24T12:52:32.484"),
        (
            ";$FILEVERSION=1.1\n;$STARTTIME=45244.0\n;   Start time: 24.03.2003 12:52:32.484\n",
            "2023-11-14T00:00:00.000",
        ),
        (";   Start time: 9/11/2002 16:04:58.123\n", ""),  # of September or of November
        (";   Start time: yesterday\n", ""),
    ],
)
def test_where_a_trc_says_its_start_only_in_words_these_count(tmp_path: Path, head: str, start: str) -> None:
    row = "     1)    10.0  Rx  0100  2  01 02\n" if "1.1" in head else "     1)    10  0100  2  01 02\n"
    (tmp_path / "a.trc").write_text(f"{head};\n{row}")
    log = logs.read(tmp_path / "a.trc")
    begin = datetime.fromisoformat(f"{start}+00:00").timestamp() if start else 0.0
    assert all_of(log).time.tolist() == pytest.approx([begin + 0.01], abs=1e-6)
    assert log.findings.zoneless is bool(start)
    assert len(log.damage) == (not start)


def test_long_frames_of_formats_that_do_not_know_them_are_can_fd(tmp_path: Path) -> None:
    """python-can writes them without saying so."""
    long = can.Message(timestamp=1.0, arbitration_id=1, is_extended_id=False, is_fd=True, data=bytes(range(64)))
    for suffix, writer in ((".csv", can.CSVWriter), (".db", can.SqliteWriter)):
        with writer(tmp_path / f"a{suffix}") as opened:
            opened.on_message_received(long)
        frames = all_of(logs.read(tmp_path / f"a{suffix}"))
        assert frames.flags.tolist() == [Flag.FD] and frames.data[0].tolist() == list(range(64))
