"""Outputs of a coupling rest where they, or their peers, are not to be trusted; and alarms are given."""

from __future__ import annotations

import struct
from pathlib import Path

import can
import numpy as np
import pytest

from orchestrator.engine import LiveRun, Result
from tests.support.can.coupled import (
    COMMAND,
    STATE,
    go,
    proportional,
    speeds,
)
from tests.support.can.coupling_samples import ScriptedBus, frame

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work


def test_an_output_rests_before_the_first_frame_and_in_silence_and_goes_on_after_good_ones(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def moody(message: can.Message) -> list[can.Message]:
        there = 20 <= len(bus.sent) <= 50 or len(bus.sent) > 100
        return [frame(COMMAND, struct.pack("<hH", 100, 0))] if there else []

    bus = ScriptedBus(moody).plug_in(monkeypatch)
    silence = {"motor.voltage": {"signal": "Command.voltage", "safe": 0.25, "silence": 0.02}}
    go(folder, tmp_path, run={"stop": 0.2, "step": 0.001}, can={"receive": silence, "after": 0.05})
    sent = speeds(bus)
    assert not any(sent[:20]) and all(sent[21:70]) and not any(sent[72:150]) and all(sent[152:200])
    assert sent[-1] == 0


def test_an_output_that_is_not_finite_rests_at_once_and_fails_the_coupling(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def spoil(self: LiveRun[Result]) -> None:
        original(self)
        if 50 <= self.steps < 60:
            self.outputs[self.names.index("hand.speed")] = np.nan

    original = LiveRun.step
    monkeypatch.setattr(LiveRun, "step", spoil)
    bus = ScriptedBus(proportional).plug_in(monkeypatch)
    coupled = go(folder, tmp_path, can={"after": 0.02})
    sent = speeds(bus)
    assert all(sent[40:49]) and not any(sent[49:79]) and any(sent[82:200])
    assert str(coupled.ending.failure) == "hand.speed: was not finite in 10 steps; see to its inputs and parameters"
    assert [event.name for event in coupled.account.watchdog.events if event.kind == "alarm"] == ["hand.speed"]


def test_somebody_else_who_sends_our_message_is_told_at_once(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus = ScriptedBus(lambda message: [frame(STATE, bytes(message.data))] if len(bus.sent) in (10, 20) else []).plug_in(
        monkeypatch
    )
    coupled = go(folder, tmp_path)
    assert coupled.account.foreign == {"State": 2}
    (alarm,) = (event for event in coupled.account.watchdog.events if event.kind == "alarm")
    assert alarm.time < 0.02
    assert "State was also sent by somebody else: 2 frames" in coupled.account.remarks()


def test_who_asks_for_our_message_does_not_send_it(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asking = can.Message(arbitration_id=STATE, is_extended_id=False, is_remote_frame=True, dlc=8)
    bus = ScriptedBus(lambda message: [asking] if len(bus.sent) == 10 else []).plug_in(monkeypatch)
    account = go(folder, tmp_path).account
    assert account.foreign == {} and account.received.remotes == 1


def test_a_stop_signal_ends_the_coupling_and_outputs_rest_without_it(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def panel(message: can.Message) -> list[can.Message]:
        count = len(bus.sent)
        return proportional(message) + ([frame(262, bytes([count >= 100]))] if count > 30 else [])

    bus = ScriptedBus(panel).plug_in(monkeypatch)
    coupled = go(folder, tmp_path, can={"stop": "Other.enable"})
    sent = speeds(bus)
    assert not any(sent[:30]) and all(sent[32:100]) and sent[-1] == 0 and len(sent) < 105
    assert coupled.ending.stopped and coupled.ending.failure is None
    assert [event.name for event in coupled.account.watchdog.events if event.kind == "alarm"] == ["Other"]
