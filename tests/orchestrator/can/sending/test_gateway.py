"""What comes from one bus goes onto the other, once and at once, or it is told why not."""

from __future__ import annotations

import itertools
import json
import math
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import BusError, InputError
from fmus.json_document import document_of
from orchestrator.can.live.bus import BusSettings, opened
from orchestrator.can.sending.gateway import TOO_LONG, Gateway, gateway
from orchestrator.can.sending.passed import Passed
from orchestrator.can.sending.routes import AGAINST, BOTH, MOST, NOT_CHOSEN, RENAMED, TOO_MANY, Routes
from orchestrator.can.sending.selection import EVERYTHING, MessageSelection
from orchestrator.can.slcan.hub import hub_process
from tests.support.can.can_samples import DBC
from tests.support.can.scripted_adapter import ScriptedAdapter, willing
from tests.support.can.wiring import HANG, command, frame, heard, joined, number, until_said, wait_for

NAMES = {0: "can0", 1: "can1"}


def routes(chosen: MessageSelection = EVERYTHING, **options: Any) -> Routes:
    return Routes(chosen, None, NAMES, **options)


def test_what_is_chosen_passes_both_ways_and_the_rest_does_not() -> None:
    found = routes(MessageSelection(only=["100", "18FF0003"]))
    assert found.of(frame(0), 0).key == (0x100, False)
    assert found.of(can.Message(arbitration_id=0x18FF0003), 1).key == (0x18FF0003, True)
    assert found.of(frame(0, 0x101), 0).why == NOT_CHOSEN
    assert found.of(can.Message(arbitration_id=0x100), 0).why == NOT_CHOSEN, "an extended one is another"
    assert routes(MessageSelection(without=["100"])).of(frame(0), 0).why == NOT_CHOSEN
    assert routes(one_way=True).of(frame(0), 1).why == AGAINST


def test_a_message_that_comes_from_both_sides_is_passed_no_more() -> None:
    found = routes()
    assert found.of(frame(0), 0).key == (0x100, False)
    assert found.of(frame(1), 1).why == found.of(frame(2), 0).why == BOTH
    asked = can.Message(arbitration_id=0x100, is_extended_id=False, is_remote_frame=True)
    assert found.of(asked, 1).key == (0x100, False), "who asks for a message is on the other side"


def test_identifiers_are_others_on_the_other_bus_and_what_would_be_mistaken_for_them_stays() -> None:
    found = routes(renamed=["100=200"])
    assert found.of(frame(0, 0x100), 0).key == (0x200, False)
    assert found.of(frame(0, 0x200), 0).why == RENAMED
    assert routes(renamed=["100=200"]).of(frame(0, 0x200), 1).key == (0x100, False)
    assert routes(renamed=["100=200"]).of(frame(0, 0x100), 1).why == RENAMED
    swapped = routes(renamed=["100=200", "200=100"])
    assert [swapped.of(frame(0, own), 0).key for own in (0x100, 0x200)] == [(0x200, False), (0x100, False)]


@pytest.mark.parametrize("renamed", [["100"], ["100=200", "101=200"], ["100=200", "100=201"], ["speed=200"]])
def test_what_cannot_be_renamed_is_refused(renamed: list[str]) -> None:
    with pytest.raises(InputError, match="--map"):
        routes(renamed=renamed)


@given(st.lists(st.tuples(st.integers(0, 7), st.integers(0, 1)), max_size=60), st.permutations(range(8)))
def test_frames_never_go_round_over_two_gateways(came: list[tuple[int, int]], new: list[int]) -> None:
    """What one passes, the other hears on both sides; however often they hear it, it comes to an end."""
    renamed = [f"{old:03X}={other:03X}" for old, other in enumerate(new)]
    both = routes(renamed=renamed), routes(renamed=renamed)
    waiting: list[tuple[int, int, Routes | None]] = [(identifier, bus, None) for identifier, bus in came]
    passed = 0
    while waiting:
        identifier, bus, sender = waiting.pop(0)
        for one in both:
            key = None if one is sender else one.of(frame(0, identifier), bus).key
            if key is not None:
                waiting.append((key[0], 1 - bus, one))
                passed += 1
    assert passed <= 2 * len(came)


