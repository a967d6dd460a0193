"""Whatever becomes of the process that steps, the last that a foreign peer sees is the safe value."""

from __future__ import annotations

import json
import os
import re
import signal
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from subprocess import Popen
from typing import Any

import can
import pytest

from fmus.errors import BusError
from orchestrator import formats
from orchestrator.bridge.bus.keeper_process import apart
from orchestrator.can.slcan.hub import Hub, hub_process
from tests.support.can.coupling_samples import DBC, frame, sample_database
from tests.support.can.mapped import couple
from tests.support.can.wiring import BITRATE, HANG, command, joined, settings, wait_for
from tests.support.fmus import brute
from tests.support.fmus.brute import Mood
from tests.support.tools.own_processes import children

pytestmark = pytest.mark.slow  # processes

LAW: dict[str, Any] = {
    "title": "A law on a bus",
    "components": {"law": {"model": "energy_controller", "parameters": {"gain": 0.02, "sample_time": 0.005}}},
    "run": {"stop": 600, "step": 0.005},
    "can": {
        "database": "rig.dbc",
        "receive": {"law.angle": {"signal": "angle", "safe": 0.5}, "law.speed": {"signal": "speed", "safe": 0}},
        "send": {"voltage": {"source": "law.voltage", "safe": 1}},
        "every": {"Command": 0.005},
        "silence": 30,
        "most_late": 0.5,
    },
}


