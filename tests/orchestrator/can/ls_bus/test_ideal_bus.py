"""A bus carries frames in the order of their arbitration, each for as long as its bits take, and tells who lost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import BusError
from orchestrator.can import frame_time
from orchestrator.can.frames import Flag
from orchestrator.can.ls_bus import stuffing
from orchestrator.can.ls_bus.ideal_bus import IdealBus
from orchestrator.can.ls_bus.operations import (
    ArbitrationLost,
    BusSetting,
    Configuration,
    Confirm,
    FormatError,
    NodeState,
    Operation,
    Status,
    Transmit,
    TransmitFd,
    Wakeup,
    WhenLost,
    decoded,
    encoded,
)

RATE = 500_000
BIT = 1.0 / RATE
LATE = 1.0  # long after all


def frame(identifier: int, data: bytes = b"\x55\xaa", extended: bool = False) -> Transmit:
    return Transmit(identifier, extended, False, len(data), data)


def a_bus(count: int = 3, rate: int | None = RATE, data_rate: int | None = None) -> IdealBus:
    return IdealBus("can0", [f"n{number}" for number in range(count)], rate, data_rate)


def give(bus: IdealBus, number: int, time: float, *operations: Operation) -> None:
    bus.take(number, time, encoded(operations))


def got(bus: IdealBus, number: int) -> list[object]:
    return [one for data in bus.nodes[number].inbox for one in decoded(data)]


def test_a_frame_is_received_by_all_but_its_sender_when_its_bits_are_through() -> None:
    bus, sent = a_bus(), frame(0x123)
    give(bus, 0, 0.001, sent)
    bits = stuffing.bits(*sent)
    bus.run(0.001 + (bits - 3) * BIT - 1e-9)
    assert [got(bus, number) for number in range(3)] == [[], [], []]
    bus.run(0.001 + (bits - 3) * BIT + 1e-9)
    assert [got(bus, number) for number in range(3)] == [[], [sent], [sent]]
    assert bus.frames().time.tolist() == [pytest.approx(0.001 + (bits - 3) * BIT, abs=1e-15)]


def test_the_lowest_identifier_goes_first_and_the_others_without_a_pause() -> None:
    bus, frames = a_bus(), [frame(0x300), frame(0x100), frame(0x200)]
    for number, sent in enumerate(frames):
        give(bus, number, 0.0, sent)
    bus.run(LATE)
    found = bus.frames()
    assert found.id.tolist() == [0x100, 0x200, 0x300]
    ends = np.cumsum([stuffing.bits(*frames[number]) for number in (1, 2, 0)])
    np.testing.assert_allclose(found.time, (ends - 3) * BIT, rtol=1e-14)


def test_a_frame_that_comes_while_another_is_under_way_waits_whatever_its_identifier() -> None:
    bus = a_bus()
    give(bus, 0, 0.0, frame(0x700))
    give(bus, 1, 10 * BIT, frame(0x001))
    bus.run(LATE)
    assert bus.frames().id.tolist() == [0x700, 0x001]


def test_a_standard_identifier_beats_an_extended_one_with_the_same_first_bits() -> None:
    bus = a_bus()
    give(bus, 0, 0.0, frame(0x123 << 18, extended=True))
    give(bus, 1, 0.0, frame(0x123))
    bus.run(LATE)
    assert bus.frames().has(Flag.EXTENDED).tolist() == [False, True]


def test_frames_of_one_identifier_keep_their_order() -> None:
    bus = a_bus()
    for byte in range(5):
        give(bus, 0, 0.0, frame(0x10, bytes([byte])))
    bus.run(LATE)
    assert bus.frames().data[:, 0].tolist() == [0, 1, 2, 3, 4]


@given(
    st.lists(
        st.tuples(st.integers(0, 2), st.floats(0, 0.01), st.integers(0, 0x7FF), st.binary(max_size=8)), max_size=30
    ),
    st.lists(st.floats(0, 0.02), max_size=20),
)
def test_how_often_the_bus_is_run_changes_nothing(
    requests: Sequence[tuple[int, float, int, bytes]], stops: Sequence[float]
) -> None:
    whole, pieces = a_bus(), a_bus()
    for number, time, identifier, data in requests:
        give(whole, number, time, frame(identifier, data))
    whole.run(LATE)
    before = 0.0
    for stop in [*sorted(stops), LATE]:
        for number, time, identifier, data in requests:
            if before <= time < stop:
                give(pieces, number, time, frame(identifier, data))
        pieces.run(stop)
        before = stop
    one, other = whole.frames(), pieces.frames()
    assert one.time.tolist() == other.time.tolist()
    assert one.id.tolist() == other.id.tolist()
    assert one.data.tolist() == other.data.tolist()


def test_times_do_not_drift_on_a_full_bus() -> None:
    bus, sent = a_bus(2), frame(0x123, bytes(range(8)))
    for _ in range(2000):
        give(bus, 0, 0.0, sent)
    bus.run(LATE * 10)
    assert bus.frames().time[-1] == (2000 * stuffing.bits(*sent) - 3) / RATE
    assert bus.busy(LATE * 10) == pytest.approx(2000 * stuffing.bits(*sent) / RATE, rel=1e-12)


def test_a_sender_that_asks_for_it_has_its_frame_confirmed() -> None:
    bus = a_bus()
    bus.nodes[0].notified = True
    give(bus, 0, 0.0, frame(0x123))
    give(bus, 1, 0.0, frame(0x124))
    bus.run(LATE)
    assert got(bus, 0) == [Confirm(0x123), frame(0x124)]
    assert got(bus, 1) == [frame(0x123)]


def test_a_frame_that_is_not_to_wait_is_given_back_when_it_loses() -> None:
    bus = a_bus()
    bus.nodes[1].notified = True
    give(bus, 1, 0.0, Configuration(BusSetting.ARBITRATION_LOST, WhenLost.DISCARD_AND_NOTIFY), frame(0x200))
    give(bus, 0, 0.0, frame(0x100))
    bus.run(LATE)
    assert got(bus, 1) == [ArbitrationLost(0x200), frame(0x100)]
    assert bus.frames().id.tolist() == [0x100]
    assert bus.counts == {"frames of n1 that lost arbitration and were given back": 1}


def test_without_a_receiver_nothing_is_confirmed() -> None:
    bus = a_bus(2)
    bus.nodes[0].notified = True
    give(bus, 1, 0.0, Status(NodeState.BUS_OFF))
    give(bus, 0, 0.0, frame(0x123))
    give(bus, 1, 0.0, frame(0x124))
    bus.run(LATE)
    assert got(bus, 0) == got(bus, 1) == []
    assert bus.counts == {"frames of n0 that nobody acknowledged": 1, "frames of n1, which is off the bus": 1}


def test_who_is_off_the_bus_neither_sends_nor_hears_from_then_on() -> None:
    bus = a_bus(2)
    give(bus, 0, 0.0, *(frame(identifier) for identifier in range(10)))
    give(bus, 1, 0.0, frame(0x123))
    give(bus, 1, 0.5 / RATE, frame(0x124))
    give(bus, 1, 100.0 / RATE, Status(NodeState.BUS_OFF))
    bus.run(LATE)
    assert got(bus, 1) == [frame(0)]  # the next one ends after 100 bits
    assert bus.frames().id.tolist() == [*range(10)]
    assert bus.counts["frames of n1, which is off the bus"] == 2


def test_a_data_bit_rate_that_nobody_gives_is_told() -> None:
    bus = a_bus(2)
    give(bus, 0, 0.0, TransmitFd(1, False, True, False, bytes(8)), TransmitFd(2, False, False, False, bytes(8)))
    bus.run(LATE)
    said = "frames of n0 that switch to a data bit rate, which nobody gives: sent at the other"
    assert bus.counts == {said: 1}


def test_error_passive_nodes_come_after_the_others() -> None:
    bus = a_bus()
    give(bus, 0, 0.0, Status(NodeState.ERROR_PASSIVE), frame(0x001))
    give(bus, 1, 0.0, frame(0x700))
    bus.run(LATE)
    assert bus.frames().id.tolist() == [0x700, 0x001]


def test_one_wakes_all_others() -> None:
    bus = a_bus()
    give(bus, 1, 0.0, Wakeup())
    assert [got(bus, number) for number in range(3)] == [[Wakeup()], [], [Wakeup()]]


def test_what_is_malformed_goes_back_to_who_sent_it_and_is_counted() -> None:
    bus, nonsense = a_bus(2), bytes.fromhex("99000000 08000000")
    bus.take(0, 0.0, nonsense)
    assert got(bus, 0) == [FormatError(nonsense)]
    assert list(bus.counts) == [
        "operations of n0 that are malformed: one has the code 0x99, which no operation for CAN has"
    ]


def test_nodes_configure_the_bit_rate_that_the_bus_was_not_given() -> None:
    bus, sent = a_bus(2, None), frame(0x123)
    give(bus, 0, 0.0, Configuration(BusSetting.BITRATE, 100_000), sent)
    bus.run(LATE)
    assert bus.frames().time[0] == (stuffing.bits(*sent) - 3) / 100_000


def test_bit_rates_that_contradict_each_other_name_who_wants_them() -> None:
    bus = a_bus(2)
    with pytest.raises(BusError, match=r"can0\.bitrate: .* 100000 bit/s by n1 and to 500000 .* by the bus"):
        give(bus, 1, 0.0, Configuration(BusSetting.BITRATE, 100_000))
    bus = a_bus(2, None)
    give(bus, 0, 0.0, Configuration(BusSetting.BITRATE, 250_000))
    with pytest.raises(BusError, match=r"to 125000 bit/s by n1 and to 250000 bit/s by n0"):
        give(bus, 1, 0.0, Configuration(BusSetting.BITRATE, 125_000))


def test_a_bus_without_a_bit_rate_says_so() -> None:
    bus = a_bus(2, None)
    give(bus, 0, 0.0, frame(1))
    with pytest.raises(BusError, match=r"can0: has no bit rate.*give it a `bitrate`"):
        bus.run(LATE)


def test_can_fd_data_go_at_the_data_bit_rate() -> None:
    bus, sent = a_bus(2, RATE, 4 * RATE), TransmitFd(0x123, False, True, False, bytes(64))
    give(bus, 0, 0.0, sent)
    bus.run(LATE)
    nominal, data = frame_time.bits(64, fd=True)
    assert bus.frames().time[0] == pytest.approx((nominal - 3) / RATE + data / (4 * RATE), rel=1e-14)
    assert bus.frames().has(Flag.FD).all()
