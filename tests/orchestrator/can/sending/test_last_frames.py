"""The last frames of a replay get out before what waits, and where a full bus keeps them that is said."""

from __future__ import annotations

import math
import time
from typing import Any

import can
import pytest

from fmus.errors import BusError
from orchestrator.can.live.bus import BusSettings, occupied
from orchestrator.can.live.channels import Channel
from orchestrator.can.sending.last_frames import LastFrames
from orchestrator.can.sending.safe_end import Last, SafeEnd
from orchestrator.can.slcan.flow import Flow

SETTINGS = BusSettings("slcan", "port", bitrate=500_000)
URGENT = can.Message(arbitration_id=1, is_extended_id=False, data=bytes(8))


class Adapter:
    """Takes all frames; what it does is kept in order."""

    def __init__(self) -> None:
        self.done: list[str] = []

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        self.done.append(f"{message.arbitration_id:X}")

    def flush_tx_buffer(self) -> None:
        raise NotImplementedError


class Staying(Adapter):
    """One that can forget what waits, and stay on the bus."""

    stays = False

    def flush_tx_buffer(self) -> None:
        self.done.append("forgets")


class Heard:
    """What others send: as much as there is time for, or nothing."""

    def __init__(self, full: bool) -> None:
        self._full, self._until = full, time.monotonic()

    def take(self) -> list[can.Message]:
        count = int((time.monotonic() - self._until) / occupied(URGENT, SETTINGS)) + 1 if self._full else 0
        self._until += count * occupied(URGENT, SETTINGS)
        return [URGENT] * count


def last_frames(adapter: Any, full: bool) -> LastFrames:
    """The end of a replay that has given the adapter five frames."""
    heard: Any = Heard(full)
    last = LastFrames([Channel(SETTINGS, adapter, heard)], SafeEnd(Last([], ["100#0000"]), None))
    last.take(0)
    for _ in range(5):
        last.given(0, can.Message(arbitration_id=0x200, is_extended_id=False, data=bytes(8)))
    return last


def test_on_a_bus_with_room_all_gets_out_in_order() -> None:
    adapter = Staying()
    last = last_frames(adapter, full=False)
    last.send("log")
    assert (adapter.done, adapter.stays, last.sent, last.dropped) == (["100"], False, ["100#0000"], 0)


class Stopped(Staying):
    """One that has stopped to answer: it is given more only where that is insisted on."""

    owed, insists = 1, False

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        if not self.insists:
            raise can.CanTimeoutError("the adapter has stopped to answer")
        super().send(message, timeout)


@pytest.mark.slow
def test_a_last_frame_that_is_left_with_an_adapter_may_follow() -> None:
    adapter = Stopped()
    said = r"ended, and 100#0000 may not have got out: slcan:port has stopped to answer, and the adapter sends it when"
    with pytest.raises(BusError, match=said):
        last_frames(adapter, full=False).send("log")
    assert (adapter.done[-1], adapter.stays) == ("100", True)


class Refusing(Staying):
    """One that does not take the first so many frames, and says so or does not (`refuses`)."""

    def __init__(self, times: float, refuses: bool) -> None:
        super().__init__()
        self.flow = Flow(True)
        self._times, self._refuses = times, refuses

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        super().send(message, timeout)
        with self.flow.giving((message.arbitration_id, False), time.monotonic()):
            pass
        if self._refuses or len(self.done) > self._times:
            self.flow.answered(len(self.done) > self._times, time.monotonic())
        else:
            self.flow.settle()


@pytest.mark.parametrize("refuses", [True, False])
def test_a_last_frame_that_an_adapter_has_refused_or_never_answered_to_is_given_again(refuses: bool) -> None:
    adapter = Refusing(3, refuses)
    last = last_frames(adapter, full=False)
    last.send("log")
    assert (adapter.done, last.sent) == (["100"] * 4, ["100#0000"])


@pytest.mark.slow
@pytest.mark.parametrize(("refuses", "why"), [(True, "refuses frames"), (False, "has stopped to answer")])
def test_a_last_frame_that_an_adapter_never_takes_is_in_doubt(refuses: bool, why: str) -> None:
    adapter = Refusing(math.inf, refuses)
    with pytest.raises(BusError, match=f"100#0000 may not have got out: slcan:port {why}; stop the machine otherwise"):
        last_frames(adapter, full=False).send("log")


@pytest.mark.slow
def test_on_a_full_bus_what_waits_is_forgotten_and_the_last_frame_is_left_with_the_adapter() -> None:
    adapter = Staying()
    last = last_frames(adapter, full=True)
    with pytest.raises(BusError, match="100#0000 may not have got out: slcan:port is full, and the adapter sends it"):
        last.send("log")
    assert (adapter.done, adapter.stays, last.dropped) == (["forgets", "100"], True, 5)


@pytest.mark.slow
def test_nothing_is_promised_of_an_adapter_that_neither_forgets_nor_stays() -> None:
    adapter = Adapter()
    last = last_frames(adapter, full=True)
    with pytest.raises(BusError, match="may not have got out: slcan:port is full; stop the machine otherwise"):
        last.send("log")
    assert (adapter.done, last.dropped, hasattr(adapter, "stays")) == (["100"], 0, False)
