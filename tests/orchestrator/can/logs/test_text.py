"""Text logs of many tools: many lines at once give what each gives on its own, and what python-can makes of them."""

from __future__ import annotations

import gzip
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from fmus.errors import TraceError
from orchestrator import formats
from orchestrator.can import logs
from orchestrator.can.frames import Flag, Frames, from_messages, since
from orchestrator.can.logs.text import reading
from orchestrator.can.logs.text.dates import moment
from tests.support.can.can_samples import all_of, different, messages, rig_frames
from tests.support.can.text_logs import BUSMASTER, KINDS, text_of

quick = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])

WRITERS = {".asc": can.ASCWriter, ".csv": can.CSVWriter, ".log": can.CanutilsLogWriter, ".trc": can.TRCWriter}
READERS = {".asc": can.ASCReader, ".csv": can.CSVReader, ".log": can.CanutilsLogReader, ".trc": can.TRCReader}


def both_ways(path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[tuple[Frames, list[str]], tuple[Frames, list[str]]]:
    """The frames and what was told: with as many lines at once as there are, and line by line."""
    results = []
    for few in (0, 1 << 30):
        monkeypatch.setattr(reading, "FEW", few)
        log = logs.read(path)
        try:
            frames = all_of(log)
        except TraceError as error:
            frames = from_messages(())
            assert "\n" not in str(error)
        results.append((frames, [*map(str, log.damage), *log.findings.lines()]))
    return results[0], results[1]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@quick
@example(choices=[0, 1, 1], changes=[(331, b"\0")])
@example(choices=[0], changes=[(0, b"\x01;")])
@example(choices=[0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 2, 3, 9], changes=[(4752, b"\1")])
@given(
    choices=st.lists(st.integers(0, 11), min_size=1, max_size=40),
    changes=st.lists(st.tuples(st.integers(0, 10**6), st.binary(min_size=1, max_size=3)), max_size=8),
)
def test_many_lines_at_once_say_what_each_says_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, choices: list[int], changes: list[tuple[int, bytes]]
) -> None:
    content = bytearray(text_of(kind, choices).encode())
    head = len(KINDS[kind][1])
    for number, new in changes:
        place = head + number % (len(content) - head)
        content[place : place + len(new)] = new
    path = tmp_path / f"a{KINDS[kind][0]}"
    path.write_bytes(content)
    (many, told), (alone, said) = both_ways(path, monkeypatch)
    assert different(many, alone, "time id flags channel length data") == [] and told == said
    if not changes:
        assert not any("could not be read" in line for line in told)


@pytest.mark.parametrize("kind", KINDS)
def test_a_log_is_the_same_in_pieces_of_any_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    path = tmp_path / f"a{KINDS[kind][0]}"
    path.write_text(text_of(kind, range(60)) + "what is this\n" + text_of(kind, range(20)))
    whole = logs.read(path)
    frames = all_of(whole)
    monkeypatch.setattr(reading, "BLOCK", 300)
    pieces = logs.read(path)
    assert different(all_of(pieces), frames, "time id flags channel length data") == []
    assert whole.damage == pieces.damage and [damage.line for damage in whole.damage] in (
        [],
        [61 + KINDS[kind][1].count("\n")],
    )


@pytest.mark.parametrize("suffix", WRITERS)
@quick
@given(sent=st.lists(messages(), min_size=1, max_size=40))
def test_frames_equal_those_of_python_can(tmp_path: Path, suffix: str, sent: list[can.Message]) -> None:
    path = tmp_path / f"a{suffix}"
    sent = sorted(sent, key=lambda message: message.timestamp)
    with WRITERS[suffix](path) as writer:
        for message in sent:
            if message.is_fd and not message.dlc:
                continue  # python-can takes it for a remote one
            if suffix in (".asc", ".log") or not (message.is_fd or message.is_remote_frame or message.is_error_frame):
                writer.on_message_received(message)
    if not path.stat().st_size:
        return
    with READERS[suffix](path, **({"relative_timestamp": False} if suffix == ".asc" else {})) as reader:
        theirs = list(reader)
    for message in theirs:
        if suffix == ".trc":
            message.channel -= 1
        if suffix == ".log":
            message.channel = int(str(message.channel or "can0").removeprefix("can"))
    ours, theirs_too = all_of(logs.read(path)), from_messages(theirs)
    assert different(ours[~ours.has(Flag.ERROR)], theirs_too[~theirs_too.has(Flag.ERROR)]) == []
    assert len(ours) == len(theirs)
    if len(ours):
        assert np.ptp(ours.time - theirs_too.time) < 2e-6  # ours is in UTC


def frames_of(path: Path, text: str) -> tuple[Frames, logs.LogReader]:
    """The frames in a file with this text, and its reader."""
    path.write_text(text)
    log = logs.read(path)
    return all_of(log), log


