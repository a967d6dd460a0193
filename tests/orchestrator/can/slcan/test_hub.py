"""The stand-in for serial adapters behaves as a bus does: order, time, wrong bit rates, bus off; and it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import InputError
from orchestrator.can import frame_time
from orchestrator.can.live.bus import is_bus_off, send
from orchestrator.can.slcan import protocol
from orchestrator.can.slcan.adapter import BACKLOG, AdapterBus, BitRates, SerialAdapter
from orchestrator.can.slcan.hub import Hub, hub_process
from tests.support.can.wiring import BITRATE, HANG, frame, heard, joined, number, wait_for
from tests.support.commands import ROOT

BITS = {(0, False): 55, (8, False): 135, (8, True): 160}  # worst case: Davis et al. 2007, Section 3.1


@pytest.fixture(scope="module")
def hub(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hub]:
    """Three adapters on a bus of 500 kbit/s."""
    with hub_process(tmp_path_factory.mktemp("ports"), 3) as running:
        yield running


def lines(adapter: SerialAdapter) -> list[bytes]:
    """What an adapter says, which is taken."""
    said = bytes(adapter.outgoing).split(b"\r")[:-1]
    adapter.outgoing.clear()
    return said


def opened_adapters(count: int, bitrates: str = "S6") -> tuple[AdapterBus, list[SerialAdapter]]:
    adapters = [SerialAdapter(BitRates(500_000, 2_000_000)) for _ in range(count)]
    for adapter in adapters:
        adapter.take(f"{bitrates}\rO\r".encode(), 0.0)
        lines(adapter)
    return AdapterBus(adapters), adapters


def test_frames_are_as_long_as_published() -> None:
    for (length, extended), expected in BITS.items():
        assert frame_time.bits(length, extended) == (expected, 0)


def test_a_switched_frame_is_faster_than_one_that_is_not() -> None:
    slow = frame_time.seconds(64, False, False, True, 500_000, None)
    assert 0.2 < frame_time.seconds(64, False, False, True, 500_000, 2_000_000) / slow < 0.4


@given(st.integers(0, 2**29 - 1), st.integers(0, 2**29 - 1))
def test_the_lower_extended_identifier_wins(one: int, other: int) -> None:
    assert (frame_time.priority(one, True, False) < frame_time.priority(other, True, False)) == (one < other)


@given(st.integers(0, 2**11 - 1), st.booleans())
def test_a_standard_frame_wins_over_an_extended_one_with_the_same_base(identifier: int, remote: bool) -> None:
    extended = frame_time.priority(identifier << 18, True, False)
    assert frame_time.priority(identifier, False, False) < frame_time.priority(identifier, False, True) < extended


def test_frames_that_wait_for_the_bus_go_in_the_order_of_their_priority() -> None:
    bus, (one, two, reader) = opened_adapters(3)
    one.take(b"t3008AAAAAAAAAAAAAAAA\rt1000\r", 1.0)  # an adapter keeps the order of its own
    two.take(b"t2000\r", 1.0)
    bus.advance(2.0)
    assert [line[:4] for line in lines(reader)] == [b"t200", b"t300", b"t100"]


def test_a_frame_takes_the_time_of_its_bits() -> None:
    bus, (one, reader) = opened_adapters(2)
    one.take(b"t12380000000000000000\r" * 2, 1.0)
    assert bus.advance(1.0) == pytest.approx(1.0 + 135 / 500_000)
    assert lines(reader) == []
    assert bus.advance(1.0 + 140 / 500_000) == pytest.approx(1.0 + 270 / 500_000)
    assert len(lines(reader)) == 1


def test_a_frame_is_not_heard_by_its_sender() -> None:
    bus, (one, _) = opened_adapters(2)
    one.take(b"t1230\r", 1.0)
    bus.advance(2.0)
    assert lines(one) == [b"z"]


def test_a_bus_that_is_filled_has_no_gap_however_seldom_somebody_looks() -> None:
    bus, (one, filler, reader) = opened_adapters(3)
    filler.fill(1.0)
    bus.advance(1.001)
    one.take(b"t1000\r", 1.001)
    bus.advance(1.1)  # this computer may pause for as long as it likes
    heard_lines = lines(reader)
    assert {line[:4] for line in heard_lines} == {b"t000"} and len(heard_lines) == int(0.1 / (135 / 500_000))
    filler.spare()
    bus.advance(1.2)
    assert lines(reader)[-1] == b"t1000"


def test_an_adapter_at_another_bit_rate_hears_errors_and_nobody_hears_it() -> None:
    bus, (one, reader) = opened_adapters(2)
    wrong = SerialAdapter(BitRates(500_000, 2_000_000))
    wrong.take(b"S4\rO\r", 0.0)
    lines(wrong)
    bus.adapters.append(wrong)
    one.take(b"t1230\r" * 200, 1.0)
    bus.advance(2.0)
    said = lines(wrong)
    assert [line for line in said if line.startswith(b"t")] == []
    assert said.count(b"e1s") == 200
    assert [line[:2] for line in said if line.startswith(b"s")] == [b"sw", b"sp"]
    wrong.take(b"F\r", 2.0)
    assert lines(wrong) == [b"FA4"]
    lines(reader)
    wrong.take(b"t1230\r" * 40, 3.0)
    bus.advance(4.0)
    assert lines(reader) == []
    assert lines(wrong)[-1].startswith(b"sb")
    wrong.take(b"t1230\r", 5.0)
    assert wrong.outgoing == b"\a"


def test_an_adapter_without_a_data_bit_rate_hears_errors_where_can_fd_frames_pass() -> None:
    bus, (one, classic) = opened_adapters(2)
    switched = SerialAdapter(BitRates(500_000, 2_000_000))
    switched.take(b"S6\rY2\rO\r", 0.0)
    bus.adapters.append(switched)
    switched.take(b"b1232AABB\r", 1.0)
    bus.advance(2.0)
    assert lines(classic) == lines(one) == [b"e1s"]


def test_a_reader_that_does_not_read_loses_frames_which_are_counted() -> None:
    bus, (one, reader) = opened_adapters(2)
    passed = 0
    for _ in range(300):
        one.take(b"t12380000000000000000\r" * 20, float(passed))
        passed += 20
        bus.advance(float(passed))
    assert reader.heard + reader.lost == passed
    assert reader.lost > 0
    assert len(reader.outgoing) < BACKLOG + 100
    lines(reader)
    one.take(b"t1230\r", float(passed))
    bus.advance(passed + 1.0)
    assert lines(reader) == [b"e1o", b"t1230"]


def test_answers_that_nobody_reads_do_not_pile_up() -> None:
    bus, (one, _) = opened_adapters(2)
    for now in range(600):
        one.take(b"t1230\rV\r" * 100, float(now))
        bus.advance(now + 0.5)
    assert len(one.outgoing) < BACKLOG + 100
    assert one.sent == 600 * 100


@given(st.lists(st.binary(max_size=60), max_size=20))
def test_no_bytes_break_an_adapter(pieces: list[bytes]) -> None:
    adapter = SerialAdapter(BitRates(500_000, 2_000_000))
    bus = AdapterBus([adapter])
    for now, piece in enumerate([b"S6\rY2\rO\r", *pieces]):
        adapter.take(piece, float(now))
        bus.advance(now + 0.5)
    assert len(adapter._partial) <= protocol.LONGEST


def test_a_program_that_begins_gets_nothing_that_was_for_the_one_before(hub: Hub) -> None:
    with joined(hub.paths[0]) as one:
        with joined(hub.paths[1]):
            before = hub.statistics().ports[1].heard
            send(one, frame(1))
            wait_for(lambda: hub.statistics().ports[1].heard > before)
        with joined(hub.paths[1]) as other:
            send(one, frame(2))
            assert [number(message) for message in heard(other, 1)] == [2]


@pytest.mark.slow
def test_a_full_bus_is_carried_without_a_loss_or_a_change_of_order(hub: Hub) -> None:
    count, before = 4000, hub.statistics()
    with joined(hub.paths[0]) as one, joined(hub.paths[1]) as other:
        begun = time.monotonic()
        for k in range(count):
            send(one, frame(k))
        found = [other.recv(HANG) for _ in range(count)]
        elapsed = time.monotonic() - begun
    after = hub.statistics()
    assert [number(message) for message in found if message] == list(range(count))
    assert after.busy - before.busy == pytest.approx(count * 135 / 500_000, rel=1e-3)
    assert elapsed > count * 135 / 500_000


def test_can_fd_frames_pass_unchanged(hub: Hub) -> None:
    fd = {"fd": True, "data_bitrate": 2_000_000}
    messages = [
        can.Message(
            arbitration_id=0x321, is_extended_id=extended, is_fd=True, bitrate_switch=switched, data=bytes(length)
        )
        for extended in (False, True)
        for switched in (False, True)
        for length in (0, 8, 12, 64)
    ]
    with joined(hub.paths[0], **fd) as one, joined(hub.paths[1], **fd) as other:
        for message in messages:
            send(one, message)
        found = heard(other, len(messages))
    assert [(m.is_extended_id, m.is_fd, m.bitrate_switch, bytes(m.data)) for m in found] == [
        (m.is_extended_id, m.is_fd, m.bitrate_switch, bytes(m.data)) for m in messages
    ]


def test_python_cans_own_serial_bus_and_ours_understand_each_other(hub: Hub) -> None:
    theirs = can.Bus(str(hub.paths[0]), "slcan", bitrate=BITRATE, sleep_after_open=0.0)
    try:
        with joined(hub.paths[1]) as ours:
            send(ours, frame(1, 0x7FF))
            theirs.send(frame(2, 0x001))
            pairs = [(frames[0].arbitration_id, number(frames[0])) for frames in (heard(theirs, 1), heard(ours, 1))]
    finally:
        theirs.shutdown()
    assert pairs == [(0x7FF, 1), (0x001, 2)]


def test_an_adapter_that_leaves_the_bus_says_so_and_comes_back_when_it_is_opened_again(hub: Hub) -> None:
    with joined(hub.paths[0]) as one:
        with joined(hub.paths[1]) as other:
            hub.bus_off(1)
            assert [is_bus_off(message) for message in heard(other, 1)] == [True]
            send(one, frame(1))
            assert heard(other, 0) == []
        with joined(hub.paths[1]) as other:
            send(one, frame(2))
            assert [number(message) for message in heard(other, 1)] == [2]


def test_an_adapter_can_be_unplugged(tmp_path: Path) -> None:
    with hub_process(tmp_path, 2) as hub, joined(hub.paths[1]) as bus:
        hub.unplug(1)
        assert not hub.paths[1].exists()
        with pytest.raises(can.CanOperationError, match="adapter is gone"):
            heard(bus, 1)


def gone(pid: int) -> bool:
    """Whether a process is no more, or only waits to be noticed."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def test_a_hub_ends_with_its_block_and_takes_its_ports_away(tmp_path: Path) -> None:
    with hub_process(tmp_path, 2) as hub:
        assert all(path.exists() for path in hub.paths)
    assert gone(hub.pid)
    assert list(tmp_path.iterdir()) == []