@pytest.mark.parametrize("one_way", [False, True])
def test_a_wire_that_is_both_buses_gets_no_frame_again_and_again(one_way: bool) -> None:
    found = routes(one_way=one_way)
    copies = [found.of(frame(0), bus).key for bus in (0, 1, 0, 0, 1, 0)]  # each is heard by both adapters
    assert sum(key is not None for key in copies) == 1


def test_noise_takes_a_bounded_number_of_identifiers() -> None:
    found = routes()
    for identifier in range(MOST):
        assert found.of(can.Message(arbitration_id=identifier), 0).key
    assert found.of(can.Message(arbitration_id=MOST), 0).why == TOO_MANY
    assert found.of(can.Message(arbitration_id=0), 0).key


BUSES = tuple(BusSettings("virtual", f"gateway {side}") for side in "ab")


@contextmanager
def passing(**options: Any) -> Iterator[tuple[can.BusABC, can.BusABC, list[Passed]]]:
    """A peer on each side, and what has passed once the block is over."""
    done: list[Passed] = []
    ready = threading.Event()
    plan = Gateway(**{"buses": BUSES, "duration": 1.0} | options)
    with opened(plan.buses[0]) as near, opened(plan.buses[1]) as far:
        thread = threading.Thread(target=lambda: done.append(gateway(plan, ready=ready.set)))
        thread.start()
        assert ready.wait(HANG)
        try:
            yield near, far, done
        finally:
            thread.join()


@pytest.mark.slow
def test_frames_pass_whole_in_order_and_are_counted_by_message(tmp_path: Path) -> None:
    (tmp_path / "rig.dbc").write_text(DBC)
    with passing(database=tmp_path / "rig.dbc") as (near, far, done):
        for count in range(50):
            near.send(frame(count, 0x100))
        far.send(can.Message(arbitration_id=0x18FF0003, data=b"\x01", is_remote_frame=False))
        far.send(can.Message(arbitration_id=0x7, is_extended_id=False, is_remote_frame=True, dlc=4))
        assert [number(message) for message in heard(far, 50)] == list(range(50))
        extended, asked = heard(near, 2)
        assert (extended.arbitration_id, extended.is_extended_id, extended.data) == (0x18FF0003, True, b"\x01")
        assert asked.is_remote_frame and asked.dlc == 4
    there, back = done[0].ways
    assert (there.out, there.lost, back.out, back.lost) == (50, 0, 2, 0)
    assert there.given.total() == there.lateness.count == 50
    assert json.dumps(document_of(done[0]), allow_nan=False)


@pytest.mark.slow
def test_error_frames_and_frames_of_can_fd_for_a_classic_bus_are_told(caplog: pytest.LogCaptureFixture) -> None:
    buses = BusSettings("virtual", "gateway a", fd=True), BUSES[1]
    with passing(buses=buses) as (near, far, done):
        near.send(can.Message(is_error_frame=True))
        near.send(can.Message(arbitration_id=2, is_extended_id=False, is_fd=True, data=bytes(12)))
        near.send(can.Message(arbitration_id=1, is_extended_id=False, data=b"\0"))
        assert [message.arbitration_id for message in heard(far, 1)] == [1]
    assert done[0].errors == 1 and done[0].ways[0].left_out == {TOO_LONG: 1}
    assert "002 is not passed" in caplog.text


def test_two_buses_are_wanted() -> None:
    with pytest.raises(InputError, match="of two buses"):
        Gateway(BUSES[:1])
    with pytest.raises(InputError, match="to be both"):
        Gateway((BUSES[0], BUSES[0]))


