"""The number of bits of a frame is that of the bits themselves."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from orchestrator.can import frame_time
from orchestrator.can.ls_bus import stuffing

DATA = st.binary(max_size=8) | st.sampled_from([b"\0" * 8, b"\xff" * 8, b"\x0f" * 8, b"\x83" * 8])


def on_the_wire(identifier: int, extended: bool, remote: bool, length: int, data: bytes) -> str:
    """The frame bit by bit, with the gap after it."""
    head = f"{identifier:029b}" if extended else f"{identifier:011b}"
    head = f"{head[:11]}11{head[11:]}{remote:b}00" if extended else f"{head}{remote:b}00"
    sent = "0" + head + f"{length:04b}" + "".join(f"{byte:08b}" for byte in data)
    check = 0
    for bit in sent:
        check = (check << 1 & 0x7FFF) ^ (0x4599 if int(bit) ^ check >> 14 else 0)
    found, run = "", ""
    for bit in sent + f"{check:015b}":
        found += bit
        run = run + bit if run[-1:] == bit else bit
        if len(run) == 5:
            run = "10"[int(bit)]
            found += run
    return found + "1" + "01" + "1" * 7 + "111"  # delimiter, acknowledgement, end, gap


@given(st.integers(0, 0x1FFF_FFFF), st.booleans(), DATA)
def test_the_bits_of_a_frame_are_as_many_as_are_counted(identifier: int, extended: bool, data: bytes) -> None:
    identifier &= 0x1FFF_FFFF if extended else 0x7FF
    frame = identifier, extended, False, len(data), data
    assert stuffing.bits(*frame) == len(on_the_wire(*frame)) <= frame_time.bits(len(data), extended)[0]


@given(st.integers(0, 0x7FF), st.integers(0, 8))
def test_a_remote_frame_has_no_data_on_the_wire(identifier: int, length: int) -> None:
    frame = identifier, False, True, length, b""
    assert stuffing.bits(*frame) == len(on_the_wire(*frame)) <= frame_time.bits(0, False, True)[0]


def test_a_frame_without_stuff_bits_has_its_plain_length() -> None:
    frame = 0x555, False, False, 1, b"\x55"
    assert len(on_the_wire(*frame)) - stuffing.bits(*frame) == 0
    assert stuffing.bits(*frame) - (34 + 8 + 13) <= 2
