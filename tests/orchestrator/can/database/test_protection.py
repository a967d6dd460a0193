"""Counters and checksums of messages: published values, and what is counted where they do not fit."""

from __future__ import annotations

from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orchestrator.can.codec.decoding import Decoder
from orchestrator.can.codec.encoding import Encoder
from orchestrator.can.codec.single_decoding import SingleDecoder
from orchestrator.can.database import database, protection
from orchestrator.can.database.bus import LogDatabase
from orchestrator.can.database.database import Database
from orchestrator.can.database.interpretation import protected
from orchestrator.can.database.protection import Protection
from orchestrator.can.frames import Frames
from orchestrator.trace import Trace
from tests.support.can.can_samples import by_message

DBC = """VERSION ""
BU_: A B
BO_ 100 State: 8 A
 SG_ crc : 7|8@0+ (1,0) [0|0] "" B
 SG_ counter : 8|4@1+ (1,0) [0|14] "" B
 SG_ angle : 16|16@1- (0.1,0) [-100|100] "rad" B
BO_ 101 Timed: 2 A
 SG_ speed : 0|16@1- (0.1,0) [-100|100] "rad/s" B
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 101 10;
"""


@pytest.fixture
def base(tmp_path: Path) -> Database:
    path = tmp_path / "rig.dbc"
    path.write_text(DBC)
    read = database.load(path)
    state = protected(path, read.message("State"), Protection("counter", 0, "crc", "CRC8_H2F", 0x1234))
    return read.changed([state, read.message("Timed")])


def states(base: Database, count: int) -> Frames:
    return Encoder(base, ["angle"]).encode(Trace(0.01 * np.arange(float(count)), {"angle": np.zeros(count)}))


def bitwise(data: bytes, polynomial: int) -> int:
    """The checksum by its definition: division bit by bit."""
    value = 0xFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value << 1 ^ polynomial if value & 0x80 else value << 1) & 0xFF
    return value ^ 0xFF


@pytest.mark.parametrize(("algorithm", "published"), [("CRC8_SAE_J1850", 0x4B), ("CRC8_H2F", 0xDF)])
def test_checksums_have_their_published_check_value(algorithm: str, published: int) -> None:
    assert protection.checksum(b"123456789", algorithm) == published
    rows = np.frombuffer(b"123456789", np.uint8).reshape(1, 9)
    assert protection.checksums(rows, algorithm).tolist() == [published]


@settings(max_examples=50, deadline=None)
@given(st.binary(min_size=2, max_size=64), st.integers(0, 63), st.none() | st.integers(0, 0xFFFF))
def test_checksums_of_one_and_of_many_are_the_division_by_definition(data: bytes, skip: int, mark: int | None) -> None:
    skip %= len(data)
    whole = (b"" if mark is None else mark.to_bytes(2, "little")) + data[:skip] + data[skip + 1 :]
    rows = np.frombuffer(data * 3, np.uint8).reshape(3, -1)
    for name, crc in protection.ALGORITHMS.items():
        assert protection.checksum(data, name, skip, mark) == bitwise(whole, crc.polynomial)
        assert protection.checksums(rows, name, skip, mark).tolist() == [bitwise(whole, crc.polynomial)] * 3


def test_what_is_sent_passes_its_own_checks(base: Database) -> None:
    decoder = Decoder(LogDatabase(base))
    encoder = Encoder(base, ["angle"])
    for start in (0.0, 10.0):  # counters go on from one trace to the next
        decoder.feed(encoder.encode(Trace(0.01 * np.arange(40.0), {"angle": np.linspace(-9, 9, 40)}), start))
    assert decoder.statistics.messages == {"State": 80}
    assert decoder.statistics.clean


def test_lost_repeated_and_corrupt_frames_are_counted(base: Database) -> None:
    frames = states(base, 60)
    kept = np.delete(np.arange(60), [10, 30, 31])
    kept = np.insert(kept, 50, kept[49])  # a frame twice, with the same counter, at another time
    frames = frames[kept]
    frames.time[50] += 0.001
    frames.data[5, 4] ^= 1
    decoder, single = Decoder(LogDatabase(base)), SingleDecoder(base)
    for begin in range(0, len(frames), 7):
        decoder.feed(frames[begin : begin + 7])
    for message in frames.messages():
        single.decode(message)
    for statistics in (decoder.statistics, single.statistics):
        assert statistics.missing == {"State": 3}
        assert statistics.counters == {"State": 3}  # two gaps and a repetition
        assert statistics.checksums == {"State": 1}
        assert any("wrong checksums, dropped: State 1" in line for line in statistics.lines())