@pytest.mark.slow
def test_a_gateway_between_serial_adapters_ends_with_safe_values(tmp_path: Path) -> None:
    (tmp_path / "rig.dbc").write_text(DBC)
    with hub_process(tmp_path / "a") as one, hub_process(tmp_path / "b") as other:
        arguments = ["--interface", "slcan", "--channel", one.paths[0], "--channel", other.paths[0]]
        arguments += ["--bitrate", 500_000, "--map", "100=200", "--end-with", "300#00", "--json"]
        with (
            command("can", "gateway", *arguments) as process,
            joined(one.paths[1]) as near,
            joined(other.paths[1]) as far,
        ):
            until_said(process, "passing frames")
            for count in range(200):
                near.send(frame(count))
            came = heard(far, 200)
            assert [(message.arbitration_id, number(message)) for message in came] == [(0x200, k) for k in range(200)]
            process.send_signal(signal.SIGTERM)
            assert heard(far, 1)[0].arbitration_id == heard(near, 1)[0].arbitration_id == 0x300
            said, _ = process.communicate(timeout=HANG)
    document = json.loads(said)
    assert process.returncode == 0
    assert [way["passed"] for way in document["ways"]] == [200, 0] and document["confirmed"]
    assert document["ways"][0]["messages"] == {"200": 200} and document["last"] == ["300#00", "300#00"]


@pytest.mark.slow
def test_two_adapters_on_one_wire_are_told_and_fill_it_with_nothing(tmp_path: Path) -> None:
    with hub_process(tmp_path / "a", 3) as hub:
        arguments = ["--interface", "slcan", "--channel", hub.paths[0], "--channel", hub.paths[1]]
        with (
            command("can", "gateway", *arguments, "--bitrate", 500_000) as process,
            joined(hub.paths[2]) as peer,
        ):
            until_said(process, "passing frames")
            for count in range(50):
                peer.send(frame(count))
            until_said(process, "100 is not passed: it comes from both sides")
            time.sleep(0.2)
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=HANG)
        assert hub.statistics().frames < 100


@pytest.mark.slow
def test_a_bus_that_is_lost_ends_it_with_the_counts_and_the_safe_end_on_the_other(tmp_path: Path) -> None:
    with hub_process(tmp_path / "a") as one, hub_process(tmp_path / "b") as other:
        arguments = ["--interface", "slcan", "--channel", one.paths[0], "--channel", other.paths[0]]
        arguments += ["--bitrate", 500_000, "--end-with", "300#00"]
        with (
            command("can", "gateway", *arguments) as process,
            joined(one.paths[1]) as near,
            joined(other.paths[1]) as far,
        ):
            until_said(process, "passing frames")
            near.send(frame(1))
            assert number(heard(far, 1)[0]) == 1
            one.unplug(0)
            assert heard(far, 1)[0].arbitration_id == 0x300
            _, said = process.communicate(timeout=HANG)
    assert process.returncode == 3
    assert "is lost (the adapter is gone" in said and "1 and 0 frames had passed" in said
    assert "NOT followed by 300#00" in said


@pytest.mark.slow
def test_of_an_adapter_that_has_stopped_to_answer_it_is_not_said_that_its_bus_is_full() -> None:
    with ScriptedAdapter() as near, ScriptedAdapter() as far:
        arguments = ["--interface", "slcan", "--channel", near.path, "--channel", far.path]
        with command("can", "gateway", *arguments, "--bitrate", 500_000, "--end-with", "300#00") as process:
            until_said(process, "passing frames")
            near.say(b"t1001AA\r")
            wait_for(lambda: far.frames)
            far.answer = lambda line: b"" if line[:1] == b"t" else willing(line)
            near.say(b"t1001BB\r" * 3)
            wait_for(lambda: len(far.frames) > 3)
            time.sleep(0.2)
            process.send_signal(signal.SIGTERM)
            _, said = process.communicate(timeout=HANG)
    told = " ".join(said.split())
    assert process.returncode == 3 and "300#00 may not have got out" in told and "has stopped to answer" in told
    assert "is full" not in told


