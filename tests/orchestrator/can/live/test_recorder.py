"""A recording holds every frame that was received, however it ends, and says what was lost and why."""

from __future__ import annotations

import hashlib
import json
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import pytest

from fmus.errors import BusError, InputError
from orchestrator.can import logs
from orchestrator.can.live import recorder
from orchestrator.can.live.bus import BusSettings, opened, send
from orchestrator.can.live.recorder import BusRecording, record
from orchestrator.can.slcan.hub import Hub, hub_process
from tests.support.wiring import BITRATE, command, frame, joined, number, settings, wait_for

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work

DATABASE = """VERSION ""
BS_:
BU_:
BO_ 256 State: 8 Vector__XXX
 SG_ angle : 0|16@1+ (0.001,0) [0|60] "rad" Vector__XXX
"""


@pytest.fixture(scope="module")
def hub(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hub]:
    """Three adapters on a bus of 500 kbit/s."""
    with hub_process(tmp_path_factory.mktemp("ports"), 3) as running:
        yield running


def manifest(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "manifest.json").read_text())
    return document


def recorded(folder: Path) -> list[can.Message]:
    """All frames of a recording, in the order of its files."""
    files = [folder / file["file"] for file in manifest(folder)["files"]]
    return [message for file in files for batch in logs.read(file) for message in batch.messages()]


def numbers(folder: Path) -> list[int]:
    return [number(message) for message in recorded(folder) if not message.is_error_frame]


@contextmanager
def recording(hub: Hub, folder: Path, *options: object) -> Iterator[subprocess.Popen[str]]:
    """`can record` on port 1, on the bus by now."""
    bus = ("--interface", "slcan", "--channel", hub.paths[1], "--bitrate", BITRATE)
    with command("can", "record", *bus, "--out", folder, *options) as process:
        wait_for(lambda: (folder / "manifest.json").exists() or process.poll() is not None)
        time.sleep(0.1)
        yield process


def virtual(channel: str, folder: Path, sent: Callable[[can.BusABC], None], **options: Any) -> dict[str, Any]:
    """What is recorded of a virtual bus on which something is sent after the beginning."""
    bus = BusSettings("virtual", channel, BITRATE)
    with opened(bus) as sender:

        def work() -> None:
            wait_for((folder / "manifest.json").exists)
            sent(sender)

        thread = threading.Thread(target=work)
        thread.start()
        try:
            return record(BusRecording(bus, folder, **{"duration": 0.4} | options))
        finally:
            thread.join()


def stream(count: int) -> Callable[[can.BusABC], None]:
    return lambda bus: [bus.send(frame(k)) for k in range(count)] and None


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_every_frame_that_was_received_is_on_disk_after_a_signal(hub: Hub, tmp_path: Path, end: signal.Signals) -> None:
    folder, count = tmp_path / "run", 1500
    with recording(hub, folder, "--json") as process, joined(hub.paths[0]) as sender:
        heard = hub.statistics()["ports"][1]["heard"] + count
        for k in range(count):
            send(sender, frame(k))
        wait_for(lambda: hub.statistics()["ports"][1]["heard"] == heard)
        process.send_signal(end)
        answer, said = process.communicate(timeout=10)
    assert process.returncode == 0, said
    assert json.loads(answer) == manifest(folder)
    assert numbers(folder) == list(range(count))
    document = manifest(folder)
    assert (document["ended"], document["frames"], document["dropped"]) == ("stopped", count, 0)
    (file,) = document["files"]
    content = (folder / file["file"]).read_bytes()
    assert (file["bytes"], file["sha256"]) == (len(content), hashlib.sha256(content).hexdigest())
    assert len(list(can.BLFReader(folder / file["file"]))) == count


