"""What adapters refuse, do not answer, or say to somebody else: nothing of it passes for a frame that was sent."""

from __future__ import annotations

import os
import time
from select import select
from threading import Thread

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import BusError
from orchestrator.can.live.bus import open_bus, opened
from orchestrator.can.live.link import linked
from orchestrator.can.slcan.bus import SlcanBus
from orchestrator.can.slcan.flow import LATE, STALL, Flow
from tests.support.can.scripted_adapter import ScriptedAdapter, willing
from tests.support.can.wiring import HANG, frame, heard, number, settings, wait_for

KEY = (0x100, False)


def on(adapter: ScriptedAdapter, **options: object) -> SlcanBus:
    bus = open_bus(settings(adapter.path, **options))  # type: ignore[arg-type]
    assert isinstance(bus, SlcanBus)
    return bus


@pytest.mark.parametrize(
    ("refused", "said"), [(b"S6", r"refuses S6 \(500000 bit/s\)"), (b"O", r"refuses O \(to open\)")]
)
def test_an_adapter_that_refuses_to_open_does_not_open(refused: bytes, said: str) -> None:
    with ScriptedAdapter(lambda line: b"\a" if line == refused else willing(line)) as adapter:
        with pytest.raises(BusError, match=f"does not open .*{said}") as failed:
            open_bus(settings(adapter.path))
        assert failed.value.exit_code == 3
        adapter.answer = willing
        on(adapter).shutdown()  # the port is free again


def test_an_adapter_that_answers_to_nothing_opens_and_cannot_tell_what_it_took() -> None:
    with ScriptedAdapter(lambda line: b"") as adapter:
        bus = on(adapter)
        for count in range(200):
            bus.send(frame(count), timeout=0.0)
        wait_for(lambda: len(adapter.frames) == 200)
        assert not bus.tells_version and not bus.flow.answers
        bus.shutdown()


def test_what_another_thread_has_read_is_no_hang_up() -> None:
    with ScriptedAdapter(willing) as adapter, opened(settings(adapter.path)) as bus:
        assert isinstance(bus, SlcanBus)
        port, late = bus.serialPortOrig.fd, list[can.Message | None]()
        with bus._reading:
            adapter.say(b"t10020001\r")
            wait_for(lambda: bool(select([port], [], [], 0.0)[0]))
            waiting = Thread(target=lambda: late.append(bus.recv(HANG)))
            waiting.start()  # it sees the frame, and waits for its turn to read
            time.sleep(0.1)
            assert os.read(port, 4096) == b"t10020001\r"
        time.sleep(0.1)  # it looks, and there is nothing
        adapter.say(b"t10020002\r")
        waiting.join()
        assert late[0] is not None and number(late[0]) == 2


def test_frames_that_are_taken_and_refused_are_told_apart() -> None:
    def odd(line: bytes) -> bytes:
        return b"\a" if line[:1] == b"t" and int(line[-1:], 16) % 4 == 3 else willing(line)

    with ScriptedAdapter(odd) as adapter, opened(settings(adapter.path)) as bus:
        assert isinstance(bus, SlcanBus)
        for count in range(8):
            bus.send(frame(count), timeout=HANG)
        bus.send(can.Message(arbitration_id=0x12345, data=b"\1"), timeout=HANG)
        wait_for(lambda: (bus.recv(0.0), bus.flow.owed)[1] == 0)
        assert bus.flow.taken == {KEY: 6, (0x12345, True): 1}
        assert bus.flow.refused == bus.refused == 2
        assert bus.flow.refusing is None


def test_an_adapter_that_refuses_all_is_known_since_when() -> None:
    with ScriptedAdapter(lambda line: b"\a" if line[:1] == b"t" else willing(line)) as adapter:
        bus, begun = on(adapter), time.monotonic()
        for count in range(3):
            bus.send(frame(count), timeout=HANG)
        wait_for(lambda: (bus.recv(0.0), bus.flow.owed)[1] == 0)
        assert bus.flow.refusing is not None and begun <= bus.flow.refusing <= time.monotonic()
        bus.shutdown()


