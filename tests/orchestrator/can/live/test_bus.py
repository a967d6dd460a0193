"""Any interface opens by its name; what cannot be is refused before, and an adapter that fails is named."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import BusError, InputError
from orchestrator.can.live.bus import BusSettings, is_bus_off, open_bus, opened, parse_option, send
from orchestrator.can.slcan import protocol
from tests.support.can.wiring import HANG, frame, heard

FRAMES = [
    can.Message(arbitration_id=0x123, is_extended_id=False, data=[1, 2, 3]),
    can.Message(arbitration_id=0x1ABCDEF0, is_extended_id=True, data=bytes(range(8))),
    can.Message(arbitration_id=0x7FF, is_extended_id=False, is_remote_frame=True, dlc=4),
    can.Message(arbitration_id=0x10, is_extended_id=False),
]


@pytest.fixture
def line() -> Iterator[tuple[int, can.BusABC]]:
    """The adapter's end of a serial line, and the bus that talks to it."""
    master, slave = os.openpty()
    with opened(BusSettings("slcan", os.ttyname(slave), 500_000)) as bus:
        until(master, b"O\r")
        yield master, bus
    os.close(slave)
    os.close(master)


def until(adapter: int, end: bytes) -> bytes:
    """What the adapter is told, up to this end."""
    data = b""
    while not data.endswith(end):
        data += os.read(adapter, 65536)
    return data


def same(message: can.Message, other: can.Message) -> bool:
    return message.equals(other, timestamp_delta=None, check_channel=False, check_direction=False)


def test_an_unknown_interface_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(InputError, match=r"pcam: is not known.*did you mean pcan\?.*kvaser.*socketcan") as refused:
        BusSettings("pcam", "x")
    assert refused.value.exit_code == 2


@pytest.mark.parametrize(
    ("interface", "channel"), [("slcan", "/dev/ttyNONE"), ("pcan", "PCAN_USBBUS1"), ("vector", "0")]
)
def test_an_adapter_that_does_not_open_is_named(interface: str, channel: str) -> None:
    with pytest.raises(BusError, match=f"^{interface}:{channel}: does not open") as failed:
        open_bus(BusSettings(interface, channel, 500_000))
    assert failed.value.exit_code == 3


def test_an_option_that_the_interface_needs_is_named() -> None:
    with pytest.raises(BusError, match="'host'"):
        open_bus(BusSettings("socketcand", "can0", options={"port": "29536"}))


@pytest.mark.parametrize(("text", "heard"), [("true", True), ("false", False)])
def test_options_reach_the_interface_with_their_types(text: str, heard: bool) -> None:
    """The text "false" would count as true."""
    with opened(BusSettings("virtual", "options", options={"receive_own_messages": text})) as bus:
        bus.send(frame(1))
        assert (bus.recv(0.0) is not None) is heard


@pytest.mark.parametrize("text", ["speed", "=3", "a b=3"])
def test_an_option_without_a_name_or_value_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="name=value"):
        parse_option(text)


def test_a_bit_rate_that_no_serial_adapter_has_is_refused() -> None:
    with pytest.raises(InputError, match=r"bit rate 400000; choose among .*500000"):
        BusSettings("slcan", "/dev/ttyACM0", 400_000)


def test_can_fd_without_its_bit_rates_is_refused_where_they_are_needed() -> None:
    with pytest.raises(InputError, match="--data-bitrate"):
        BusSettings("slcan", "/dev/ttyACM0", 500_000, fd=True)


def test_two_buses_on_one_virtual_channel_hear_each_other() -> None:
    first, second = (BusSettings("virtual", "pair") for _ in range(2))
    with opened(first) as one, opened(second) as other:
        one.send(frame(7))
        assert [message.data[-1] for message in heard(other, 1)] == [7]


def test_frames_pass_over_socketcan_where_the_kernel_has_it() -> None:
    if not Path("/sys/class/net/vcan0").exists():
        pytest.skip("the kernel has no vcan0 (ip link add vcan0 type vcan; ip link set vcan0 up)")
    with opened(BusSettings("socketcan", "vcan0")) as one, opened(BusSettings("socketcan", "vcan0")) as other:
        for message in FRAMES:
            send(one, message)
        found = heard(other, len(FRAMES))
    assert all(map(same, found, FRAMES))
    assert len(found) == len(FRAMES)


def test_lines_of_a_serial_adapter_become_frames_however_they_are_cut(line: tuple[int, can.BusABC]) -> None:
    adapter, bus = line
    found = []
    for piece in (b"t1233010", b"203\r\rT1ABCDEF080001020304", b"050607\rr7FF4\rt0100\r"):
        os.write(adapter, piece)
        found += [message for message in [bus.recv(0.01)] if message is not None]
    found += heard(bus, len(FRAMES) - len(found))
    assert len(found) == len(FRAMES)
    assert all(map(same, found, FRAMES))