def test_a_killed_recorder_leaves_all_but_the_last_second(hub: Hub, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with recording(hub, folder) as process, joined(hub.paths[0]) as sender:
        for k in range(200):
            send(sender, frame(k))
        time.sleep(1.2)
        process.kill()
        process.communicate()
    assert numbers(folder) == list(range(200))
    assert manifest(folder)["ended"] == "unfinished"


def test_an_unplugged_adapter_ends_the_recording_with_what_it_has(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with (
        hub_process(tmp_path / "ports", 2) as hub,
        recording(hub, folder) as process,
        joined(hub.paths[0]) as sender,
    ):
        for k in range(100):
            send(sender, frame(k))
        time.sleep(0.2)
        hub.unplug(1)
        _, said = process.communicate(timeout=10)
    assert process.returncode == 3
    assert "failed after 100 frames (the adapter is gone" in said
    assert numbers(folder) == list(range(100))
    assert manifest(folder)["ended"] == "failed"
    assert "gone" in manifest(folder)["failure"]


def test_at_the_wrong_bit_rate_nothing_is_heard_and_it_is_said(hub: Hub, tmp_path: Path) -> None:
    found: dict[str, Any] = {}

    def work() -> None:
        with joined(hub.paths[0]) as sender:
            wait_for((tmp_path / "run" / "manifest.json").exists)
            time.sleep(0.1)
            for k in range(150):
                send(sender, frame(k))
            time.sleep(0.3)

    thread = threading.Thread(target=work)
    thread.start()
    found = record(BusRecording(settings(hub.paths[1], bitrate=250_000), tmp_path / "run", duration=0.8))
    thread.join()
    assert found["frames"] == found["error_frames"] > 100
    assert any("bit rate" in line for line in found["remarks"])
    assert all(message.is_error_frame for message in recorded(tmp_path / "run"))


def test_bus_off_is_reported(hub: Hub, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    found = record(BusRecording(settings(hub.paths[1]), tmp_path / "run", duration=0.6), ready=lambda: hub.bus_off(1))
    assert len(found["bus_off"]) == 1
    assert "bus off" in caplog.text
    assert any("bus off" in line for line in found["remarks"])


def test_a_flood_fills_the_queue_and_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "_PERIOD", 0.3)
    found = virtual("flood", tmp_path / "run", stream(5000), queue=100, duration=0.7)
    assert found["dropped"] > 0
    assert found["frames"] + found["dropped"] == 5000
    assert found["frames"] <= 100 * 5
    assert any(f"{found['dropped']:,} frames were dropped" in line for line in found["remarks"])
    assert len(recorded(tmp_path / "run")) == found["frames"]


@pytest.mark.parametrize("suffix", [".blf", ".asc", ".log"])
def test_frames_are_recorded_in_the_format_that_is_asked_for(tmp_path: Path, suffix: str) -> None:
    found = virtual(f"format{suffix}", tmp_path / "run", stream(300), suffix=suffix)
    assert [file["file"] for file in found["files"]] == [f"run_0001{suffix}"]
    assert numbers(tmp_path / "run") == list(range(300))


def test_a_new_file_begins_at_the_size_asked_for_and_nothing_is_lost_between(tmp_path: Path) -> None:
    def slowly(bus: can.BusABC) -> None:
        for k in range(600):
            bus.send(frame(k))
            time.sleep(0.0005)

    found = virtual("rotated", tmp_path / "run", slowly, rotate_size=6000, duration=0.9)
    assert len(found["files"]) > 2
    assert numbers(tmp_path / "run") == list(range(600))
    assert sum(file["frames"] for file in found["files"]) == 600
    assert all(file["sha256"] for file in found["files"])


def test_a_new_file_begins_at_the_age_asked_for(tmp_path: Path) -> None:
    def slowly(bus: can.BusABC) -> None:
        for k in range(10):
            bus.send(frame(k))
            time.sleep(0.05)

    found = virtual("aged", tmp_path / "run", slowly, rotate_seconds=0.2, duration=0.8)
    assert 2 <= len(found["files"]) <= 4
    assert numbers(tmp_path / "run") == list(range(10))


def test_a_clock_that_is_set_back_begins_a_new_file_and_keeps_its_stamps(tmp_path: Path) -> None:
    stamps = [1.7e9, 1.7e9 + 0.5, 1.7e9 + 1, 1.6e9, 1.6e9 + 0.5]

    def jump(bus: can.BusABC) -> None:
        for k, stamp in enumerate(stamps):
            bus.send(can.Message(arbitration_id=0x100, is_extended_id=False, data=bytes([k]), timestamp=stamp))

    bus = BusSettings("virtual", "clock", options={"preserve_timestamps": "true"})
    with opened(bus) as sender:
        found = record(BusRecording(bus, tmp_path / "run", duration=0.6), ready=lambda: jump(sender))
    assert [file["frames"] for file in found["files"]] == [3, 2]
    assert [message.timestamp for message in recorded(tmp_path / "run")] == pytest.approx(stamps, abs=1e-6, rel=0.0)


def test_with_a_database_frames_are_counted_by_message(tmp_path: Path) -> None:
    (tmp_path / "rig.dbc").write_text(DATABASE)

    def send_both(bus: can.BusABC) -> None:
        for identifier in (0x100, 0x100, 0x7AB):
            bus.send(frame(1, identifier))

    found = virtual("counted", tmp_path / "run", send_both, database=tmp_path / "rig.dbc")
    assert found["found"]["messages"] == {"State": 2}
    assert found["found"]["unknown"] == {"7AB": 1}
    assert any("unknown" in line for line in found["remarks"])


def test_without_a_database_frames_are_counted_by_identifier(tmp_path: Path) -> None:
    found = virtual("identifiers", tmp_path / "run", stream(5))
    assert found["found"]["identifiers"] == {"100": 5}
    assert found["remarks"] == []


def test_a_recording_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_text("{}")
    with pytest.raises(InputError, match="not overwritten"):
        record(BusRecording(BusSettings("virtual", "kept"), tmp_path, duration=0.1))


def test_a_format_that_loses_frames_is_refused_before_anything_is_opened(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--format trc.*choose blf, asc, log"):
        BusRecording(BusSettings("virtual", "refused"), tmp_path / "run", suffix=".trc")
    assert list(tmp_path.iterdir()) == []


def test_an_adapter_that_does_not_open_is_said_and_leaves_no_recording(tmp_path: Path) -> None:
    with pytest.raises(BusError, match="does not open"):
        record(BusRecording(BusSettings("slcan", "/dev/ttyNONE"), tmp_path / "run"))
    assert not (tmp_path / "run" / "manifest.json").exists()


def test_a_full_disk_is_said_and_what_was_written_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(recorder, "_SYNC", 0.1)
    monkeypatch.setattr(recorder.LogFiles, "_is_full", lambda self: bool(self.files[-1].frames) and full(self))

    def twice(bus: can.BusABC) -> None:
        bus.send(frame(0))
        time.sleep(0.15)
        bus.send(frame(1))

    with pytest.raises(InputError, match=r"run_0001\.blf: cannot be written \(No space left on device\)"):
        virtual("full", tmp_path / "run", twice)
    assert numbers(tmp_path / "run") == [0]
    assert manifest(tmp_path / "run")["ended"] == "unfinished"


def test_a_bus_that_does_not_open_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(BusError, match="does not open"):
        record(BusRecording(BusSettings("slcan", str(tmp_path / "none"), BITRATE), tmp_path / "run"))
    assert not (tmp_path / "run").exists()
