"""A scenario's bus coupled to a real one puts the frames there that it carries in a run, and takes what comes."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from fmus.errors import InputError
from orchestrator.bridge.coupled_bus import Coupled
from orchestrator.can.live.bus import BusSettings
from orchestrator.engine import Result
from orchestrator.live.paced import Paced
from orchestrator.live.steering import Steering
from orchestrator.scenario.run import Keeping, run_scenario
from tests.support.commands import servotwin

Node = Callable[..., Path]
BUS = {"can0": {"nodes": ["a.Can", "b.Can"], "bitrate": 500_000}}
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


def heard(bus: can.BusABC) -> list[tuple[int, bytes]]:
    return [(frame.arbitration_id, bytes(frame.data)) for frame in iter(lambda: bus.recv(0), None)]


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
    file = scenario({"a": (node(), {"first": 10}), "b": (node(), {"first": 10})}, BUS, step=0.01, stop=0.5)

    def talk() -> None:
        time.sleep(0.1)
        for number in range(3):
            peer.send(can.Message(arbitration_id=0x321, data=[number, 0], is_extended_id=False))

    talking = threading.Thread(target=talk)
    talking.start()
    found = coupled(file, str(tmp_path))
    talking.join()
    assert found.trace["a.received"][-1] == found.trace["b.received"][-1] == 3
    assert found.trace["a.last_id"][-1] == 0x321
    assert heard(peer) == []


def test_there_is_one_real_bus_for_each(node: Node, scenario: Any, tmp_path: Path) -> None:
    file = scenario({"a": (node(), {}), "b": (node(), {})}, BUS)
    with pytest.raises(InputError, match=r"2 buses for 1 of the scenario \(can0\); give one each"):
        coupled(file, str(tmp_path), f"{tmp_path}x")


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
