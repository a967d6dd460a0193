"""A bus that is lost is told and comes back where it may; what got out is counted, and what is ours is not received."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import cast

import can
import pytest

from orchestrator.can.live import link as links
from orchestrator.can.live.bus import BusSettings, open_bus
from orchestrator.can.live.link import REFUSING, Link, linked
from orchestrator.can.live.receiver import Receiver
from tests.support.can.coupling_samples import BUS, ScriptedBus
from tests.support.can.scripted_adapter import ScriptedAdapter, willing
from tests.support.can.wiring import frame, settings, wait_for

KEY = (0x100, False)


def closed_after(line: bytes) -> bytes:
    """The answer of an adapter that has left the bus, and says so by refusing frames only."""
    return b"\a" if line[:1] == b"t" else willing(line)


def test_an_adapter_that_refuses_frames_for_too_long_is_lost_and_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(links, "_RETRY", 0.05)
    said: list[str] = []
    with ScriptedAdapter() as adapter:
        kept = replace(settings(Path(adapter.path)), reopens=True)
        with linked(kept, 0.02, said.append) as link, Receiver(link, 100):
            assert link.send(frame(1))
            wait_for(lambda: link.acknowledges and link.out[KEY] == 1)
            adapter.answer = closed_after
            wait_for(lambda: not link.send(frame(2)))
            assert link.trouble == REFUSING or link.losses
            adapter.answer = willing
            wait_for(lambda: link.losses[-1].seconds is not None and not link.trouble)
            before = link.out[KEY]
            wait_for(lambda: link.send(frame(3)))
            wait_for(lambda: link.acknowledges and link.out[KEY] == before + 1)
            assert link.unsent > 0 and link.refused > 0
            assert before == 1, "nothing that was refused counts"
    lost, back, *_ = said
    assert lost == f"{kept.place}: bus lost: {REFUSING}" and "bus back after" in back


def test_a_port_that_is_gone_is_opened_when_it_is_there_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(links, "_RETRY", 0.05)
    said: list[str] = []
    kept = BusSettings("slcan", str(tmp_path / "0"), 500_000, reopens=True)
    first = ScriptedAdapter()
    with first:
        (tmp_path / "0").symlink_to(first.path)
        link = Link(open_bus(kept), kept, 0.1, said.append)
    (tmp_path / "0").unlink()
    with Receiver(link, 100) as receiver:
        wait_for(lambda: link.trouble)
        assert not link.send(frame(1)) and receiver.failure is None
        with ScriptedAdapter() as second:
            (tmp_path / "0").symlink_to(second.path)
            wait_for(lambda: not link.trouble)
            assert link.send(frame(2))
            wait_for(lambda: second.frames)
            second.say(b"t10080000000000000003\r")
            wait_for(lambda: receiver.received == 1)
            assert link.loss_count == 1 and [line.split(": ")[1][:8] for line in said] == ["bus lost", "bus back"]
    link.shutdown()


def test_frames_that_an_interface_gives_back_are_not_received() -> None:
    def echo(sent: can.Message) -> list[can.Message]:
        return [frame(int.from_bytes(sent.data, "big"))]  # as somebody else's would look

    bus = ScriptedBus(echo)
    multicast = BusSettings("udp_multicast", "239.0.0.1")
    link = Link(cast(can.BusABC, bus), multicast, 0.1, lambda line: None)
    for number in range(3):
        link.send(frame(number))
    bus.waiting.append(frame(1))
    taken = link.recv(0.0)
    assert taken is not None and int.from_bytes(taken.data, "big") == 1
    assert link.recv(0.0) is None
    assert link.out == {KEY: 3} and not link.acknowledges


def test_a_bus_that_is_not_opened_again_raises_what_was_wrong_and_counts_what_it_could_not_send() -> None:
    bus, said = ScriptedBus(), list[str]()
    link = Link(cast(can.BusABC, bus), BUS, 0.1, said.append)
    bus.failure = can.CanOperationError("the adapter is gone")
    before = time.time()
    with pytest.raises(can.CanOperationError):
        link.recv(0.0)
    assert link.trouble == "the adapter is gone" and not link.send(frame(1)) and link.unsent == 1
    assert before <= link.losses[0].stamp <= time.time() and len(said) == 1