IN_DOUBT = "300#00 may not have got out"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("refused", "times", "told"),
    [
        ((b"t300",), 3, ()),
        ((b"t300",), math.inf, (IN_DOUBT, "refuses frames")),
        ((b"t100", b"t300"), math.inf, (IN_DOUBT, "is lost (the adapter refuses all frames)")),
    ],
)
def test_the_last_frame_is_given_again_to_an_adapter_that_refuses_it(
    refused: tuple[bytes, ...], times: float, told: tuple[str, ...]
) -> None:
    count = itertools.count()

    def answer(line: bytes) -> bytes:
        return b"\a" if line.startswith(refused) and next(count) < times else willing(line)

    with ScriptedAdapter() as near, ScriptedAdapter(answer) as far:
        arguments = ["--interface", "slcan", "--channel", near.path, "--channel", far.path]
        with command("can", "gateway", *arguments, "--bitrate", 500_000, "--end-with", "300#00") as process:
            until_said(process, "passing frames")
            for _ in range(50):
                near.say(b"t1001AA\r")
                time.sleep(0.01)
            process.send_signal(signal.SIGTERM)
            _, said = process.communicate(timeout=HANG)
        assert sum(line.startswith(b"t300") for line in far.frames) > 3
    assert process.returncode == (3 if told else 0)
    assert all(words in said for words in told)


@pytest.mark.slow
def test_a_full_bus_gets_no_old_frames_and_what_it_missed_is_counted(tmp_path: Path) -> None:
    """While others fill a bus, frames for it are lost, and told; the first that goes when there is room is new."""
    with hub_process(tmp_path / "a", 2) as one, hub_process(tmp_path / "b", 3) as other:
        arguments = ["--interface", "slcan", "--channel", one.paths[0], "--channel", other.paths[0]]
        arguments += ["--bitrate", 500_000, "--json"]
        filling = threading.Event()
        filling.set()
        with (
            command("can", "gateway", *arguments) as process,
            joined(one.paths[1]) as near,
            joined(other.paths[1]) as far,
            joined(other.paths[2]) as crowd,
        ):
            until_said(process, "passing frames")

            def fill() -> None:
                while filling.is_set():
                    crowd.send(can.Message(arbitration_id=1, is_extended_id=False, data=bytes(8)), timeout=1.0)

            thread = threading.Thread(target=fill)
            thread.start()
            try:
                count = 0
                until = time.monotonic() + 3.0
                while time.monotonic() < until:
                    near.send(frame(count))
                    count += 1
                    time.sleep(0.01)
            finally:
                filling.clear()
                thread.join()
            sent = list[int]()
            while not sent or sent[-1] != count - 1:  # all that waited on the first bus comes before it
                near.send(frame(count))
                count += 1
                sent += [number(message) for message in heard(far, 1) if message.arbitration_id == 0x100]
            process.send_signal(signal.SIGTERM)
            said, told = process.communicate(timeout=HANG)
    way = json.loads(said)["ways"][0]
    assert way["passed"] + way["lost"] == count and way["lost"] > 0
    assert sent == sorted(sent) and "is full" in told


@pytest.mark.slow
def test_a_lost_bus_is_opened_again_where_that_is_asked_for(tmp_path: Path) -> None:
    with ExitStack() as first, hub_process(tmp_path / "a") as one:
        other = first.enter_context(hub_process(tmp_path / "b"))
        arguments = ["--interface", "slcan", "--channel", one.paths[0], "--channel", other.paths[0]]
        with command("can", "gateway", *arguments, "--bitrate", 500_000, "--reconnect") as process:
            until_said(process, "passing frames")
            first.close()
            until_said(process, "bus lost")
            with hub_process(tmp_path / "b"), joined(other.paths[1]) as far, joined(one.paths[1]) as near:
                until_said(process, "bus back")
                near.send(frame(7))
                assert number(heard(far, 1)[0]) == 7
                process.send_signal(signal.SIGTERM)
                process.communicate(timeout=HANG)
            assert process.returncode == 0


def test_a_bus_that_does_not_open_is_told() -> None:
    plan = Gateway((BUSES[0], BusSettings("slcan", "/nowhere", 500_000)))
    with pytest.raises(BusError, match="does not open"):
        gateway(plan)
