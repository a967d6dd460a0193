"""A scenario on a bus: what it exchanges when, how it ends, and what is left of it however it ends."""

from __future__ import annotations

import errno
import json
import re
import signal
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from typer.testing import CliRunner

from fmus.errors import BusError, FmuError, InputError, ScenarioError
from fmus.packaging import targets
from identification.cli import app
from orchestrator import formats
from orchestrator.bridge import results
from orchestrator.bridge.bridge import BridgeResult, couple
from orchestrator.bridge.preparation import BridgeJob
from orchestrator.can.live import link
from orchestrator.can.live.bus import BusSettings
from orchestrator.can.slcan.hub import hub_process
from orchestrator.engine import LiveRun, Result
from orchestrator.formats import arrows
from orchestrator.realtime.stopping import Stop
from orchestrator.scenario.run import run_scenario
from orchestrator.trace import Trace
from tests.support.coupling_samples import BUS, DBC, ScriptedBus, frame
from tests.support.wiring import HANG, command, until_said, wait_for

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work

STATE, COMMAND, EXACT = 256, 257, 258
SCENARIO: dict[str, Any] = {
    "title": "A hand on a bus",
    "components": {
        "motor": {"fmu": "dc_motor.fmu"},
        "hand": {"fmu": "pendulum.fmu", "parameters": {"angle_start": 0.5}},
    },
    "connections": ["hand.speed -> motor.speed", "motor.torque -> hand.torque"],
    "run": {"stop": 0.2, "step": 0.001},
    "record": ["hand.angle", "hand.speed", "motor.voltage"],
    "can": {
        "database": "rig.dbc",
        "receive": {"motor.voltage": {"signal": "Command.voltage", "safe": 0.25}},
        "send": {"angle": "hand.angle", "speed": {"source": "hand.speed", "safe": 0}},
        "most_late": 1e4,  # a busy computer is no fault
        "give_up": 1e5,
    },
}
LAW: dict[str, Any] = {
    "title": "Energy control on a bus",
    "components": {"law": {"model": "energy_controller", "parameters": {"gain": 0.02, "sample_time": 0.005}}},
    "run": {"stop": 1, "step": 0.005},
    "can": {
        "database": "rig.dbc",
        "receive": {"law.angle": {"signal": "angle", "safe": 0}, "law.speed": {"signal": "speed", "safe": 0}},
        "send": {"voltage": {"source": "law.voltage", "safe": 0}},
        "every": {"Command": 0.005},
        "most_late": 1e4,  # a busy computer is no fault
        "give_up": 1e5,
    },
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with FMUs and a database."""
    folder = tmp_path_factory.mktemp("rig")
    for name in ("dc_motor", "pendulum"):
        targets.build(name, folder / f"{name}.fmu")
    (folder / "rig.dbc").write_text(DBC)
    return folder


def written(folder: Path, **changes: Any) -> Path:
    """The scenario with these changes; those of `can` are within the block."""
    document = SCENARIO | changes
    document["can"] = SCENARIO["can"] | changes.get("can", {})
    path = folder / "rig.yaml"
    path.write_text(json.dumps(document))
    return path


def go(
    folder: Path,
    aside: Path,
    stand_in: bool = False,
    ready: Callable[[Stop], None] = lambda stop: None,
    duration: Fraction | None = None,
    **changes: Any,
) -> BridgeResult:
    return couple(BridgeJob(written(folder, **changes), BUS, stand_in, duration=duration), aside, ready)


def angle_of(message: can.Message) -> float:
    return float(struct.unpack_from("<i", message.data)[0]) * 1e-4


def proportional(message: can.Message) -> list[can.Message]:
    """A peer whose command is 20 mV against each radian."""
    return [frame(COMMAND, struct.pack("<hH", round(-20 * angle_of(message)), 0))] if len(message.data) == 8 else []


def trace_of(coupled: BridgeResult) -> Trace:
    (case,) = coupled.result.cases
    assert case.file is not None
    return formats.read(case.file).trace


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


def test_the_folder_has_record_manifest_and_report(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ScriptedBus(proportional).plug_in(monkeypatch)
    (tmp_path / "aside").mkdir()
    expect = [{"signal": "hand.angle", "below": 0.6}, {"frames_lost": "none"}, {"late_steps": "none"}]
    coupled = go(folder, tmp_path / "aside", expect=expect)
    results.write(coupled, tmp_path / "out")
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["passed"] and manifest["ended"] == "done"
    assert manifest["can"]["received"]["messages"] == {"Command": 199}
    assert manifest["can"]["sent"] == {
        "frames": 201,
        "acknowledged": False,
        "no_room": 0,
        "no_bus": 0,
        "skipped": 0,
        "bus_full": 0,
        "messages": {"State": 201},
    }
    assert manifest["can"]["deadlines"]["steps"] == 200
    assert len(formats.read(tmp_path / "out" / "run.parquet").trace) == 201
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Steps by their lateness." in page and "State" in page and "spare rests at the initial value" in page
    seconds = manifest["can"]["seconds"]
    for way, count in (("received", 199), ("sent", 201)):
        assert f"<dt>frames {way}</dt><dd>{count}</dd><dd class='remark'>{count / seconds:.4g} a second</dd>" in page
    assert re.findall(r'<tr class="group"><th colspan="3">(.*?)</th></tr><tr><th>(.*?)</th>', page)[-2:] == [
        ("received", "Command"),
        ("sent", "State"),
    ]


def test_the_report_of_one_of_several_cases_shows_that_one_and_inputs_of_the_bus_as_such(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ScriptedBus(proportional).plug_in(monkeypatch)
    (tmp_path / "aside").mkdir()
    cases = [{"name": "at rest"}, {"name": "turned", "set": {"hand.angle_start": 0.3}}]
    coupled = go(folder, tmp_path / "aside", cases=cases)
    results.write(coupled, tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "at rest" in page and "turned" not in page
    assert "from the bus" in page and "every 0.001 s" in page
    assert '"label":"input"' not in page  # the safe value, which was not what the bus gave


def test_an_expectation_that_fails_or_looks_beyond_the_record_is_judged_so(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ScriptedBus().plug_in(monkeypatch)
    coupled = go(
        folder,
        tmp_path,
        expect=[{"signal": "hand.angle", "below": 0.1}, {"signal": "hand.angle", "below": 0.6, "after": 9}],
    )
    assert [check.held for check in coupled.result.cases[0].checks] == [False, False]
    assert coupled.result.cases[0].checks[1].found == "there is no sample from 9 to 0.2 s"


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
    assert [bus["channel"] for bus in [account.document(), *account.document()["others"]]] == ["first", "second"]
    assert {angle_of(message) for message in on_second} == {0.0} and (len(on_first), len(on_second)) == (200, 201)
    assert trace_of(coupled)["motor.voltage"].max() == 3


def test_the_command_judges_and_leaves_a_folder(folder: Path, tmp_path: Path) -> None:
    path = written(folder, expect=[{"signal": "hand.angle", "below": 0.1}])
    arguments = ["can", "bridge", path, "--interface", "virtual", "--channel", "c", "--out", tmp_path / "out", "--json"]
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert done.exit_code == 1
    document = json.loads(done.stdout)
    assert document["can"]["mode"] == "bridge" and not document["passed"]
    assert json.loads((tmp_path / "out" / "manifest.json").read_text()) == document
    assert "rig is on virtual:c" in done.stderr


def test_the_command_keeps_the_result_of_a_bus_that_fails(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus = ScriptedBus().plug_in(monkeypatch)
    bus.failure = can.CanOperationError("gone")
    arguments = ["can", "bridge", written(folder), "--interface", "virtual", "--channel", "c", "--out", tmp_path / "o"]
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert done.exit_code == 3
    assert "(gone); the result up to there is in" in done.stderr
    assert json.loads((tmp_path / "o" / "manifest.json").read_text())["ended"] == "failed"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "bench: has no bus; give --interface and --channel, or --serve"),
        (["--serve", "bus", "--channel", "c"], "--serve: makes a bus of its own; leave out --interface and --channel"),
    ],
)
def test_a_bench_wants_one_bus(folder: Path, arguments: list[str], message: str) -> None:
    done = CliRunner().invoke(app, ["can", "bench", str(written(folder)), *arguments])
    assert done.exit_code == 2
    assert message in done.stderr


def test_ctrl_c_ends_a_bench_with_its_result(folder: Path, tmp_path: Path) -> None:
    with command(
        "can", "bench", written(folder), "--interface", "virtual", "--channel", "c", "--out", tmp_path / "out"
    ) as machine:
        until_said(machine, "rig is on virtual:c")
        time.sleep(0.3)
        machine.send_signal(signal.SIGINT)
        said, complaints = machine.communicate(timeout=HANG)
    assert machine.returncode == 130, said + complaints
    assert re.search(r"interrupted after \d\.\d+ s; the result up to there is in .*\n", complaints)
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["ended"] == "stopped"
    assert len(formats.read(tmp_path / "out" / "run.parquet").trace) == manifest["can"]["deadlines"]["steps"] + 1


def test_a_bench_and_a_bridge_close_a_loop_over_serial_adapters(folder: Path, tmp_path: Path) -> None:
    rest = {"motor.voltage": {"signal": "Command.voltage", "safe": 0.0111}}  # no value that can be received
    bench = written(folder, run={"stop": 1, "step": 0.005}, can={"every": {"State": 0.005}, "receive": rest})
    bench = bench.rename(folder / "bench.yaml")
    law = folder / "law.yaml"
    law.write_text(json.dumps(LAW))
    with command("can", "bench", bench, "--serve", tmp_path / "bus", "--out", tmp_path / "bench") as machine:
        wait_for((tmp_path / "bus" / "1").exists)
        with command(
            "can",
            "bridge",
            law,
            "--interface",
            "slcan",
            "--channel",
            tmp_path / "bus" / "1",
            "--bitrate",
            500_000,
            "--out",
            tmp_path / "law",
        ) as controller:
            said, complaints = controller.communicate(timeout=HANG)
            assert controller.returncode == 0, said + complaints
        until_said(machine, "Command is there")
        until_said(machine, "Command: no frame for 0.1 s")
        machine.send_signal(signal.SIGTERM)
        said, complaints = machine.communicate(timeout=HANG)
        assert machine.returncode == 0, said + complaints
    about = {name: json.loads((tmp_path / name / "manifest.json").read_text())["can"] for name in ("bench", "law")}
    sent = about["law"]["sent"]
    count = sent["messages"]["Command"]  # late steps are no burst of frames
    assert about["bench"]["received"]["messages"]["Command"] == count == 201 - sent["no_room"] - sent["skipped"]
    assert sent["acknowledged"] and count > 100
    asked = formats.read(tmp_path / "law" / "run.parquet").trace["law.voltage"]
    acted = formats.read(tmp_path / "bench" / "run.parquet").trace["motor.voltage"]
    assert acted[0] == acted[-1] == 0.0111  # while nobody is there, and in silence again
    taken = np.unique(np.round(acted[acted != 0.0111], 3))
    assert taken.any() and np.isin(taken, np.round([*np.clip(asked, -24, 24), 0.0], 3)).all()
    assert not (tmp_path / "bus" / "0").exists()


def speeds(bus: ScriptedBus) -> list[int]:
    """What was sent as the speed, which has the safe value 0."""
    return [struct.unpack_from("<h", message.data, 4)[0] for message in bus.identified(STATE)]


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


def test_a_full_disk_ends_the_coupling_with_what_was_written(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def small(path: Path) -> Iterator[Callable[[Trace], None]]:
        with original(path) as append:

            def write(piece: Trace) -> None:
                if path.stat().st_size > 3000:
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
    done = CliRunner().invoke(app, [str(part) for part in [*arguments, "--channel", "c", "--out", tmp_path / "out"]])
    assert done.exit_code == 3 and "cannot be written (No space left on device)" in done.stderr
    assert json.loads((tmp_path / "out" / "manifest.json").read_text())["ended"] == "failed"
    monkeypatch.undo()
    assert len(formats.read(tmp_path / "out" / "run.arrows").trace) > 1 and speeds(bus)[-1] == 0