@pytest.mark.parametrize(
    "date", ["date Thu Mar 07 09:20:11.250 2024", "date jeu. mars 07 09:20:11.250 2024", "date Do Xyz 7 unknown"]
)
def test_the_base_is_read_whatever_the_date_says(tmp_path: Path, date: str) -> None:
    line = "   0.500000 1  291  Rx   d 8 96 0 10 0 0 0 0 255\n"
    frames, log = frames_of(tmp_path / "a.asc", f"{date}\nbase dec  timestamps absolute\n{line}")
    assert frames.id.tolist() == [291] and frames.data[0].tolist() == [96, 0, 10, 0, 0, 0, 0, 255]
    if "unknown" in date:
        assert frames.time.tolist() == [0.5] and "date is not understood" in log.damage[0].problem
    else:
        assert frames.time.tolist() == [1709803211.75] and log.findings.zoneless and not log.damage


@pytest.mark.parametrize(
    ("text", "time", "zone"),
    [
        ("Thu Mar 07 09:20:11.250 am 2024", 1709803211.25, False),
        ("Do M\u00e4r 7 09:20:11 pm 2024", 1709846411.0, False),
        ("mar. janv. 02 00:00:01 2024", 1704153601.0, False),
        ("2024-03-07T09:20:11Z", 1709803211.0, True),
        ("2024-03-07 10:20:11.5 +01:00", 1709803211.5, True),
        ("7:3:2024 9:20:11:250", 1709803211.25, False),
    ],
)
def test_dates_of_many_tools_are_understood(text: str, time: float, zone: bool) -> None:
    assert moment(text) == (time, zone)


def test_stamps_that_count_from_the_line_before_are_added_up(tmp_path: Path) -> None:
    head = "date Thu Mar 07 09:20:11.250 2024\nbase hex timestamps relative\n"
    lines = [
        "0.000000 1 123 Rx d 1 64",
        "0.010000 1 123 Rx d 1 65",
        "0.005000 1 Statistic: D 0",
        "0.010000 1 123 Rx d 1 66",
    ]
    frames, _ = frames_of(tmp_path / "a.asc", head + "\n".join(lines) + "\n")
    assert np.allclose(frames.time - 1709803211.25, [0.0, 0.01, 0.025], atol=1e-6)
    deltas = [f" (000.{delta:06d})  can0  123   [1]  00\n" for delta in (0, 1000, 3000, 1000, 1000, 2000)]
    frames, log = frames_of(tmp_path / "a.log", "".join(deltas))
    assert np.allclose(frames.time, [0.0, 0.001, 0.004, 0.005, 0.006, 0.008]) and "added up" in log.findings.notes[0]


def test_requests_to_send_are_no_frames_and_long_frames_on_classic_lines_keep_their_bytes(tmp_path: Path) -> None:
    octets = " ".join(f"{number:02X}" for number in range(12))
    lines = ["0.1 1 123 TxRq d 1 64", "0.2 1 123 Tx d 1 64", f"0.3 1 123 Rx d 9 {octets}", f"0.4 1 123 Rx d 8 {octets}"]
    frames, log = frames_of(tmp_path / "a.asc", "base hex timestamps absolute\n" + "\n".join(lines) + "\n")
    assert frames.length.tolist() == [1, 12] and frames.has(Flag.FD).tolist() == [False, True]
    assert log.findings.skipped == 1 and "says 8 data bytes and has 12" in log.damage[0].problem


def test_interfaces_that_are_words_are_different_channels_and_said(tmp_path: Path) -> None:
    names = ["can_left", "can1", "vcan1", "can_right"]
    frames, log = frames_of(
        tmp_path / "a.log", "".join(f"(1.{number}) {name} 123#00\n" for number, name in enumerate(names))
    )
    assert frames.channel.tolist() == [2, 1, 0, 3]
    assert {*log.findings.notes} == {
        "interface can_left is channel 2",
        "interface vcan1 is channel 0",
        "interface can_right is channel 3",
    }


def test_frames_without_stamps_are_numbered_and_it_is_said(tmp_path: Path) -> None:
    frames, log = frames_of(tmp_path / "a.log", "  can0  123   [2]  64 00\n" * 3)
    assert frames.time.tolist() == [1.0, 2.0, 3.0] and "no time stamps" in log.findings.notes[0]


