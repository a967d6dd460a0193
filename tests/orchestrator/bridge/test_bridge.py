"""A scenario on a bus: what it exchanges, and when."""

from __future__ import annotations

import json
import struct
import threading
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from fmus.errors import InputError, ScenarioError
from fmus.json_document import document_of
from orchestrator import formats
from orchestrator.bridge.bridge import couple
from orchestrator.bridge.preparation import BridgeJob
from orchestrator.can.live.bus import BusSettings
from orchestrator.scenario.run import run_scenario
from orchestrator.trace import Trace
from tests.support.can.coupled import (
    COMMAND,
    SCENARIO,
    STATE,
    angle_of,
    go,
    proportional,
    trace_of,
    written,
)
from tests.support.can.coupling_samples import BUS, DBC, ScriptedBus, frame

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work


def test_an_answer_acts_one_step_after_the_value_that_it_answers(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ScriptedBus(proportional).plug_in(monkeypatch)
    trace = trace_of(go(folder, tmp_path, stand_in=True, duration=Fraction(1, 5)))
    expected = -20 * np.round(trace["hand.angle"][:-2] * 1e4) / 1e4
    assert trace["motor.voltage"][0] == 0.25
    np.testing.assert_allclose(trace["motor.voltage"][1:-1], np.round(expected) * 1e-3, atol=1e-12)
    assert np.ptp(trace["hand.angle"]) > 1e-3


def test_a_coupled_run_is_the_run_with_what_was_received_as_its_stimuli(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ScriptedBus(proportional).plug_in(monkeypatch)
    trace = trace_of(go(folder, tmp_path))
    formats.write(trace.select(["motor.voltage"]), folder / "voltage.parquet")
    given = {"file": "voltage.parquet", "signal": "motor.voltage", "interpolation": "hold"}
    offline = folder / "offline.yaml"
    plain = {key: value for key, value in SCENARIO.items() if key != "can"} | {"stimuli": {"motor.voltage": given}}
    offline.write_text(json.dumps(plain))
    (case,) = run_scenario(offline).cases
    assert case.result is not None
    for name in trace.names:
        assert trace[name].tobytes() == case.result.trace[name].tobytes()


def test_messages_go_out_at_their_periods_with_what_is_seen_at_that_time(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus = ScriptedBus().plug_in(monkeypatch)
    trace = trace_of(go(folder, tmp_path, can={"every": {"State": 0.01}}))
    *cyclic, last = bus.identified(STATE)
    assert [angle_of(message) for message in cyclic] == pytest.approx(trace["hand.angle"][0:200:10], abs=0.5001e-4)
    assert angle_of(last) == angle_of(cyclic[-1])  # it has no safe value
    assert struct.unpack_from("<h", last.data, 4)[0] == 0


def test_it_takes_as_long_as_the_run_that_it_is(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ScriptedBus().plug_in(monkeypatch, punctual=False)
    coupled = go(folder, tmp_path)
    assert coupled.ending.elapsed >= 0.2
    assert coupled.account.deadlines.lateness.count == 200


def test_silence_puts_inputs_to_their_safe_value_until_frames_come_back(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = 0

    def moody(message: can.Message) -> list[can.Message]:
        nonlocal steps
        steps += 1
        return [frame(COMMAND, struct.pack("<hH", 100, 0))] if steps <= 50 or steps > 150 else []

    ScriptedBus(moody).plug_in(monkeypatch)
    silence = {"receive": {"motor.voltage": {"signal": "Command.voltage", "safe": 0.25, "silence": 0.02}}}
    coupled = go(folder, tmp_path, can=silence)
    voltage = trace_of(coupled)["motor.voltage"]
    assert voltage[1:60] == pytest.approx(0.1) and voltage[151:] == pytest.approx(0.1)
    assert voltage[130:150] == pytest.approx(0.25)
    kinds = [event.kind for event in coupled.account.watchdog.events]
    assert kinds == ["first", "runs", "silent", "rests", "back"]
    assert coupled.account.watchdog.messages["Command"].silences == 1


def test_constants_and_files_drive_other_inputs_meanwhile(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ScriptedBus().plug_in(monkeypatch)
    time_ = np.linspace(0, 0.2, 201)
    formats.write(Trace(time_, {"torque": 0.01 * time_}, {"torque": "N.m"}), folder / "torque.parquet")
    coupled = go(
        folder,
        tmp_path,
        stand_in=True,
        duration=Fraction(1, 4),
        connections=["hand.speed -> motor.speed"],
        record=["hand.torque", "motor.voltage"],
        stimuli={"hand.torque": {"file": "torque.parquet", "signal": "torque"}},
    )
    torque = trace_of(coupled)["hand.torque"]
    assert torque[:201] == pytest.approx(0.01 * time_)
    assert (torque[201:250] == torque[200]).all()


REFUSED: list[tuple[dict[str, Any], dict[str, Any], str]] = [
    ({"can": {"receive": {"motor.volts": {"signal": "gear", "safe": 0}}}}, {}, "no variable 'volts' in 'motor'"),
    ({"can": {"receive": {"hand.torque": {"signal": "gear", "safe": 0}}}}, {}, "hand.torque: has two sources, motor"),
    ({"stimuli": {"motor.voltage": {"constant": 1}}}, {}, "has two sources, a stimulus and a signal of the bus"),
    ({"can": {"database": "other.dbc"}}, {}, "other.dbc: "),
    ({"recorder": {"signals": {"a": "hand.angle"}, "every": 0.01}}, {}, "has a recorder, which samples a whole record"),
    ({}, {"case": "fast"}, "--case fast: there is no such case; choose run"),
    ({}, {"duration": Fraction(1, 3000)}, "--duration: 1/3000 s is not a multiple of 0.001 s; use 0.001 s"),
    ({}, {"bus": BusSettings("virtual", "x", 100_000)}, "is too slow: what is sent needs 1"),
    (
        {"can": {"send": {"wide": "hand.angle"}, "every": {"Wide": 0.01}}},
        {},
        "is no CAN FD bus, but Wide has CAN FD fr",
    ),
    ({}, {"overrides": {"motor.voltage": 1.0}}, "motor.voltage: takes its value from a stimulus"),
]


@pytest.mark.parametrize(("changes", "options", "message"), REFUSED)
def test_what_does_not_fit_is_refused_before_the_bus_is_touched(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    changes: dict[str, Any],
    options: dict[str, Any],
    message: str,
) -> None:
    bus = ScriptedBus().plug_in(monkeypatch)
    with pytest.raises(InputError) as refused:
        couple(replace(BridgeJob(written(folder, **changes), BUS), **options), tmp_path)
    assert message in str(refused.value)
    assert bus.sent == []


def test_a_scenario_without_a_bus_is_refused_by_the_bridge(folder: Path, tmp_path: Path) -> None:
    path = folder / "plain.yaml"
    path.write_text(json.dumps({key: value for key, value in SCENARIO.items() if key != "can"}))
    with pytest.raises(ScenarioError, match=r"plain\.yaml: has no `can` block; say what is received and sent"):
        couple(BridgeJob(path, BUS), tmp_path)


def test_a_plain_run_takes_the_safe_values(folder: Path) -> None:
    (case,) = run_scenario(written(folder)).cases
    assert case.result is not None
    assert (case.result.trace["motor.voltage"] == 0.25).all()


def test_a_peer_in_another_thread_is_heard_over_a_virtual_bus(folder: Path, tmp_path: Path) -> None:
    heard: list[can.Message] = []
    answers: list[can.Message] = []
    over = threading.Event()
    with can.Bus("peers", "virtual") as peer:

        def answer() -> None:
            while (message := peer.recv(0.1)) is not None or not over.is_set():
                if message is not None:
                    heard.append(message)
                    answers.extend(proportional(message))
                    peer.send(answers[-1])

        thread = threading.Thread(target=answer)
        job = BridgeJob(written(folder), BusSettings("virtual", "peers"), True, duration=Fraction(1, 2))
        coupled = couple(job, tmp_path, lambda stop: thread.start())
        over.set()
        thread.join()
    assert len(heard) == 501
    assert 0 < coupled.account.received.messages["Command"] <= 501
    voltages = [0.25, *(struct.unpack_from("<h", message.data)[0] * 1e-3 for message in answers)]
    assert np.isin(np.round(trace_of(coupled)["motor.voltage"], 3), np.round(voltages, 3)).all()


def test_each_bus_carries_its_own_messages(folder: Path, tmp_path: Path) -> None:
    """Angle and voltage on one bus, the speed on another."""
    (folder / "drive.dbc").write_text(DBC.replace("State", "Drive").replace("angle", "turn").replace("speed", "rate"))
    send = {"angle": "hand.angle", "Drive.rate": {"source": "hand.speed", "safe": 0}}
    several = {"channel": {"Drive": 1}, "database": {"all": "rig.dbc", "1": "drive.dbc"}}
    path = written(folder, can=several | {"send": send})
    with can.Bus("first", "virtual") as first, can.Bus("second", "virtual") as second:
        buses = [BusSettings("virtual", name) for name in ("first", "second")]
        job = BridgeJob(path, buses[0], duration=Fraction(1, 5), others=(buses[1],))
        first.send(frame(COMMAND, struct.pack("<hH", 100, 0)))
        coupled = couple(job, tmp_path, lambda stop: first.send(frame(COMMAND, struct.pack("<hH", 3000, 0))))
        on_first, on_second = (list(iter(partial(bus.recv, 0.0), None)) for bus in (first, second))
    account = coupled.account
    assert account.sent.messages == {"can0.State": 200, "can1.Drive": 201}
    assert account.received.messages == {"can0.Command": 1}
    told: Any = document_of(account)
    assert [bus["channel"] for bus in [told, *told["others"]]] == ["first", "second"]
    assert {angle_of(message) for message in on_second} == {0.0} and (len(on_first), len(on_second)) == (200, 201)
    assert trace_of(coupled)["motor.voltage"].max() == 3
