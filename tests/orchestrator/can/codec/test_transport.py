"""J1939: messages are found by their group whoever sends them, and put together where they come in parts."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from orchestrator.can.codec.decoding import Decoder, trace
from orchestrator.can.codec.transport import Transport
from orchestrator.can.database.bus import LogDatabase, load_all
from orchestrator.can.frames import Flag, Frames

ENGINE, VIN, BRAKE = 0x0CF004FE, 0x18FEECFE, 0x18EF00FE  # speed; a long message; one that is to somebody
DBC = f"""VERSION ""
BU_: Rig
BO_ {ENGINE | 1 << 31} EEC1: 8 Rig
 SG_ EngineSpeed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" Rig
BO_ {VIN | 1 << 31} VI: 20 Rig
 SG_ First : 0|8@1+ (1,0) [0|0] "" Rig
 SG_ Last : 144|16@1+ (1,0) [0|0] "" Rig
BO_ {BRAKE | 1 << 31} PropA: 8 Rig
 SG_ Brake : 0|8@1+ (1,0) [0|0] "" Rig
BO_ 291 Plain: 8 Rig
 SG_ plain : 0|8@1+ (1,0) [0|0] "" Rig
"""
DECLARED = """BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
"""
Line = tuple[float, int, list[int]]


@pytest.fixture
def base(tmp_path: Path) -> LogDatabase:
    return load(tmp_path, DBC + DECLARED)


def load(folder: Path, text: str, j1939: bool = False) -> LogDatabase:
    path = folder / "j1939.dbc"
    path.write_text(text)
    return load_all(path, j1939=j1939)


def frames(*lines: Line, channel: int = 0) -> Frames:
    count = len(lines)
    data = np.array([(*data, *[0] * 8)[:8] for _, _, data in lines], np.uint8).reshape(count, 8)
    identifiers = np.array([identifier for _, identifier, _ in lines], np.uint32)
    flags = np.where(identifiers > 0x7FF, np.uint8(Flag.EXTENDED), np.uint8(0))
    length = np.array([min(8, len(data)) for _, _, data in lines], np.uint8)
    time = np.array([time for time, _, _ in lines])
    return Frames(time, identifiers, flags, np.full(count, channel, np.uint8), length, data)


def engine(speed: float) -> list[int]:
    return [0, 0, 0, *int(speed / 0.125).to_bytes(2, "little"), 0, 0, 0]


def parts(payload: bytes, source: int, to: int = 0xFF, begin: float = 0.0, group: int = 0xFEEC) -> list[Line]:
    """The frames that bring a payload: broadcast, or asked for where it is to somebody, with his answers."""
    count = -(-len(payload) // 7)
    about = [*group.to_bytes(3, "little")]
    connect, send = (0x18EC << 16 | to << 8 | source), (0x18EB << 16 | to << 8 | source)
    answer = 0x18EC << 16 | source << 8 | to
    size = [*len(payload).to_bytes(2, "little")]
    lines: list[Line] = [(begin, connect, [32 if to == 0xFF else 16, *size, count, 0xFF, *about])]
    if to != 0xFF:
        lines.append((begin + 0.01, answer, [17, count, 1, 0xFF, 0xFF, *about]))
    for number in range(count):
        piece = payload[7 * number : 7 * number + 7].ljust(7, b"\xff")
        lines.append((begin + 0.05 * (number + 1), send, [number + 1, *piece]))
    if to != 0xFF:
        lines.append((begin + 0.05 * (count + 1), answer, [19, *size, count, 0xFF, *about]))
    return lines


@pytest.mark.parametrize("identifier", [0x0CF00400, 0x18F004FE, 0x0CF00431])
def test_a_message_is_found_by_its_group_whoever_sends_it(base: LogDatabase, identifier: int) -> None:
    found = trace([frames((0.0, identifier, engine(800)), (0.1, identifier, engine(900)))], base).trace
    assert found.names == ("EngineSpeed",) and found["EngineSpeed"].tolist() == [800, 900]


def test_senders_are_apart_and_one_can_be_chosen(base: LogDatabase) -> None:
    both = frames(*((0.01 * row, 0x0CF00400 | 3 * (row % 2), engine(800 + row)) for row in range(4)))
    found = trace([both], base)
    assert found.trace.names == ("sa00.EngineSpeed", "sa03.EngineSpeed")
    assert found.names.notes() == [
        "message EEC1 comes from sa00 and sa03, which are kept apart as sa00.EngineSpeed, sa03.EngineSpeed"
    ]
    assert trace([both], base, ["sa03.EngineSpeed"]).trace["sa03.EngineSpeed"][-1] == 803
    one = trace([both], base, source=3)
    assert one.trace.names == ("EngineSpeed",) and one.statistics.other_sources == {"EEC1": 2}


def test_an_address_in_the_database_is_that_of_its_sender_alone_where_another_has_the_same_group(
    tmp_path: Path,
) -> None:
    second = (
        DBC.split("BO_ 291", maxsplit=1)[0]
        + f'BO_ {0x0CF00403 | 1 << 31} EEC1_3: 8 Rig\n SG_ other : 24|16@1+ (1,0) [0|0] "" Rig\n'
    )
    base = load(tmp_path, second + DECLARED)
    lines = frames((0.0, 0x0CF00403, engine(800)), (0.1, 0x0CF00405, engine(900)), (0.2, 0x0CF00403, engine(800)))
    assert set(trace([lines], base).trace.names) == {"other", "EngineSpeed"}


def test_who_a_message_is_to_does_not_matter(base: LogDatabase) -> None:
    found = trace([frames((0.0, 0x18EF1203, [7]), (0.1, 0x18EF3403, [8]))], load_short(base)).trace
    assert found["Brake"].tolist() == [7, 8]


def load_short(base: LogDatabase) -> LogDatabase:
    """The same, with a message of one byte."""
    path = Path(str(base.databases[0].path))
    path.write_text(path.read_text().replace("PropA: 8", "PropA: 1"))
    return load_all(path)


def test_a_database_that_does_not_say_j1939_is_matched_by_whole_identifiers_unless_told(tmp_path: Path) -> None:
    line = frames((0.0, 0x0CF00400, engine(800)), (0.1, 0x123, [1] * 8))
    assert trace([line], load(tmp_path, DBC)).statistics.unknown == {"0CF00400": 1}
    assert trace([line], load(tmp_path, DBC, j1939=True)).statistics.unknown == {}
    protocol = 'BA_DEF_ "ProtocolType" STRING ;\nBA_DEF_DEF_ "ProtocolType" "";\nBA_ "ProtocolType" "J1939";\n'
    assert trace([line], load(tmp_path, DBC + protocol)).statistics.unknown == {}


@pytest.mark.parametrize("to", [0xFF, 0x21])
def test_a_message_in_parts_is_put_together_broadcast_or_asked_for(base: LogDatabase, to: int) -> None:
    payload = bytes(range(10, 30))
    lines = [*parts(payload, 3, to), *parts(payload[::-1], 3, to, 1.0)]
    found = trace([frames(*lines)], base)
    assert found.trace["First"].tolist() == [10, 29]
    assert found.trace["Last"].tolist() == [28 + 256 * 29, 11 + 256 * 10]
    assert found.trace.time.tolist() == pytest.approx([0.15, 1.15])
    assert (found.statistics.transported, found.statistics.unknown) == (2, {})


def test_what_is_missing_of_a_message_is_told(base: LogDatabase) -> None:
    lines = parts(bytes(20), 3)
    del lines[2]
    decoder = Decoder(base)
    decoder.feed(frames(*lines, *parts(bytes(20), 3, begin=1.0)))
    assert (decoder.statistics.broken, decoder.statistics.transported) == (1, 1)
    assert "messages in parts of which one is missing, dropped: 1" in decoder.statistics.lines()
    decoder.feed(frames(*parts(bytes(20), 3, begin=2.0)[:-1]))  # the log ends in the middle
    assert decoder.statistics.broken == 2


@settings(max_examples=60, deadline=None)
@given(st.lists(st.binary(min_size=9, max_size=1785), min_size=1, max_size=4), st.integers(1, 50), st.randoms())
def test_payloads_of_several_senders_at_once_come_back_in_batches_of_any_size(
    payloads: list[bytes], size: int, random: object
) -> None:
    streams = [parts(payload, source, 0xFF if source % 2 else 0x80) for source, payload in enumerate(payloads)]
    lines = sorted((line for stream in streams for line in stream), key=lambda line: line[0])
    lines = [(0.001 * number, identifier, data) for number, (_, identifier, data) in enumerate(lines)]
    transport, found = Transport(), {}
    for begin, end in pairwise([*range(0, len(lines), size), len(lines)]):
        for packet in transport.feed(frames(*lines[begin:end])):
            found[packet.identifier & 0xFF] = packet.data
    assert found == dict(enumerate(payloads)) and transport.broken == 0


def long_parts(payload: bytes, source: int, to: int, windows: list[int], group: int = 0xEF00) -> list[Line]:
    """The frames of the extended protocol (ISO 11783-3, 5.12) with which the receiver asks for so many packets each."""
    about, count = [*group.to_bytes(3, "little")], -(-len(payload) // 7)
    connect, send, answer = (
        (0x18C8 << 16 | to << 8 | source),
        (0x18C7 << 16 | to << 8 | source),
        0x18C8 << 16 | source << 8 | to,
    )
    lines: list[Line] = [(0.0, connect, [20, *len(payload).to_bytes(4, "little"), *about])]
    done = 0
    while done < count:
        window = min(windows[len(lines) % len(windows)], count - done)
        lines.append((0.0, answer, [21, window, *(done + 1).to_bytes(3, "little"), *about]))
        lines.append((0.0, connect, [22, window, *done.to_bytes(3, "little"), *about]))
        for number in range(window):
            piece = payload[7 * (done + number) :][:7].ljust(7, b"\xff")
            lines.append((0.0, send, [number + 1, *piece]))
        done += window
    return [*lines, (0.0, answer, [23, *len(payload).to_bytes(4, "little"), *about])]


@settings(max_examples=30, deadline=None)
@given(
    st.binary(min_size=1786, max_size=5000),
    st.lists(st.integers(1, 255), min_size=1, max_size=4),
    st.binary(min_size=9, max_size=99),
)
def test_what_is_longer_comes_by_the_extended_protocol_also_beside_a_short_one_of_the_same_pair(
    payload: bytes, windows: list[int], short: bytes
) -> None:
    lines = long_parts(payload, 3, 0x21, windows)
    lines[3:3] = parts(short, 3, 0x21)
    lines = [(0.001 * number, identifier, data) for number, (_, identifier, data) in enumerate(lines)]
    transport = Transport()
    packets = transport.feed(frames(*lines))
    assert [packet.data for packet in packets] == [short, payload]
    assert (packets[1].identifier, transport.broken, transport.unfinished) == (0x18EF2103, 0, 0)


def test_a_long_message_without_a_packet_is_told_and_one_that_is_sent_again_comes() -> None:
    payload = bytes(range(256)) * 8
    lines = long_parts(payload, 3, 0x21, [100])
    again = [*lines[:50], *lines[60:104], (0.0, 0x18C82103, [22, 10, *(47).to_bytes(3, "little"), 0, 0xEF, 0])]
    again += [(0.0, identifier, [data[0] - 47, *data[1:]]) for _, identifier, data in lines[50:60]] + lines[104:]
    for sent, found, broken in ((again, [payload], 0), (lines[:50] + lines[51:], [], 1)):
        transport = Transport()
        packets = transport.feed(
            frames(*((0.001 * n, identifier, data) for n, (_, identifier, data) in enumerate(sent)))
        )
        assert [packet.data for packet in packets] == found
        assert transport.broken + transport.unfinished == broken


def test_another_data_page_is_no_transport() -> None:
    lines = [(time, identifier | 1 << 24, data) for time, identifier, data in parts(bytes(20), 3)]
    assert Transport().feed(frames(*lines)) == []


@settings(max_examples=200, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([0x18ECFF03, 0x18EBFF03, 0x18EC0300, 0x1CEB2103, 0x18C82103, 0x18C72103]),
            st.binary(min_size=8, max_size=8),
        )
    )
)
def test_no_frames_of_transport_end_the_reading(lines: list[tuple[int, bytes]]) -> None:
    transport = Transport()
    for packet in transport.feed(frames(*((0.1 * row, kind, [*data]) for row, (kind, data) in enumerate(lines)))):
        assert 0 < len(packet.data) <= 1785