@pytest.mark.parametrize(
    ("kind", "suffix"), [("asc", ".txt"), ("candump -x", ".txt"), ("busmaster", ".asc"), ("asc", ".log")]
)
def test_the_content_decides_where_a_suffix_is_shared(tmp_path: Path, kind: str, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_text(text_of(kind, [0, 1] * 20))
    assert logs.is_log(path) and len(all_of(logs.read(path))) == 40
    (tmp_path / "b.txt").write_text("date 2024-03-07\ntime id value\n0.0 1 2\n")
    assert not logs.is_log(tmp_path / "b.txt")


def test_a_packed_log_is_read_and_neither_damage_nor_a_trap_fills_the_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = text_of("candump", [0] * 5000).encode()
    path = tmp_path / "a.log.gz"
    path.write_bytes(gzip.compress(text))
    assert logs.is_log(path) and len(all_of(logs.read(path))) == 5000
    path.write_bytes(gzip.compress(text)[:-2000])
    log = logs.read(path)
    assert 0 < len(all_of(log)) < 5000 and "cannot be unpacked" in str(log.damage)
    monkeypatch.setattr(reading, "UNSUSPICIOUS", 1 << 20)
    path.write_bytes(gzip.compress(b"(1.000000) can0 123#00\n" * 1_000_000))
    log = logs.read(path)
    assert 0 < len(all_of(log)) < 1_000_000 and "times its size" in str(log.damage)
    for read in (logs.read, formats.read):
        with pytest.raises(TraceError, match=r"is packed, as only text logs of CAN frames may be; gunzip b\.mf4\.gz"):
            read(path.rename(tmp_path / "b.mf4.gz"))
        path = tmp_path / "b.mf4.gz"


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("0.1 1 123 Rx d 3 01 02", "says 3 data bytes and has 2"),
        ("0.1 1 12z Rx d 1 01", "'12z' is no identifier"),
        ("0.1 1 123 Rx d 1 0z", "says 1 data bytes and has 0"),
        ("0.x 1 123 Rx d 1 01", "'0.x' is no time stamp"),
        ("0.1 1 923 Rx d 1 01", "its identifier is 0x923"),
        ("0.1 1 123 Rx q 1 01", "'q' is neither data nor a remote frame"),
    ],
)
def test_what_is_wrong_with_a_line_is_said(tmp_path: Path, line: str, why: str) -> None:
    text = f"base hex timestamps absolute\n0.0 1 123 Rx d 1 01\n{line}\n"
    _, log = frames_of(tmp_path / "a.asc", text)
    assert [damage.problem for damage in log.damage] == [f"this line is no frame: {why}"] and log.damage[0].line == 3


@pytest.mark.parametrize(
    "suffix",
    [".asc", ".blf", ".csv", ".log", ".trc", pytest.param(".mf4", marks=[pytest.mark.needs("mf4"), pytest.mark.slow])],
)
def test_differences_of_stamps_come_out_as_they_were_written(tmp_path: Path, suffix: str) -> None:
    """A date in a double is good to a quarter of a microsecond."""
    frames = rig_frames(30, start=1_700_000_000.037)
    logs.write(tmp_path / f"a{suffix}", [replace(frames, time=np.round(frames.time, 6))])
    time = all_of(logs.read(tmp_path / f"a{suffix}")).time
    assert since(float(time[0]), time).tolist() == [
        round(0.001 * number + late, 6) for number in range(30) for late in (0.0, 0.0002)
    ]


@pytest.mark.parametrize(("name", "told"), [("291", True), ("0x123", False), ("1A3", False), ("00000123", False)])
def test_identifiers_of_a_table_that_may_be_decimal_are_told(tmp_path: Path, name: str, told: bool) -> None:
    (tmp_path / "a.csv").write_text(f"timestamp,id,dlc,data\n1.0,{name},1,01\n")
    log = logs.read(tmp_path / "a.csv")
    assert all_of(log).id.tolist() == [int(name, 16)]
    assert ("identifiers are taken for hexadecimal numbers" in log.findings.notes) == told


def test_channels_that_vectors_tables_name_count_from_0_as_elsewhere(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("Time;Chn;ID;Dir;DLC;Data\n0.1;CAN 1;123;Rx;1;0A\n0.2;CAN 2;123;Rx;1;0B\n")
    assert all_of(logs.read(path)).channel.tolist() == [0, 1]


def test_columns_of_peaks_tables_are_known_with_their_units_in_brackets(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    head = "Message Number,Time Offset (ms),Type,ID (hex),Data Length Code,Data Bytes (hex)"
    path.write_text(f"{head}\n1,0.000,Rx,100,2,01 0A\n2,250.5,Rx,18FECA15,1,0B\n")
    frames = all_of(logs.read(path))
    assert (frames.id.tolist(), frames.length.tolist()) == ([0x100, 0x18FECA15], [2, 1])
    assert np.diff(frames.time).tolist() == [0.2505]


def test_the_date_of_busmaster_may_have_single_digits(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_text(BUSMASTER.replace("9:20:11:250", "9:2:1:250") + "9:2:1:2500 Rx 1 0x123 s 1 0A\n")
    log = logs.read(path)
    assert all_of(log).time.tolist() == [datetime(2024, 3, 7, 9, 2, 1, 250_000, UTC).timestamp()]
    assert not log.damage