class Peer:
    """A machine that sends its state and keeps the commands that it sees."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus, self.over = bus, threading.Event()
        self.commands: list[float] = []
        self._thread = threading.Thread(target=self._live)
        self._thread.start()

    def _live(self) -> None:
        while not self.over.is_set():
            self._bus.send(frame(256, struct.pack("<ihBx", 5000, 300, 0)))
            until = time.monotonic() + 0.02
            while (message := self._bus.recv(max(0.0, until - time.monotonic()))) is not None:
                if message.arbitration_id == 257:
                    self.commands.append(struct.unpack_from("<h", message.data)[0] * 1e-3)

    def drives(self) -> bool:
        return bool(self.commands) and self.commands[-1] != 1.0

    def rests(self) -> bool:
        return self.commands[-1] == 1.0

    def end(self) -> None:
        self.over.set()
        self._thread.join()


@contextmanager
def driving(folder: Path, law: dict[str, Any] = LAW, how: str = "bridge") -> Iterator[tuple[Popen[str], Peer, Hub]]:
    """A bridge, or a bench, whose commands are not the safe value."""
    (folder / "rig.dbc").write_text(DBC)
    (folder / "law.yaml").write_text(json.dumps(law))
    with hub_process(folder / "bus", 3) as hub, joined(hub.paths[0]) as bus:
        options = ["--interface", "slcan", "--channel", hub.paths[1], "--bitrate", BITRATE, "--out", folder / "out"]
        with command("can", how, folder / "law.yaml", *options) as bridge:
            peer = Peer(bus)
            try:
                wait_for(lambda: peer.drives() or bridge.poll() is not None)
                yield bridge, peer, hub
            finally:
                peer.end()


def stepping(bridge: Popen[str]) -> int:
    """The process that steps, a child of the one that was started."""
    return children(bridge.pid)[0]


def test_safe_values_go_out_when_the_process_that_steps_is_killed(tmp_path: Path) -> None:
    with driving(tmp_path) as (bridge, peer, _):
        time.sleep(1.5)
        os.kill(stepping(bridge), signal.SIGKILL)
        _, complaints = bridge.communicate(timeout=HANG)
        wait_for(peer.rests)
    assert "the steps are gone; safe values were sent" in complaints
    assert bridge.returncode == 3 and peer.rests()
    assert json.loads((tmp_path / "out" / "manifest.json").read_text())["ended"] == "failed"
    assert len(formats.read(tmp_path / "out" / "run.arrows").trace) > 1


@pytest.fixture(scope="module")
def hanging(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return brute.build(tmp_path_factory.mktemp("brute") / "brute.fmu")


def asleep(process: int) -> bool:
    """Whether a process waits for a signal, as an FMU does that hangs."""
    return "pause" in Path(f"/proc/{process}/wchan").read_text()


def moody(fmu: Path, mood: Mood | int, give_up: float) -> dict[str, Any]:
    """A law that drives, and misbehaves after 1 s."""
    can = LAW["can"] | {
        "receive": {"law.flow": {"signal": "speed", "safe": 0}},
        "send": {"voltage": {"source": "law.level", "safe": 1000}},
        "give_up": give_up,
    }
    return LAW | {"components": {"law": {"fmu": str(fmu), "parameters": {"mood": int(mood), "at": 1}}}, "can": can}


@pytest.mark.parametrize(
    ("number", "how", "give_up"),
    [
        (signal.SIGINT, "bridge", 1.5),
        (signal.SIGTERM, "bridge", 1.5),
        (signal.SIGHUP, "bridge", 1.5),
        (signal.SIGQUIT, "bridge", 1.5),
        (signal.SIGTERM, "bridge", 1e3),  # the command gives it up before its guard does
        (signal.SIGINT, "bench", 1.5),
    ],
)
def test_a_wish_to_end_is_one_where_an_fmu_hangs_and_the_last_value_is_the_safe_one(
    tmp_path: Path, hanging: Path, number: signal.Signals, how: str, give_up: float
) -> None:
    with driving(tmp_path, moody(hanging, Mood.HANG, give_up), how) as (bridge, peer, _):
        wait_for(lambda: asleep(stepping(bridge)))
        bridge.send_signal(number)
        _, complaints = bridge.communicate(timeout=HANG)
        assert peer.rests()
    assert bridge.returncode == 130
    assert re.search(r"interrupted; law \(.*brute.fmu\) did not let go\n$", complaints)
    assert "the steps are gone; safe values were sent" in complaints
    assert json.loads((tmp_path / "out" / "manifest.json").read_text())["ended"] == "failed"


GUARD, STEPS, BUS = "the guard", "the steps", "the bus"
IN_PLACE = "safe values were sent by the process that steps"


@pytest.mark.parametrize(
    ("killed", "mood", "how", "says"),
    [
        (GUARD, 0, "bridge", ["the process that watches over the command is gone; the command ends"]),
        (GUARD, Mood.HANG, "bridge", ["over the command is gone", "the steps are gone; safe values were sent"]),
        (GUARD, Mood.HANG, "bench", ["law (", "did not let go", "the steps are gone; safe values were sent"]),
        (STEPS, Mood.HANG, "bench", ["the steps are gone; safe values were sent", "killed (SIGKILL): by somebody"]),
        (BUS, 0, "bench", [IN_PLACE, "the process that has the bus is gone"]),
        (BUS, Mood.HANG, "bridge", [IN_PLACE, "the FMU hangs", "bus is gone, and no step has ended for 3 s"]),
    ],
)
def test_whichever_process_is_killed_the_safe_values_go_out_the_others_end_and_say_so(
    tmp_path: Path, hanging: Path, killed: str, mood: Mood | int, how: str, says: list[str]
) -> None:
    with driving(tmp_path, moody(hanging, mood, give_up=1.5), how) as (command, peer, _):
        steps = stepping(command)
        wait_for((lambda: asleep(steps)) if mood else (lambda: (tmp_path / "out").exists() or peer.drives()))
        os.kill({GUARD: command.pid, STEPS: steps, BUS: children(steps)[0]}[killed], signal.SIGKILL)
        _, complaints = command.communicate(timeout=HANG)  # until none is left that could say something
        wait_for(peer.rests)
    said = " ".join(complaints.split())
    assert all(words in said for words in says) and "Traceback" not in said, said
    assert command.returncode == (-signal.SIGKILL if killed == GUARD else 3)
    ended = json.loads((tmp_path / "out" / "manifest.json").read_text())["ended"]
    assert ended == ("stopped" if killed == GUARD and not mood else "failed")


def test_a_process_that_is_stopped_for_a_time_sends_no_old_commands_and_goes_on(tmp_path: Path) -> None:
    with driving(tmp_path) as (bridge, peer, _):
        pid = stepping(bridge)
        os.kill(pid, signal.SIGSTOP)
        wait_for(peer.rests)
        seen = len(peer.commands)
        wait_for(lambda: len(peer.commands) > seen + 10)
        assert set(peer.commands[seen:]) == {1.0}
        os.kill(pid, signal.SIGCONT)
        wait_for(lambda: peer.drives() or bridge.poll() is not None)
        bridge.send_signal(signal.SIGTERM)
        _, complaints = bridge.communicate(timeout=HANG)
        wait_for(peer.rests)
    assert "voltage rests: no step has ended for 0.505 s" in complaints


def test_a_process_that_hangs_is_ended(tmp_path: Path) -> None:
    with driving(tmp_path) as (bridge, peer, _):
        os.kill(stepping(bridge), signal.SIGSTOP)
        _, complaints = bridge.communicate(timeout=HANG)
        wait_for(peer.rests)
    assert bridge.returncode == 3 and "no step has ended for" in complaints
    assert "hangs, and its process was killed: no step has ended for 4 s" in complaints and "crashed" not in complaints


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_any_number_of_signals_leaves_the_safe_value_and_the_result(tmp_path: Path, number: signal.Signals) -> None:
    with driving(tmp_path) as (bridge, peer, _):
        for _ in range(5):
            with suppress(ProcessLookupError):
                bridge.send_signal(number)
        bridge.communicate(timeout=HANG)
        wait_for(peer.rests)
    assert json.loads((tmp_path / "out" / "manifest.json").read_text())["ended"] == "stopped"
    assert bridge.returncode == 130


def test_safe_values_are_the_first_that_goes_when_a_full_bus_has_room(tmp_path: Path) -> None:
    with driving(tmp_path) as (bridge, peer, hub):
        hub.fill(2)
        time.sleep(2.5)
        bridge.terminate()
        _, complaints = bridge.communicate(timeout=HANG)
        seen = len(peer.commands)
        hub.spare(2)
        wait_for(lambda: len(peer.commands) > seen)
        time.sleep(0.5)
        assert set(peer.commands[seen:]) == {1.0}
    assert bridge.returncode == 3
    assert "the bus is full: what is sent does not get out in time" in complaints
    assert "may not have got out: the bus is full, and the adapter sends them when it has room" in complaints


def test_a_result_that_was_rescued_is_replaced_by_the_next(tmp_path: Path) -> None:
    for _ in range(2):
        with driving(tmp_path) as (bridge, _, _):
            time.sleep(1.5)
            os.kill(stepping(bridge), signal.SIGKILL)
            _, complaints = bridge.communicate(timeout=HANG)
        assert f"the result up to there is in {tmp_path / 'out'}" in complaints
        assert "killed (SIGKILL): by somebody, or as memory was short" in complaints
        assert [path.name for path in tmp_path.glob(".*")] == []


@pytest.mark.parametrize("after", [0.0, 0.15, 0.3, 0.6])
def test_a_bridge_that_is_killed_while_it_ends_leaves_its_result(tmp_path: Path, after: float) -> None:
    with driving(tmp_path) as (bridge, _, _):
        time.sleep(1.5)
        child = stepping(bridge)
        bridge.terminate()
        time.sleep(after)
        with suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        _, complaints = bridge.communicate(timeout=HANG)
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert bridge.returncode == 130 and "interrupted" in complaints
    assert manifest["ended"] == "stopped" or f"the result up to there is in {tmp_path / 'out'}" in complaints
    assert manifest["ended"] in ("stopped", "failed") and list(tmp_path.glob(".*")) == []


@pytest.mark.parametrize(
    ("number", "said"), [(signal.SIGKILL, "is gone"), (signal.SIGSTOP, r"has taken nothing for \d")]
)
def test_the_steps_send_safe_values_where_their_guard_is_gone_or_stands_still(
    tmp_path: Path, number: signal.Signals, said: str
) -> None:
    with driving(tmp_path) as (bridge, peer, _):
        (guard,) = children(stepping(bridge))
        os.kill(guard, number)
        _, complaints = bridge.communicate(timeout=HANG)
        wait_for(peer.rests)
    assert bridge.returncode == 3 and re.search(f"the process that has the bus {said}", complaints)
    assert "safe values were sent by the process that steps" in " ".join(complaints.split())


def test_of_all_that_a_guard_has_not_taken_in_a_pause_the_latest_counts_and_it_hears_of_the_end(tmp_path: Path) -> None:
    block = {"send": {"torque": {"source": "rig.torque", "safe": 0}}, "every": {"Guarded": 0.001}, "most_late": 1e4}
    coupling, said = couple(sample_database(tmp_path), **block), list[str]()
    with hub_process(tmp_path / "bus", 2) as hub:
        others = set(children(os.getpid()))
        with apart([settings(hub.paths[0])], coupling, 0.001, said.append, kills=False) as keeper:
            (guard,) = set(children(os.getpid())) - others
            keeper.begin(time.monotonic())
            os.kill(guard, signal.SIGSTOP)
            for count in range(20_000):  # far more than there is room for
                keeper.send(count, [0.25], 0.0, 0.0)
            os.kill(guard, signal.SIGCONT)
            report = keeper.end()
    assert report.trouble == "" and report.unconfirmed == ()
    assert report.frames + report.skipped == 20_000 + 1  # with the safe value


def test_the_first_step_has_what_came_before_it_however_late_its_guard_is(tmp_path: Path) -> None:
    receive = {"rig.voltage": {"signal": "Command.voltage", "safe": 3}}
    coupling = couple(sample_database(tmp_path), receive=receive, silence=30)
    with hub_process(tmp_path / "bus", 2) as hub, joined(hub.paths[1]) as other:
        others = set(children(os.getpid()))
        with apart([settings(hub.paths[0])], coupling, 0.001, [].append, kills=False) as keeper:
            (guard,) = set(children(os.getpid())) - others
            other.send(frame(257, struct.pack("<hH", 7000, 0)))
            wait_for(lambda: hub.statistics().ports[0].heard == 1)
            time.sleep(0.1)
            os.kill(guard, signal.SIGSTOP)
            threading.Timer(0.04, os.kill, (guard, signal.SIGCONT)).start()
            keeper.begin(time.monotonic())
            assert 7.0 in keeper.inputs(0.0)
            keeper.end()


def test_a_guard_that_stands_still_is_known_by_its_time_however_few_the_steps(tmp_path: Path) -> None:
    block = {"send": {"torque": {"source": "rig.torque", "safe": 0}}, "every": {"Guarded": 1}, "give_up": 2}
    coupling, said = couple(sample_database(tmp_path), **block), list[str]()
    with hub_process(tmp_path / "bus", 2) as hub:
        others = set(children(os.getpid()))
        with apart([settings(hub.paths[0])], coupling, 1.0, said.append, kills=False) as keeper:
            (guard,) = set(children(os.getpid())) - others
            keeper.begin(time.monotonic())
            os.kill(guard, signal.SIGSTOP)
            keeper.send(0, [0.25], 0.0, 0.0)
            keeper.send(1, [0.25], 100.0, 100.0)  # this process, too, stood still
            keeper.send(2, [0.25], 101.0, 101.0)
            with pytest.raises(BusError, match=r"the process that has the bus has taken nothing for 3 s"):
                keeper.send(3, [0.25], 102.0, 102.0)
            report = keeper.end()
    assert report.unconfirmed == () and "safe values were sent by the process that steps" in said[-1]
