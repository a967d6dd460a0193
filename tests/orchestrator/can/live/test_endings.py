"""A recording on disk holds every frame that was received, however it ends, and says what ended it."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import pytest

from fmus.json_document import document_of
from orchestrator.can.live.bus import send
from orchestrator.can.live.manifest import BusRecording
from orchestrator.can.live.recorder import record
from orchestrator.can.slcan.hub import Hub, hub_process
from tests.support.can.recordings import frames, manifest, numbers, on_disk, recorded
from tests.support.can.wiring import BITRATE, HANG, command, frame, joined, number, settings, until_said, wait_for

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work


@pytest.fixture(scope="module")
def hub(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hub]:
    """Three adapters on a bus of 500 kbit/s."""
    with hub_process(tmp_path_factory.mktemp("ports"), 3) as running:
        yield running


@contextmanager
def recording(hub: Hub, folder: Path, *options: object) -> Iterator[subprocess.Popen[str]]:
    """`can record` on port 1, on the bus by now."""
    bus = ("--interface", "slcan", "--channel", hub.paths[1], "--bitrate", BITRATE)
    with command("can", "record", *bus, "--out", folder, *options) as process:
        wait_for(lambda: (folder / "manifest.json").exists() or process.poll() is not None)
        yield process


def tell_all(process: subprocess.Popen[str], number: signal.Signals) -> None:
    """Send a signal to the command and to the process in which it works."""
    workers = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    for pid in (*map(int, workers), process.pid):
        os.kill(pid, number)


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_every_frame_that_was_received_is_on_disk_after_a_signal(hub: Hub, tmp_path: Path, end: signal.Signals) -> None:
    folder, count = tmp_path / "run", 1500
    with recording(hub, folder, "--json") as process, joined(hub.paths[0]) as sender:
        heard = hub.statistics().ports[1].heard + count
        for k in range(count):
            send(sender, frame(k))
        wait_for(lambda: hub.statistics().ports[1].heard == heard)
        time.sleep(0.3)
        process.send_signal(end)
        answer, said = process.communicate(timeout=HANG)
    assert process.returncode == 0, said
    assert json.loads(answer) == manifest(folder)
    statuses = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
    assert statuses and statuses[-1].keys() >= {"work", "fraction", "frames", "frames_per_s", "load"}
    assert numbers(folder) == list(range(count))
    document = manifest(folder)
    assert (document["ended"], document["frames"], document["dropped"]) == ("stopped", count, 0)
    (file,) = document["files"]
    content = (folder / file["file"]).read_bytes()
    assert (file["bytes"], file["sha256"]) == (len(content), hashlib.sha256(content).hexdigest())
    assert len(list(can.BLFReader(folder / file["file"]))) == count


def worker(process: subprocess.Popen[str]) -> int:
    """The process that works for a command; the command itself only watches it."""
    (child,) = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    return int(child)


def test_a_killed_recorder_leaves_what_was_on_disk_in_time(hub: Hub, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with recording(hub, folder) as process, joined(hub.paths[0]) as sender:
        for k in range(200):
            send(sender, frame(k))
        wait_for(lambda: on_disk(folder) == 200)
        os.kill(worker(process), signal.SIGKILL)
        _, said = process.communicate(timeout=HANG)
    assert process.returncode not in (0, 130)
    assert "SIGKILL" in said
    assert numbers(folder) == list(range(200))
    assert manifest(folder)["ended"] == "unfinished"


def test_a_recorder_whose_command_is_killed_ends_its_recording(hub: Hub, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with recording(hub, folder) as process, joined(hub.paths[0]) as sender:
        own = worker(process)
        for k in range(200):
            send(sender, frame(k))
        wait_for(lambda: on_disk(folder) == 200)
        process.kill()
        process.communicate(timeout=HANG)  # until nobody holds the other end of what it says
        wait_for(lambda: not Path(f"/proc/{own}/exe").exists())
    assert numbers(folder) == list(range(200))
    assert manifest(folder)["ended"] == "stopped"


def test_an_unplugged_adapter_ends_the_recording_with_what_it_has(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with (
        hub_process(tmp_path / "ports", 2) as hub,
        recording(hub, folder) as process,
        joined(hub.paths[0]) as sender,
    ):
        for k in range(100):
            send(sender, frame(k))
        wait_for(lambda: on_disk(folder) == 100)
        hub.unplug(1)
        _, said = process.communicate(timeout=HANG)
    assert process.returncode == 3
    assert "failed after 100 frames (the adapter is gone" in said
    assert numbers(folder) == list(range(100))
    assert manifest(folder)["ended"] == "failed"
    assert "gone" in manifest(folder)["failure"]


def until_something_came(share: float, doing: str) -> None:
    """End the recording when there are frames."""
    if not doing.startswith("0 frames"):
        signal.raise_signal(signal.SIGINT)


def test_at_the_wrong_bit_rate_nothing_is_heard_and_it_is_said(hub: Hub, tmp_path: Path) -> None:
    wrong = BusRecording(settings(hub.paths[1], bitrate=250_000), tmp_path / "run", duration=HANG)
    with joined(hub.paths[0]) as sender:

        def send_some() -> None:
            for message in frames(150):
                send(sender, message)

        found = document_of(record(wrong, until_something_came, send_some))
    assert found["frames"] == found["error_frames"] > 0
    assert any("bit rate" in line for line in found["remarks"])
    assert all(message.is_error_frame for message in recorded(tmp_path / "run"))


def test_bus_off_is_reported(hub: Hub, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    recording = BusRecording(settings(hub.paths[1]), tmp_path / "run", duration=HANG)
    found = record(recording, until_something_came, lambda: hub.bus_off(1))
    assert len(found.bus_off) == 1
    assert "bus off" in caplog.text and "1 error frames" in caplog.text
    assert any("bus off" in line for line in found.remarks)


def test_what_one_adapter_goes_on_to_hear_is_kept_when_another_is_lost(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with hub_process(tmp_path / "ports", 3) as hub:
        ports = [word for port in hub.paths[1:] for word in ("--channel", port)]
        options = ("--interface", "slcan", *ports, "--bitrate", BITRATE, "--out", folder)
        with command("can", "record", *options) as process, joined(hub.paths[0]) as sender:
            wait_for(lambda: (folder / "manifest.json").exists() or process.poll() is not None)
            for k in range(100):
                send(sender, frame(k))
            wait_for(lambda: on_disk(folder) == 200)
            hub.unplug(1)
            until_said(process, "the others go on")
            for k in range(100, 200):
                send(sender, frame(k))
            wait_for(lambda: on_disk(folder) == 300)
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=HANG)
    assert process.returncode == 3
    assert [channel["frames"] for channel in manifest(folder)["channels"]] == [100, 200]
    heard = [(message.channel, number(message)) for message in recorded(folder)]
    assert [k for channel, k in heard if channel == 1] == list(range(200))


def test_a_recorder_that_was_stopped_for_a_time_says_so(hub: Hub, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with recording(hub, folder) as process:
        time.sleep(0.3)
        tell_all(process, signal.SIGSTOP)
        time.sleep(0.6)
        tell_all(process, signal.SIGCONT)
        time.sleep(0.3)
        process.send_signal(signal.SIGHUP)
        process.communicate(timeout=HANG)
    (channel,) = manifest(folder)["channels"]
    assert channel["pause_count"] >= 1
    assert 0.4 < max(pause["seconds"] for pause in channel["pauses"]) < HANG
    assert any("could not be read" in line for line in manifest(folder)["remarks"])