def test_a_second_hub_is_refused_a_folder_and_leaves_the_first_alone(tmp_path: Path) -> None:
    with hub_process(tmp_path, 2) as hub:
        ports = [path.readlink() for path in hub.paths]
        with pytest.raises(InputError, match="another hub, which runs"), hub_process(tmp_path, 3):
            pass
        assert [path.readlink() for path in hub.paths] == ports


def test_a_hub_takes_the_place_of_one_that_was_killed_and_leaves_links_of_others(tmp_path: Path) -> None:
    (tmp_path / "0").symlink_to("/dev/pts/none")
    with hub_process(tmp_path, 2) as hub:
        hub.paths[1].unlink()
        hub.paths[1].symlink_to("elsewhere")
    assert [path.name for path in tmp_path.iterdir()] == ["1"]


def test_a_hub_ends_when_the_process_that_started_it_is_killed(tmp_path: Path) -> None:
    code = (
        "import sys, time, pathlib; from orchestrator.can.slcan.hub import hub_process\n"
        "with hub_process(pathlib.Path(sys.argv[1])) as hub: print(hub.pid, flush=True); time.sleep(300)"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    assert not gone(pid)
    parent.send_signal(signal.SIGKILL)
    parent.communicate()
    wait_for(lambda: gone(pid))
    assert list(tmp_path.iterdir()) == []
