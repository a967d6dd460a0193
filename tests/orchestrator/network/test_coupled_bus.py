"""A scenario's bus coupled to a real one puts the frames there that it carries in a run, and takes what comes."""

from __future__ import annotations

import json
import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import can.interfaces.virtual
import pytest

from fmus.errors import InputError
from orchestrator import formats
from orchestrator.bridge.coupled_bus import Coupled
from orchestrator.can.live.bus import BusSettings
from orchestrator.can.slcan.hub import hub_process
from orchestrator.engine import Result, Run, Simulation, Sink
from orchestrator.live.paced import Paced
from orchestrator.live.steering import Steering
from orchestrator.scenario.run import Keeping, run_scenario
from tests.support.can.coupling_samples import frame
from tests.support.can.wiring import BITRATE, HANG, command, joined
from tests.support.commands import servotwin
from tests.support.tools.own_processes import children

Node = Callable[..., Path]
PATIENT = {"most_late": 1e4, "give_up": 1e5}  # a busy computer is no fault
BUS = {"can0": {"nodes": ["a.Can", "b.Can"], "bitrate": 500_000} | PATIENT}
FAST = {"period": 0.004, "first": 0.004}


@pytest.fixture
def peer(tmp_path: Path) -> Iterator[can.BusABC]:
    """Another one on the virtual bus that is called as the folder."""
    with can.Bus(interface="virtual", channel=str(tmp_path)) as bus:
        yield bus


def coupled(file: Path, *channels: str) -> Result:
    buses = tuple(BusSettings("virtual", channel) for channel in channels)
    keeping = Keeping(execute=Coupled(Paced(Steering()), buses).execute)
    found = run_scenario(file, keeping=keeping).cases[0].result
    assert found is not None
    return found


def limited(**times: float) -> dict[str, Any]:
    """The bus with these limits of time."""
    return {"can0": BUS["can0"] | times}


def heard(bus: can.BusABC) -> list[tuple[int, bytes]]:
    return [(frame.arbitration_id, bytes(frame.data)) for frame in iter(lambda: bus.recv(0), None)]


@pytest.mark.slow
def test_the_frames_on_the_bus_are_those_of_the_run(
    node: Node, scenario: Any, peer: can.BusABC, tmp_path: Path
) -> None:
    parts = {"a": (node(), {**FAST, "id": 0x200}), "b": (node(), {"period": 0.006, "first": 0.004})}
    file = scenario(parts, BUS, step=0.01, stop=0.3)
    alone = run_scenario(file).cases[0].result
    assert alone is not None
    live = coupled(file, str(tmp_path))
    frames = [(m.arbitration_id, bytes(m.data)) for m in alone.carried["can0"].frames.messages()]
    assert len(frames) > 100
    assert heard(peer) == frames
    assert live.carried["can0"].frames.time.tolist() == alone.carried["can0"].frames.time.tolist()
    assert live.deadlines is not None


def test_what_comes_from_the_bus_is_received(node: Node, scenario: Any, peer: can.BusABC, tmp_path: Path) -> None:
    file = scenario({"a": (node(), FAST), "b": (node(), {"first": 10})}, BUS, step=0.01, stop=0.5)

    def talk() -> None:
        assert peer.recv(HANG) is not None  # it has begun
        for number in range(3):
            peer.send(can.Message(arbitration_id=0x321, data=[number, 0], is_extended_id=False))

    talking = threading.Thread(target=talk)
    talking.start()
    found = coupled(file, str(tmp_path))
    talking.join()
    assert found.trace["a.received"][-1] == 3
    assert found.trace["a.last_id"][-1] == 0x321
    frames = list(found.carried["can0"].frames.messages())
    assert [frame.arbitration_id for frame in frames].count(0x321) == 3
    taken = [frame for frame in frames if frame.timestamp <= 0.49]  # those of the last step are for the next
    assert found.trace["b.received"][-1] == len(taken) == len(frames) - 2
    assert {identifier for identifier, _ in heard(peer)} == {0x100}