def test_damaged_frames_between_do_not_make_a_counter_that_stands_still_move(base: Database) -> None:
    frames = states(base, 90)
    frames.data[10:20] = frames.data[10]
    frames.data[11:20:2] = frames.data[21:30:2]  # of another count, and damaged
    frames.data[11:20:2, 4] ^= 1
    decoder, single = Decoder(LogDatabase(base)), SingleDecoder(base)
    faults = []
    for message in frames.messages():
        single.decode(message)
        faults.append(single.fault)
    still = ["wrong checksum" if row % 2 else "the counter stands still" for row in range(11, 20)]
    assert faults == [""] * 11 + still + [""] * 70
    [[mark]] = decoder.marks(decoder.feed(frames), frames.time[0]).values()
    assert (mark.kind, round(mark.start, 2), round(mark.stop, 2)) == ("checksum", 0.1, 0.2)
    assert decoder.statistics.checksums == single.statistics.checksums == {"State": 5}


def test_a_counter_beyond_its_last_value_is_wrong() -> None:
    assert protection.steps(np.array([13, 14, 0, 1]), 15, 12)[1].tolist() == [False] * 4
    assert protection.steps(np.array([13, 15, 0]), 15, 12)[1].tolist() == [False, True, True]


def test_a_counter_is_known_by_its_name_beside_a_declared_checksum(tmp_path: Path) -> None:
    text = (
        DBC.replace("counter", "AliveCounter")
        + """BA_DEF_ BO_ "ChecksumSignal" STRING;
BA_DEF_DEF_ "ChecksumSignal" "";
BA_ "ChecksumSignal" BO_ 100 "crc";
"""
    )
    (tmp_path / "rig.dbc").write_text(text)
    found = database.load(tmp_path / "rig.dbc").message("State").protection
    assert found is not None and (found.counter, found.checksum) == ("AliveCounter", "crc")


def test_missing_frames_are_told_from_the_cycle_time_where_there_is_no_counter(base: Database) -> None:
    time = np.delete(0.01 * np.arange(100) + np.random.default_rng(0).uniform(0, 0.002, 100), [20, 50, 51, 52])
    frames = Encoder(base, ["speed"]).encode(Trace(np.array([0.0, 0.95]), {"speed": np.zeros(2)}))
    frames = Frames(time, frames.id, frames.flags, frames.channel, frames.length, frames.data)
    decoder, single = Decoder(LogDatabase(base)), SingleDecoder(base)
    for begin in range(0, 96, 19):
        decoder.feed(frames[begin : begin + 19])
    for message in frames.messages():
        single.decode(message)
    assert decoder.statistics.missing == single.statistics.missing == {"Timed": 4}


def test_a_frame_logged_twice_is_dropped_and_counted(base: Database) -> None:
    frames = states(base, 20)
    twice = frames[np.repeat(np.arange(20), 2)]
    decoder = Decoder(LogDatabase(base))
    parts = [by_message(decoder.feed(twice[begin : begin + 7])).get("State") for begin in range(0, 40, 7)]
    assert sum(len(part) for part in parts if part) == 20
    assert decoder.statistics.duplicates == {"State": 20}
    assert not decoder.statistics.counters


def test_a_bus_frame_that_is_none_of_ours_is_only_counted(base: Database) -> None:
    single = SingleDecoder(base)
    for message in (
        can.Message(arbitration_id=5, is_extended_id=False),
        can.Message(is_error_frame=True),
        can.Message(arbitration_id=100, is_extended_id=False, is_remote_frame=True),
        can.Message(arbitration_id=100, is_extended_id=False, data=b"123"),
    ):
        assert single.decode(message) is None
    statistics = single.statistics
    assert (statistics.frames, statistics.errors, statistics.remotes) == (4, 1, 1)
    assert (statistics.unknown, statistics.short) == ({"005": 1}, {"State": 1})
