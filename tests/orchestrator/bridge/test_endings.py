"""However a coupling ends, by a wish, a failure, a lost bus or a full disk, it leaves what there is and rests."""

from __future__ import annotations

import errno
import json
import re
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import can
import pytest

from fmus.errors import BusError, FmuError
from orchestrator import formats
from orchestrator.bridge import results
from orchestrator.bridge.bridge import couple
from orchestrator.bridge.preparation import BridgeJob
from orchestrator.can.live import link
from orchestrator.can.live.bus import BusSettings
from orchestrator.can.slcan.hub import hub_process
from orchestrator.engine import LiveRun, Result
from orchestrator.formats import arrows
from orchestrator.realtime.stopping import Stop
from orchestrator.trace import Trace
from tests.support.can.coupled import (
    COMMAND,
    STATE,
    go,
    proportional,
    speeds,
    trace_of,
    written,
)
from tests.support.can.coupling_samples import ScriptedBus, frame
from tests.support.commands import servotwin

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work


def test_the_wish_to_end_leaves_whole_steps_and_sends_the_safe_values(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stops: list[Stop] = []

    def soon(message: can.Message) -> list[can.Message]:
        stops[0].requested = len(bus.sent) > 99
        return proportional(message)

    bus = ScriptedBus(soon).plug_in(monkeypatch)
    coupled = go(folder, tmp_path, ready=stops.append, run={"stop": 100, "step": 0.001})
    *before, last = bus.identified(STATE)
    assert len(trace_of(coupled)) == len(before) + 1 == coupled.account.deadlines.lateness.count + 1
    assert struct.unpack_from("<h", before[-1].data, 4)[0] != 0 == struct.unpack_from("<h", last.data, 4)[0]
    assert coupled.ending.stopped and coupled.result.interrupted and not coupled.result.passed


def test_a_stand_in_that_is_told_to_end_has_passed(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def at_once(stop: Stop) -> None:
        stop.requested = True

    ScriptedBus().plug_in(monkeypatch)
    (tmp_path / "aside").mkdir()
    coupled = go(folder, tmp_path / "aside", stand_in=True, duration=Fraction(9), ready=at_once)
    assert coupled.ending.stopped and coupled.result.passed and not coupled.interrupted
    results.write(coupled, tmp_path / "out")
    assert (tmp_path / "out" / "run.parquet").exists()


def test_a_wish_to_end_that_comes_after_the_last_step_changes_nothing(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stops: list[Stop] = []

    def late(message: can.Message) -> list[can.Message]:
        stops[0].requested = len(bus.sent) > 199
        return []

    bus = ScriptedBus(late).plug_in(monkeypatch)
    coupled = go(folder, tmp_path, ready=stops.append)
    assert stops[0].requested and not coupled.ending.stopped and coupled.result.passed


def test_a_failing_fmu_leaves_its_record_and_the_safe_values(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = 0

    def step(self: LiveRun[Result]) -> None:
        nonlocal steps
        steps += 1
        if steps > 50:
            raise FmuError("hand", "step from t = 0.05 s by 0.001 s: returned error")
        original(self)

    original = LiveRun.step
    monkeypatch.setattr(LiveRun, "step", step)
    bus = ScriptedBus().plug_in(monkeypatch)
    coupled = go(folder, tmp_path)
    assert str(coupled.ending.failure).startswith("hand: step from t = 0.05 s")
    assert len(trace_of(coupled)) == 51
    assert struct.unpack_from("<h", bus.sent[-1].data, 4)[0] == 0


def test_a_bridge_ends_when_its_bus_is_lost_and_a_stand_in_goes_on(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unplug(message: can.Message) -> list[can.Message]:
        if len(bus.sent) == 50:
            bus.failure = can.CanOperationError("the adapter is gone (Input/output error)")
            bus.missing = 10**9
        return [frame(COMMAND, struct.pack("<hH", 100, 0))]

    bus = ScriptedBus(unplug).plug_in(monkeypatch)
    coupled = go(folder, tmp_path)
    assert isinstance(coupled.ending.failure, BusError)
    said = (
        r"virtual:coupling: failed at t = \d+\.\d+ s \(the adapter is gone \(Input/output error\)\); see to the adapter"
    )
    assert re.match(said, str(coupled.ending.failure))
    assert 50 <= len(trace_of(coupled)) < 60
    bus = ScriptedBus(unplug).plug_in(monkeypatch)
    coupled = go(folder, tmp_path, stand_in=True, duration=Fraction(1, 5))
    voltage = trace_of(coupled)["motor.voltage"]
    assert coupled.ending.failure is None and coupled.result.passed and len(voltage) == 201
    assert voltage[40] == pytest.approx(0.1) and (voltage[55:] == 0.25).all()
    assert len(bus.sent) < 60
    assert coupled.account.trouble == "the adapter is gone (Input/output error)"


def test_an_adapter_that_leaves_the_bus_is_lost_to_a_bridge_and_may_come_back_to_a_stand_in(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    off = can.Message(arbitration_id=0x40, is_error_frame=True, is_extended_id=False, dlc=8, data=bytes(8))

    def go_off(message: can.Message) -> list[can.Message]:
        bus.missing = 49 * (len(bus.sent) == 50)
        return [off if bus.missing else frame(COMMAND, struct.pack("<hH", 100, 0))]

    bus = ScriptedBus(go_off).plug_in(monkeypatch)
    assert "(the adapter has left the bus (bus off))" in str(go(folder, tmp_path).ending.failure)
    monkeypatch.setattr(link, "_RETRY", 0.0)  # it is tried in every step
    bus = ScriptedBus(go_off).plug_in(monkeypatch)
    coupled = go(folder, tmp_path, stand_in=True, duration=Fraction(1, 5))
    voltage = trace_of(coupled)["motor.voltage"]
    assert (voltage[50:99] == 0.25).all()
    assert voltage[101:200] == pytest.approx(0.1)
    assert coupled.account.received.errors == 1
    (loss,) = coupled.account.losses
    assert loss.seconds is not None and coupled.account.trouble == ""
    assert coupled.account.unsent + coupled.account.frames == 201
    bus = ScriptedBus(go_off).plug_in(monkeypatch)
    coupled = go(folder, tmp_path, can={"reconnect": True})
    assert coupled.ending.failure is None and coupled.account.loss_count == 1 and coupled.account.trouble == ""


@pytest.mark.parametrize(("trouble", "said"), [("unplug", "the adapter is gone"), ("bus_off", "(bus off)")])
def test_a_serial_adapter_that_is_lost_ends_a_bridge_with_what_there_is(
    folder: Path, tmp_path: Path, trouble: str, said: str
) -> None:
    with hub_process(tmp_path / "bus") as hub:
        path = written(folder, run={"stop": 600, "step": 0.005}, can={"every": {"State": 0.005}})

        def soon(stop: Stop) -> None:
            threading.Timer(0.3, getattr(hub, trouble), [0]).start()

        coupled = couple(BridgeJob(path, BusSettings("slcan", str(hub.paths[0]), 500_000)), tmp_path, soon)
    assert isinstance(coupled.ending.failure, BusError)
    assert said in str(coupled.ending.failure)
    assert 0 < trace_of(coupled).time[-1] < 600


def test_frames_that_came_too_fast_are_said(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bus = ScriptedBus().plug_in(monkeypatch)
    bus.dropped = 7
    said = go(folder, tmp_path).account.remarks()
    assert "7 frames were dropped: they came faster than they could be taken" in said


def test_frames_without_room_in_the_adapter_are_counted_and_the_next_are_sent(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus = ScriptedBus().plug_in(monkeypatch)
    bus.refusing = can.CanTimeoutError("Transmit buffer full")
    coupled = go(folder, tmp_path)
    assert coupled.account.no_room == 201 and coupled.account.frames == 0
    assert "the safe values of State may not have got out" in str(coupled.ending.failure)
    assert "201 frames were not sent: the adapter had no room" in coupled.account.remarks()


def test_a_coupling_ends_in_silence_where_that_is_asked_for(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus = ScriptedBus(lambda message: proportional(message) if len(bus.sent) < 50 else []).plug_in(monkeypatch)
    coupled = go(folder, tmp_path, can={"on_silence": "end", "silence": 0.02})
    assert "a received message fell silent, and `on_silence` is `end`" in str(coupled.ending.failure)
    assert len(bus.sent) < 75


def test_steps_that_are_too_late_end_a_bridge_with_what_there_is(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus = ScriptedBus(proportional).plug_in(monkeypatch)
    offsets = iter([0.0] * 50 + [3.0] * 99)
    monkeypatch.setattr("orchestrator.realtime.pacing.Pace.wait", lambda pace, deadline, stop: deadline + next(offsets))
    coupled = go(folder, tmp_path, can={"give_up": 2.0})
    assert "steps are 3 s late at t = 0.050 s" in str(coupled.ending.failure)
    assert isinstance(coupled.ending.failure, BusError) and speeds(bus)[-1] == 0 and len(trace_of(coupled)) == 51


@pytest.mark.parametrize("room", [3000, 0])  # 0: for not a single row
def test_a_full_disk_ends_the_coupling_with_what_was_written(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    @contextmanager
    def small(path: Path) -> Iterator[Callable[[Trace], None]]:
        with original(path) as append:

            def write(piece: Trace) -> None:
                if path.stat().st_size >= room:
                    raise OSError(errno.ENOSPC, "No space left on device")
                append(piece)

            yield write

    def no_room(source: Path, target: Path) -> bool:
        if target.name == "0.parquet":
            raise OSError(errno.ENOSPC, "No space left on device")
        return settle(source, target)

    original, settle = arrows.appending, arrows.settle
    monkeypatch.setattr(arrows, "appending", small)
    monkeypatch.setattr(arrows, "settle", no_room)
    bus = ScriptedBus(proportional).plug_in(monkeypatch)
    arguments = ["can", "bridge", written(folder, run={"stop": 60, "step": 0.001}), "--interface", "virtual"]
    done = servotwin(*[*arguments, "--channel", "c", "--out", tmp_path / "out"])
    assert done.exit_code == 3 and "cannot be written (No space left on device)" in done.stderr
    assert json.loads((tmp_path / "out" / "manifest.json").read_text())["ended"] == "failed"
    monkeypatch.undo()
    assert (tmp_path / "out" / "run.arrows").exists() and speeds(bus)[-1] == 0
    assert not room or len(formats.read(tmp_path / "out" / "run.arrows").trace) > 1
