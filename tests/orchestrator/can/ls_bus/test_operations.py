"""Operations of FMI-LS-BUS keep all that they say as bytes, lie as the standard has them, and nonsense is told."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.can.frames import LENGTHS
from orchestrator.can.ls_bus.operations import (
    ArbitrationLost,
    BusFault,
    BusSetting,
    Configuration,
    Confirm,
    FormatError,
    Malformed,
    NodeState,
    Operation,
    Status,
    Transmit,
    TransmitFd,
    TransmitXl,
    Wakeup,
    WhenLost,
    decoded,
    encoded,
)

EXTENDED = st.tuples(st.integers(0, 0x1FFF_FFFF), st.just(True))
IDS = st.tuples(st.integers(0, 0x7FF), st.just(False)) | EXTENDED
ANY_ID, BYTE = st.integers(0, 0x1FFF_FFFF), st.integers(0, 255)
FD_DATA = st.builds(lambda length, fill: bytes([fill]) * length, st.sampled_from(LENGTHS.tolist()), BYTE)
WORD = st.integers(0, (1 << 32) - 1)


def frames() -> st.SearchStrategy[Operation]:
    """Frames of each kind, with identifiers that go with their length."""
    plain = st.one_of(
        st.builds(lambda data: Transmit(0, False, False, len(data), data), st.binary(max_size=8)),
        st.builds(lambda length: Transmit(0, False, True, length, b""), st.integers(0, 8)),
        st.builds(lambda brs, esi, data: TransmitFd(0, False, brs, esi, data), st.booleans(), st.booleans(), FD_DATA),
        st.builds(
            lambda sec, sdt, net, af, data: TransmitXl(0, False, sec, sdt, net, af, data),
            st.booleans(),
            BYTE,
            BYTE,
            WORD,
            st.binary(min_size=1, max_size=70),
        ),
    )
    return st.builds(lambda who, frame: frame._replace(id=who[0], extended=who[1]), IDS, plain)


OPERATIONS = st.one_of(
    frames(),
    st.builds(FormatError, st.binary(max_size=40)),
    st.builds(Confirm, ANY_ID),
    st.builds(ArbitrationLost, ANY_ID),
    st.builds(BusFault, ANY_ID, st.integers(1, 6), st.integers(1, 2), st.booleans()),
    st.builds(
        Configuration,
        st.sampled_from([BusSetting.BITRATE, BusSetting.DATA_BITRATE, BusSetting.XL_BITRATE]),
        WORD,
    ),
    st.builds(Configuration, st.just(BusSetting.ARBITRATION_LOST), st.sampled_from(list(WhenLost))),
    st.builds(Status, st.sampled_from(list(NodeState))),
    st.just(Wakeup()),
)


@given(st.lists(OPERATIONS, max_size=6))
def test_what_is_encoded_is_decoded_to_the_same(operations: list[Operation]) -> None:
    found = decoded(encoded(operations))
    assert found == operations
    assert [type(one) for one in found] == [type(one) for one in operations]


@given(st.binary(max_size=60))
def test_whatever_the_bytes_are_each_is_in_an_operation_or_in_what_is_none(data: bytes) -> None:
    sizes = [len(one.data) if isinstance(one, Malformed) else len(encoded([one])) for one in decoded(data)]
    assert sum(sizes) == len(data)


def test_a_frame_lies_as_in_the_header_of_the_standard() -> None:
    # opCode, length, id, ide, rtr, dataLength and data of fmi3LsBusCanOperationCanTransmit, packed
    laid = bytes.fromhex("10000000 14000000 01000000 00 00 0400 01020304")
    assert encoded([Transmit(1, False, False, 4, bytes([1, 2, 3, 4]))]) == laid
    switched = bytes.fromhex("11000000 13000000 23010000 01 01 00 0200 AABB")
    assert encoded([TransmitFd(0x123, True, True, False, b"\xaa\xbb")]) == switched


def test_a_remote_frame_tells_a_length_and_brings_no_data() -> None:
    laid = bytes.fromhex("10000000 10000000 01000000 00 01 0400")
    assert encoded([Transmit(1, False, True, 4, b"")]) == laid
    assert decoded(laid) == [Transmit(1, False, True, 4, b"")]


def test_the_behaviour_at_lost_arbitration_takes_one_byte() -> None:
    laid = bytes.fromhex("40000000 0A000000 04 02")
    assert encoded([Configuration(BusSetting.ARBITRATION_LOST, WhenLost.DISCARD_AND_NOTIFY)]) == laid


@pytest.mark.parametrize(
    ("data", "why"),
    [
        ("10000000 14000000 01000000 00 00 0500 01020304", "says that it has 5 data bytes and has 4"),
        ("10000000 10000000 00080000 00 00 0000", "identifier 0x800, beyond 0x7FF"),
        ("10000000 10000000 00000000 02 00 0000", "extended = 2, which is neither 0 nor 1"),
        ("10000000 19000000 01000000 00 00 0900 010203040506070809", "9 data bytes, which no such frame has"),
        ("11000000 1A000000 01000000 00 00 00 0900 010203040506070809", "9 data bytes, which no such frame has"),
        ("99000000 08000000", "the code 0x99, which no operation for CAN has"),
        ("20000000 08000000", "has 8 bytes where a Confirm has 12"),
        ("41000000 09000000 07", "7 is not a valid NodeState"),
        ("40000000 0D000000 09 00000000", "9 is not a valid BusSetting"),
        ("20000000 07000000 00000000", "says that it has 7 bytes where there are 12"),
        ("200000", "ends after 3 of 8 bytes of its head"),
    ],
)
def test_what_is_no_operation_says_why(data: str, why: str) -> None:
    (found,) = decoded(bytes.fromhex(data))
    assert isinstance(found, Malformed)
    assert why in found.why


def test_what_follows_a_malformed_operation_of_the_right_length_is_read() -> None:
    found = decoded(bytes.fromhex("99000000 08000000") + encoded([Confirm(7)]))
    assert found[1:] == [Confirm(7)]