def test_what_comes_before_the_first_step_is_left_out(
    node: Node, scenario: Any, peer: can.BusABC, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = scenario({"a": (node(), {"first": 10}), "b": (node(), {"first": 10})}, BUS, step=0.01, stop=0.1)

    class Early(Paced):
        def execute(self, simulation: Simulation, run: Run, sink: Sink | None = None) -> Result:
            peer.send(can.Message(arbitration_id=0x321, is_extended_id=False))
            return super().execute(simulation, run, sink)

    buses = (BusSettings("virtual", str(tmp_path)),)
    found = run_scenario(file, keeping=Keeping(execute=Coupled(Early(Steering()), buses).execute)).cases[0].result
    assert found is not None and found.trace["a.received"][-1] == 0
    assert "1 frames were left out: they came before the first step" in caplog.text


@pytest.mark.slow
def test_a_network_fmu_that_hangs_ends_with_its_command(node: Node, scenario: Any, tmp_path: Path) -> None:
    parts = {"a": (node(), FAST), "b": (node(), {"first": 10, "hangs": 1})}
    file = scenario(parts, limited(give_up=1), step=0.01, stop=600)
    with hub_process(tmp_path / "bus", 2) as hub:
        options = ["--interface", "slcan", "--channel", hub.paths[1], "--bitrate", BITRATE, "--out", tmp_path / "out"]
        with command("can", "bridge", file, *options) as bridge:
            _, complaints = bridge.communicate(timeout=HANG)
    assert (
        bridge.returncode == 3 and "the FMU hangs, and its process was killed: no step has ended for 2 s" in complaints
    )
    assert "network FMUs send here, and have no safe values" in complaints


@pytest.mark.slow
def test_network_fmus_whose_steps_are_too_late_end_with_their_result(node: Node, scenario: Any, tmp_path: Path) -> None:
    file = scenario({"a": (node(), FAST), "b": (node(), {})}, limited(give_up=1), step=0.01, stop=600)
    with hub_process(tmp_path / "bus", 2) as hub, joined(hub.paths[0]) as other:
        options = ["--interface", "slcan", "--channel", hub.paths[1], "--bitrate", BITRATE, "--out", tmp_path / "out"]
        with command("can", "bridge", file, *options) as bridge:
            assert other.recv(HANG) is not None
            (process,) = children(bridge.pid)
            os.kill(process, signal.SIGSTOP)
            time.sleep(1.5)
            os.kill(process, signal.SIGCONT)
            _, complaints = bridge.communicate(timeout=HANG)
    said = " ".join(complaints.split())
    assert bridge.returncode == 3 and re.search(r"steps are [\d.]+ s late; give it a faster machine", said), said
    assert len(formats.read(tmp_path / "out" / "run.parquet").trace) > 1


@pytest.mark.slow
def test_after_a_pause_of_its_process_no_old_frames_pass_either_way(node: Node, scenario: Any, tmp_path: Path) -> None:
    parts = {"a": (node(), FAST), "b": (node(), {"first": 10})}
    file = scenario(parts, limited(most_late=0.05), step=0.01, stop=4)
    with hub_process(tmp_path / "bus", 2) as hub, joined(hub.paths[0]) as other:
        options = ["--interface", "slcan", "--channel", hub.paths[1], "--bitrate", BITRATE, "--out", tmp_path / "out"]
        with command("can", "bridge", file, *options, "--json") as bridge:
            before = [other.recv(HANG) for _ in range(20)]
            (process,) = children(bridge.pid)
            os.kill(process, signal.SIGSTOP)
            for number in range(50):
                other.send(frame(0x321, bytes([number])))
                time.sleep(0.02)
            os.kill(process, signal.SIGCONT)
            said, complaints = bridge.communicate(timeout=HANG)
            after = list(iter(lambda: other.recv(0.2), None))
    assert bridge.returncode == 0, complaints
    told = json.loads(said)["cases"][0]["buses"]["can0"]
    remarks = " ".join(told["remarks"])
    unsent = sum(map(int, re.findall(r"(\d+) frames were not sent: steps were too late", remarks)))
    assert unsent > 200 and f"{unsent} frames were not sent: steps were too late" in " ".join(complaints.split())
    dropped = sum(map(int, re.findall(r"(\d+) frames were dropped", remarks)))
    assert dropped > 40
    own = told["frames"] - (50 - dropped)
    assert len(before) + len(after) == own - unsent


@pytest.mark.slow
def test_a_lost_bus_ends_network_fmus_with_their_result(node: Node, scenario: Any, tmp_path: Path) -> None:
    class Unplugged(can.interfaces.virtual.VirtualBus):
        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            raise can.CanOperationError("unplugged")

    file = scenario({"a": (node(), FAST), "b": (node(), {"first": 10})}, BUS, step=0.01, stop=60)
    command = ["can", "bridge", file, "--interface", "virtual", "--channel", tmp_path, "--out", tmp_path / "out"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("orchestrator.can.live.link.open_bus", lambda settings: Unplugged(str(tmp_path)))
        done = servotwin(*command)
    assert done.exit_code == 3 and "is lost (unplugged); see to the adapter" in " ".join(done.stderr.split())
    assert len(formats.read(tmp_path / "out" / "run.parquet").trace) > 1


def test_there_is_one_real_bus_for_each(node: Node, scenario: Any, tmp_path: Path) -> None:
    file = scenario({"a": (node(), {}), "b": (node(), {})}, BUS)
    with pytest.raises(InputError, match=r"2 buses for 1 of the scenario \(can0\); give one each"):
        coupled(file, str(tmp_path), f"{tmp_path}x")


def test_direct_wires_alone_are_not_coupled(node: Node, scenario: Any, tmp_path: Path) -> None:
    file = scenario({"a": (node(), {}), "b": (node(), {})}, {"wire": {"nodes": BUS["can0"]["nodes"], "direct": True}})
    with pytest.raises(InputError, match=r"has only direct wires, .*; join the nodes by a bus without `direct`"):
        coupled(file, str(tmp_path))


@pytest.mark.slow
def test_the_command_bridges_network_fmus(node: Node, scenario: Any, tmp_path: Path) -> None:
    file = scenario({"a": (node(), FAST), "b": (node(), {})}, BUS, step=0.01, stop=0.1)
    command = ["can", "bridge", str(file), "--interface", "virtual", "--channel", str(tmp_path), "--json"]
    done = servotwin(*command, "--out", str(tmp_path / "out"))
    assert done.exit_code == 0, done.stderr
    told = json.loads(done.stdout)["cases"][0]
    assert told["buses"]["can0"]["frames"] > 20
    assert "deadlines" in told
    refused = servotwin(*command, "--duration", "1")
    assert refused.exit_code == 2
    assert "--duration: is the scenario's" in refused.stderr
