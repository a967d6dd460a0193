"""What becomes of safe values where a bus is full, or an adapter keeps or refuses them."""

from __future__ import annotations

import math
import struct
import time
from fractions import Fraction
from functools import partial

import can
import pytest

from orchestrator.bridge.bus.traffic import on_buses
from orchestrator.bridge.mapping import coupled
from orchestrator.can.database.database import Database
from orchestrator.can.live.bus import BusSettings, occupied
from orchestrator.scenario.can_block import CanBlock
from tests.support.can.coupling_samples import ScriptedBus, frame, sample_system
from tests.support.can.passing import BLOCK, COMMAND, STEP, THEIRS, TIMED, on, run, torques
from tests.support.can.scripted_adapter import ScriptedAdapter, willing
from tests.support.can.wiring import wait_for


class _Flooded(ScriptedBus):
    """A bus that others fill from some time on, for so long [s]."""

    begun = 0.0
    heard = 0
    seconds = math.inf

    def flood(self, seconds: float = math.inf) -> None:
        self.begun, self.seconds = time.monotonic(), seconds

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if not self.waiting and self.begun:
            passed = int(min(time.monotonic() - self.begun, self.seconds) / occupied(THEIRS, TIMED))
            self.waiting += [THEIRS] * (passed - self.heard)
            self.heard = passed
        return super().recv(timeout)


def test_on_a_full_bus_old_commands_are_dropped_and_safe_values_are_first_and_nothing_follows(rig: Database) -> None:
    """Others take all of the bus from 0.2 s to 1 s."""
    bus, said = ScriptedBus(), list[str]()
    traffic = on(bus, rig, said, TIMED, silence=5)
    for number in range(1500):
        bus.waiting.append(frame(COMMAND, struct.pack("<hH", number, 0)))
        bus.waiting += [THEIRS] * (4 * (200 <= number < 1000))
        traffic.receive(number * STEP)
        traffic.send(number, [0.25], number * STEP, 0.0)
    [kept] = bus.forgotten
    after = torques(bus)[kept:]
    assert len(after) < 60 and after[0] == pytest.approx(0.125, abs=5e-4)
    assert after[-1] == pytest.approx(0.25, abs=5e-4)
    [told, *_] = [line for line in said if "full" in line]
    assert told.endswith("the bus is full: what is sent does not get out in time")
    assert any("torque rests: the bus is full" in line for line in said)
    assert traffic.report(1.5).blocked + traffic.report(1.5).sent.messages["Guarded"] == pytest.approx(150, abs=3)


def test_safe_values_that_a_full_bus_keeps_stay_in_the_adapter_alone_and_that_is_said(
    rig: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("orchestrator.bridge.bus.traffic._CONFIRMING", 0.5)
    bus, said = _Flooded(), list[str]()
    traffic = on(bus, rig, said, TIMED)
    run(traffic, bus, 0, 100)
    bus.flood()
    traffic.end(0.1)
    report = traffic.report(0.6)
    assert report.unconfirmed == ("Guarded",) and report.pending and bus.stays
    assert "the adapter sends them when it has room" in report.doubt()
    assert len(bus.forgotten) == 1
    assert torques(bus)[bus.forgotten[0] :] == pytest.approx([0.125], abs=5e-4)


@pytest.mark.slow
def test_an_adapter_whose_bus_was_full_at_the_end_forgets_nothing_even_where_all_seems_to_be_out(
    rig: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("orchestrator.bridge.bus.traffic._CONFIRMING", 60)
    for flooded in (True, False):
        bus, said = _Flooded(), list[str]()
        traffic = on(bus, rig, said, TIMED)
        run(traffic, bus, 0, 100)
        if flooded:
            bus.flood(seconds=1)
        traffic.end(0.1)
        report = traffic.report(0.6)
        assert (report.unconfirmed, report.pending) == ((), "")
        assert bus.stays == flooded == bool(bus.forgotten)


class Keeping:
    """An adapter that answers to everything but to frames, from one on that it is given."""

    def __init__(self, first: int, last: float = math.inf) -> None:
        self.first, self.last, self.frames = first, last, 0

    def has(self, count: int) -> bool:
        return self.frames >= count

    def __call__(self, line: bytes) -> bytes:
        self.frames += line[:1] == b"t"
        return b"" if line[:1] == b"t" and self.first <= self.frames <= self.last else willing(line)


@pytest.mark.parametrize(
    ("keeping", "unconfirmed"),
    [(Keeping(10_000), ()), (Keeping(5, 5), ()), (Keeping(21), ("Guarded",))],  # the 21st is the safe one
)
def test_safe_values_of_which_the_adapter_never_says_that_it_took_them_are_in_doubt(
    rig: Database, keeping: Keeping, unconfirmed: tuple[str, ...]
) -> None:
    block = CanBlock.model_validate({"database": rig.path} | BLOCK)
    coupling, start = coupled(block, sample_system(), [rig], Fraction(1, 1000)), time.monotonic()
    (message,) = coupling.sent
    with ScriptedAdapter(keeping) as adapter:
        with on_buses([BusSettings("slcan", adapter.path, 500_000)], coupling, STEP, lambda line: None) as traffic:
            traffic.begin(start)
            for number in range(20):
                traffic.send(number * message.every, [0.5], time.monotonic() - start, 0.0)
                wait_for(partial(keeping.has, number + 1))
            ended = time.monotonic() - start
            traffic.end(ended)
            assert traffic.report(ended).unconfirmed == unconfirmed
        wait_for(lambda: unconfirmed or adapter.lines[-1] == b"C")
        assert adapter.lines.count(b"C") == (1 if unconfirmed else 2)  # it stays on the bus, to send what it keeps


class Refusal:
    """An adapter that refuses all frames from one on, but so many of them."""

    def __init__(self, first: int, times: float = math.inf) -> None:
        self.first, self.times, self.frames = first, times, 0

    def __call__(self, line: bytes) -> bytes:
        self.frames += line[:1] == b"t"
        return b"\a" if line[:1] == b"t" and 0 <= self.frames - self.first < self.times else willing(line)


@pytest.mark.slow
@pytest.mark.parametrize("first", [21, 1])  # the 21st is the safe one
@pytest.mark.parametrize(("times", "unconfirmed"), [(22, ()), (math.inf, ("Guarded",))])
def test_safe_values_that_the_adapter_refuses_are_sent_until_it_takes_them_also_where_it_has_refused_all(
    rig: Database, first: int, times: float, unconfirmed: tuple[str, ...]
) -> None:
    block = CanBlock.model_validate({"database": rig.path} | BLOCK | {"silence": 0.2})
    coupling, start, refusal = (
        coupled(block, sample_system(), [rig], Fraction(1, 1000)),
        time.monotonic(),
        Refusal(first, times),
    )
    (message,) = coupling.sent
    with (
        ScriptedAdapter(refusal) as adapter,
        on_buses([BusSettings("slcan", adapter.path, 500_000)], coupling, STEP, lambda line: None) as traffic,
    ):
        traffic.begin(start)
        for number in range(20):
            traffic.send(number * message.every, [0.5], time.monotonic() - start, 0.0)
            time.sleep(0.015)
        traffic.end(time.monotonic() - start)
        report = traffic.report(time.monotonic() - start)
        assert (report.unconfirmed, report.pending) == (unconfirmed, "")
        assert bool(report.trouble) == (first == 1)
        assert adapter.frames[-1].startswith(b"t10347D00")  # 0.125