@pytest.mark.slow
def test_an_adapter_that_stops_before_its_first_answer_is_given_no_more_frames() -> None:
    with ScriptedAdapter() as adapter, linked(settings(adapter.path), 9.0, lambda line: None) as link:
        adapter.reads.clear()
        time.sleep(0.1)
        taken, until = list[bool](), time.monotonic() + 4 * STALL
        while time.monotonic() < until:
            taken.append(link.send(frame(len(taken))))
            time.sleep(0.002)
        assert any(taken) and not any(taken[-10:])
        assert link.owed and link.out.total() == 0
        adapter.reads.set()
        wait_for(lambda: (link.recv(0.0), link.owed)[1] == 0)
        assert link.out.total() == sum(taken) and link.send(frame(0x777), HANG)


def test_an_adapter_that_answers_to_questions_alone_is_not_waited_for() -> None:
    with ScriptedAdapter(lambda line: b"" if line[:1] == b"t" else willing(line)) as adapter, on(adapter) as bus:
        bus.send(frame(0), timeout=HANG)
        wait_for(lambda: (bus.recv(0.0), bus.flow.answers)[1] is False)
        for count in range(1, 200):
            bus.send(frame(count), timeout=0.0)
        wait_for(lambda: len(adapter.frames) == 200)
        assert bus.owed == 0 and bus.flow.lost == 0
        assert adapter.lines.count(b"V") == 2  # when it was opened, and behind the first frame


@given(st.floats(0.001, 0.2), st.floats(0.001, 0.02))
def test_a_message_is_kept_back_after_a_few_times_as_long_as_answers_take(usual: float, period: float) -> None:
    flow, now = Flow(), 0.0
    for _ in range(200):
        with flow.giving(KEY, now):
            now += usual
        flow.answered(True, now)
    given = 0
    while not flow.stalled(now + given * period, KEY):
        with flow.giving(KEY, now + given * period):
            given += 1
    age = given * period
    step = period + 1e-9  # and what sums of times round
    assert min(2 * usual, LATE) - step <= age <= min(max(4 * usual, 0.02), LATE) + step
    assert not flow.stalled(now + age, (0x7FF, False))


@pytest.mark.slow
def test_old_commands_do_not_wait_for_an_adapter_that_has_stopped_to_read() -> None:
    with ScriptedAdapter() as adapter:
        bus = on(adapter)
        bus.send(frame(0), timeout=HANG)
        wait_for(lambda: (bus.recv(0.0), bus.flow.owed)[1] == 0)
        adapter.reads.clear()
        time.sleep(0.1)
        given, until = [], time.monotonic() + 10 * STALL
        while time.monotonic() < until:
            try:
                bus.send(frame(len(given) + 1), timeout=0.0)
                given.append(time.monotonic())
            except can.CanTimeoutError:
                pass
            time.sleep(0.002)
        assert given[-1] - given[0] < STALL
        adapter.reads.set()
        wait_for(lambda: (bus.recv(0.0), bus.flow.owed)[1] == 0)
        bus.send(frame(0x777), timeout=HANG)
        wait_for(lambda: adapter.frames[-1].endswith(b"777"))
        assert len(adapter.frames) == len(given) + 2
        bus.shutdown()


def test_a_port_has_one_program_at_a_time_and_the_first_loses_nothing() -> None:
    with ScriptedAdapter() as adapter, opened(settings(adapter.path)) as bus:
        adapter.say(b"t10080000000000000001\r")
        with pytest.raises(BusError, match=r"another program has the port open.*; end the other program"):
            open_bus(settings(adapter.path))
        assert [number(message) for message in heard(bus, 1)] == [1]