def test_what_is_sent_is_received_the_same(line: tuple[int, can.BusABC]) -> None:
    adapter, bus = line
    for message in FRAMES:
        send(bus, message)
    os.write(adapter, until(adapter, b"t0100\r"))
    found = heard(bus, len(FRAMES))
    assert len(found) == len(FRAMES)
    assert all(map(same, found, FRAMES))


def test_noise_is_counted_and_frames_within_it_are_found(line: tuple[int, can.BusABC]) -> None:
    adapter, bus = line
    os.write(adapter, b"\xff\x00garbage\rt1\rt12399\rt1232AABB\r\a\x80\rt1231CC\r" + b"x" * 2000 + b"\rt1231DD\r")
    assert [bytes(message.data) for message in heard(bus, 3)] == [b"\xaa\xbb", b"\xcc", b"\xdd"]
    assert bus.malformed >= 5
    assert bus.refused == 1


def test_a_line_without_an_end_does_not_grow(line: tuple[int, can.BusABC]) -> None:
    adapter, bus = line
    for _ in range(50):
        os.write(adapter, b"t" * 1000)
        bus.recv(0.01)
    assert len(bus._partial) <= protocol.LONGEST
    assert bus.malformed > 0


def test_what_an_adapter_says_about_errors_comes_as_error_frames(line: tuple[int, can.BusABC]) -> None:
    adapter, bus = line
    os.write(adapter, b"e1a\re2cs\rsp000130\rsb000256\r")
    found = heard(bus, 4)
    assert [message.is_error_frame for message in found] == [True] * 4
    assert [is_bus_off(message) for message in found] == [False] * 3 + [True]
    assert bus.state is can.BusState.ERROR


def test_stamps_are_the_time_of_day_and_in_order(line: tuple[int, can.BusABC]) -> None:
    adapter, bus = line
    begun = time.time()
    os.write(adapter, b"t1230\r" * 100)
    stamps = [message.timestamp for message in heard(bus, 100)]
    assert stamps == sorted(stamps) and len(stamps) == 100
    assert begun - 0.01 < stamps[0] <= stamps[-1] < time.time() + 0.01


def test_stamps_of_the_adapter_are_kept_and_go_on_over_its_minute(line: tuple[int, can.BusABC]) -> None:
    adapter, bus = line
    os.write(adapter, b"t1230EA42\r")  # 59.970 s, which is read at once
    heard(bus, 1)
    os.write(adapter, b"t1230EA56\rt1230EA5B\rt12300004\rt1231AA0009\r")  # 59.990 s, 59.995 s, 0.004 s, 0.009 s
    stamps = [message.timestamp for message in heard(bus, 4)]
    assert [stamp - stamps[-1] for stamp in stamps] == pytest.approx([-0.019, -0.014, -0.005, 0.0], abs=1e-6)


def test_an_adapter_that_goes_away_is_noticed_and_can_be_closed() -> None:
    master, slave = os.openpty()
    bus = open_bus(BusSettings("slcan", os.ttyname(slave)))
    os.close(slave)
    os.close(master)
    with pytest.raises(can.CanOperationError, match="adapter is gone"):
        bus.recv(HANG)
    with pytest.raises(can.CanOperationError, match="adapter is gone"):
        bus.send(frame(1))
    bus.shutdown()


def test_an_adapter_that_takes_nothing_ends_in_a_timeout_and_later_lines_are_whole(
    line: tuple[int, can.BusABC],
) -> None:
    adapter, bus = line
    sent = 0
    with pytest.raises(can.CanTimeoutError):
        while True:
            send(bus, frame(sent), patience=0.01)
            sent += 1
    data = os.read(adapter, 65536)
    with suppress(can.CanTimeoutError):
        send(bus, frame(0x777), patience=0.01)  # where the line was cut it is ended first
    send(bus, frame(0x777), patience=HANG)
    *lines, last = (data + until(adapter, b"t10080000000000000777\r")).rstrip(b"\r").split(b"\r")
    assert last == b"t10080000000000000777"
    assert sum(not protocol.parse(line) for line in lines) <= 1
    assert len(lines) <= sent + 3


class Crowded:
    """A bus whose buffer is full for a while."""

    def __init__(self, times: int) -> None:
        self.times = times

    def send(self, message: can.Message, timeout: float) -> None:
        self.times -= 1
        if self.times >= 0:
            raise can.CanOperationError("No buffer space available", error_code=errno.ENOBUFS)


def test_a_full_buffer_is_waited_for() -> None:
    bus = Crowded(3)
    send(bus, frame(1), patience=HANG)  # type: ignore[arg-type]
    assert bus.times == -1, "tried once more than it was full, and no more once it was taken"


def test_a_buffer_that_stays_full_is_an_error() -> None:
    with pytest.raises(can.CanOperationError):
        send(Crowded(10**6), frame(1), patience=0.02)  # type: ignore[arg-type]


@given(st.binary(max_size=200))
def test_no_line_breaks_the_parser(line: bytes) -> None:
    frame = protocol.parse(line)
    assert frame is None or len(frame.digits) == (0 if frame.remote else 2 * frame.length)