def test_what_was_said_to_the_one_before_is_dropped() -> None:
    """Also where it was killed in the middle of a line, and the adapter goes on until it is closed."""

    def chatty(line: bytes) -> bytes:
        old = b"t10080000000000000001\r" * 50
        return (old if line in (b"C", b"V", b"S6") else b"") + old * (line == b"O") + willing(line)

    with ScriptedAdapter(chatty) as adapter:
        port = os.open(adapter.path, os.O_RDWR | os.O_NOCTTY)
        os.write(port, b"S6\rO\rt1008")
        os.close(port)
        wait_for(lambda: b"O" in adapter.lines)
        with opened(settings(adapter.path)) as bus:
            adapter.say(b"t10080000000000000002\r")
            assert [number(message) for message in heard(bus, 1)] == [2]
            assert b"C" in adapter.lines


@given(st.lists(st.sampled_from(["given", "taken", "refused", "settled"]), max_size=60))
def test_no_more_frames_are_taken_than_were_given(events: list[str]) -> None:
    flow, given = Flow(), 0
    for now, event in enumerate(events):
        if event == "given":
            with flow.giving(KEY, now):
                given += 1
        elif event == "settled":
            flow.settle()
        else:
            flow.answered(event == "taken", now)
        assert flow.taken.total() + flow.refused + flow.owed <= given
        assert not (flow.stalled(now + 1e9, KEY) and not flow.owed)


@pytest.mark.slow
@pytest.mark.parametrize("there", [b"V1013\r", b"\r", b"\a"])
def test_answers_that_noise_has_swallowed_are_not_waited_for_for_ever(there: bytes) -> None:
    """Whatever an adapter answers to the question whether it is there."""
    with ScriptedAdapter() as adapter, linked(settings(adapter.path), 9.0, lambda line: None) as link:
        for count, noisy in enumerate([False, True, True, True, False]):
            adapter.answer = lambda line, noisy=noisy: b"z#" if noisy else there if line == b"V" else willing(line)  # type: ignore[misc]
            assert link.send(frame(count), HANG)
            wait_for(lambda count=count: (link.recv(0.0), len(adapter.frames))[1] == count + 1)  # type: ignore[misc]
            wait_for(lambda: link.recv(0.0) is None and link.acknowledges)
        wait_for(lambda: (link.recv(0.0), link.owed)[1] == 0)
        assert link.unanswered and link.out.total() < 5


@pytest.mark.slow
def test_the_last_frame_can_be_left_with_an_adapter_that_has_stopped_to_answer() -> None:
    with ScriptedAdapter() as adapter:
        with linked(settings(adapter.path), 9.0, lambda line: None) as link:
            assert not link.insist(frame(0))  # nothing is owed
            assert link.send(frame(1))
            wait_for(lambda: (link.recv(0.0), link.acknowledges)[1])
            adapter.answer = lambda line: b""
            assert link.send(frame(2))
            time.sleep(2 * STALL)
            assert not link.send(frame(3))
            assert link.insist(frame(4))
        port = os.open(adapter.path, os.O_RDWR | os.O_NOCTTY)
        os.write(port, b"N\r")
        wait_for(lambda: adapter.lines[-1] == b"N")
        os.close(port)
        assert [int(line[-1:]) for line in adapter.frames] == [1, 2, 4]
        assert b"C" not in adapter.lines[adapter.lines.index(adapter.frames[0]) :]  # it is not told to leave the bus


@pytest.mark.slow
def test_what_an_adapter_owes_that_is_gone_is_no_failure_of_who_asks() -> None:
    adapter = ScriptedAdapter()
    with linked(settings(adapter.path), 9.0, lambda line: None) as link:
        with adapter:
            assert link.send(frame(1))
            wait_for(lambda: (link.recv(0.0), link.acknowledges)[1])
            adapter.answer = lambda line: b""
            assert link.send(frame(2))
        time.sleep(2 * STALL)
        assert link.owed == 1
