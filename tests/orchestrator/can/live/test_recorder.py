"""A recording holds every frame that was received, however it ends, and says what was lost and why."""

from __future__ import annotations

import hashlib
import json
import os
import resource
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import pytest

from fmus.errors import BusError, InputError, RecordError, TraceError
from orchestrator.can import logs
from orchestrator.can.live import recorder
from orchestrator.can.live.bus import BusSettings, opened, send
from orchestrator.can.live.manifest import BusRecording
from orchestrator.can.live.recorder import record
from orchestrator.can.slcan.hub import Hub, hub_process
from tests.support.can.wiring import BITRATE, HANG, command, frame, joined, number, settings, until_said, wait_for

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


def on_disk(folder: Path) -> int:
    """Frames that can be read of a recording which goes on."""
    try:
        return len(numbers(folder))
    except TraceError:  # nothing is written yet
        return 0


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


def virtual(channel: str, folder: Path, *batches: list[can.Message], **options: Any) -> dict[str, Any]:
    """What is recorded of a virtual bus on which the batches are sent, the next when those before are written."""
    bus, waiting, sent = BusSettings("virtual", channel, BITRATE), list(batches), 0

    def go_on(share: float = 0.0, doing: str = "0 frames") -> None:
        nonlocal sent
        if int(doing.split(maxsplit=1)[0].replace(",", "")) < sent:
            return
        if not waiting:
            signal.raise_signal(signal.SIGINT)
            return
        batch = waiting.pop(0)
        for message in batch:
            sender.send(message)
        sent += len(batch)

    with opened(bus) as sender:
        return record(BusRecording(bus, folder, **{"duration": HANG} | options), go_on, go_on).document()


def frames(count: int, first: int = 0) -> list[can.Message]:
    return [frame(number) for number in range(first, first + count)]


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

        found = record(wrong, until_something_came, send_some).document()
    assert found["frames"] == found["error_frames"] > 0
    assert any("bit rate" in line for line in found["remarks"])
    assert all(message.is_error_frame for message in recorded(tmp_path / "run"))


def test_bus_off_is_reported(hub: Hub, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    recording = BusRecording(settings(hub.paths[1]), tmp_path / "run", duration=HANG)
    found = record(recording, until_something_came, lambda: hub.bus_off(1))
    assert len(found.bus_off) == 1
    assert "bus off" in caplog.text and "1 error frames" in caplog.text
    assert any("bus off" in line for line in found.remarks())


def test_a_flood_fills_the_queue_and_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "_PERIOD", 0.3)
    found = virtual("flood", tmp_path / "run", frames(5000), queue=100, duration=0.1)
    assert found["dropped"] > 0
    assert found["frames"] + found["dropped"] == 5000
    assert found["frames"] <= 100 * 2  # written once, and once more at the end
    assert any(f"{found['dropped']:,} frames were dropped" in line for line in found["remarks"])
    assert len(recorded(tmp_path / "run")) == found["frames"]


@pytest.mark.parametrize("suffix", [".blf", ".asc", ".log"])
def test_frames_are_recorded_in_the_format_that_is_asked_for(tmp_path: Path, suffix: str) -> None:
    found = virtual(f"format{suffix}", tmp_path / "run", frames(300), suffix=suffix)
    assert [file["file"] for file in found["files"]] == [f"run_0001{suffix}"]
    assert numbers(tmp_path / "run") == list(range(300))


def test_a_new_file_begins_at_the_size_asked_for_and_nothing_is_lost_between(tmp_path: Path) -> None:
    batches = [frames(100, first) for first in range(0, 600, 100)]
    found = virtual("rotated", tmp_path / "run", *batches, rotate_size=6000)
    assert len(found["files"]) > 2
    assert numbers(tmp_path / "run") == list(range(600))
    assert sum(file["frames"] for file in found["files"]) == 600
    assert all(file["sha256"] for file in found["files"])


@pytest.mark.parametrize("seconds", [0.0, HANG])
def test_a_new_file_begins_at_the_age_asked_for(tmp_path: Path, seconds: float) -> None:
    batches = [frames(1, k) for k in range(4)]
    found = virtual("aged", tmp_path / "run", *batches, rotate_seconds=seconds)
    assert [file["frames"] for file in found["files"]] == ([4] if seconds else [1, 1, 1, 1])
    assert numbers(tmp_path / "run") == list(range(4))


def test_a_clock_that_is_set_back_begins_a_new_file_and_keeps_its_stamps(tmp_path: Path) -> None:
    stamps = [1.7e9, 1.7e9 + 0.5, 1.7e9 + 1, 1.6e9, 1.6e9 + 0.5]

    def jump(bus: can.BusABC) -> None:
        for k, stamp in enumerate(stamps):
            bus.send(can.Message(arbitration_id=0x100, is_extended_id=False, data=bytes([k]), timestamp=stamp))

    bus = BusSettings("virtual", "clock", options={"preserve_timestamps": "true"})
    with opened(bus) as sender:
        found = record(BusRecording(bus, tmp_path / "run", duration=0.1), ready=lambda: jump(sender)).document()
    assert [file["frames"] for file in found["files"]] == [3, 2]
    assert [message.timestamp for message in recorded(tmp_path / "run")] == pytest.approx(stamps, abs=1e-6, rel=0.0)


def test_with_a_database_frames_are_counted_by_message(tmp_path: Path) -> None:
    (tmp_path / "rig.dbc").write_text(DATABASE)

    sent = [frame(1, identifier) for identifier in (0x100, 0x100, 0x7AB)]
    found = virtual("counted", tmp_path / "run", sent, database=tmp_path / "rig.dbc")
    assert found["found"]["messages"] == {"State": 2}
    assert found["found"]["unknown"] == {"7AB": 1}
    assert any("unknown" in line for line in found["remarks"])


def test_without_a_database_frames_are_counted_by_identifier(tmp_path: Path) -> None:
    found = virtual("identifiers", tmp_path / "run", frames(5))
    assert found["found"]["identifiers"] == {"100": 5}
    assert found["remarks"] == []


def two(name: str) -> tuple[BusSettings, BusSettings]:
    """A virtual bus that keeps the stamps of frames, and another."""
    options = {"preserve_timestamps": "true"}
    one, other = (BusSettings("virtual", f"{name}_{end}", BITRATE, options=options) for end in ("left", "right"))
    return one, other


def both(folder: Path, name: str, sent: list[tuple[int, can.Message]], **options: Any) -> dict[str, Any]:
    """What is recorded of two virtual buses, on which these frames are sent: channel, frame."""
    buses = two(name)
    with opened(buses[0]) as one, opened(buses[1]) as other:

        def send_all() -> None:
            for channel, message in sent:
                (one, other)[channel].send(message)

        def end(share: float, doing: str) -> None:
            if f"{len(sent):,} frames" in doing:
                signal.raise_signal(signal.SIGINT)

        recording = BusRecording(buses[0], folder, **{"duration": HANG, "others": buses[1:]} | options)
        return record(recording, end, send_all).document()


def stamped(number: int, stamp: float, identifier: int = 0x100) -> can.Message:
    message = frame(number, identifier)
    message.timestamp = 1.7e9 + stamp
    return message


@pytest.mark.parametrize("suffix", [".blf", ".asc", ".log"])
def test_several_channels_are_one_log_in_the_order_of_its_clock(tmp_path: Path, suffix: str) -> None:
    sent = [(k // 50 % 2, stamped(k, 0.001 * k)) for k in range(300)]  # fifty here, fifty there
    found = both(tmp_path / "run", f"log{suffix[1:]}", sent, suffix=suffix)
    assert len(found["files"]) == 1
    assert numbers(tmp_path / "run") == list(range(300))
    assert [message.channel for message in recorded(tmp_path / "run")] == [channel for channel, _ in sent]
    assert [channel["frames"] for channel in found["channels"]] == [150, 150]
    names = [channel["channel"] for channel in found["channels"]]
    assert names == [bus.channel for bus in two(f"log{suffix[1:]}")]
    if suffix == ".log":
        words = (tmp_path / "run" / "run_0001.log").read_text().split("\n")[0].split()
        assert words[1] == names[0]


def test_each_channel_is_decoded_with_its_own_database(tmp_path: Path) -> None:
    (tmp_path / "a.dbc").write_text(DATABASE)
    (tmp_path / "b.dbc").write_text(DATABASE.replace("State", "Other"))
    sent = [(0, frame(0)), (1, frame(0)), (1, frame(0))]
    database = {"0": tmp_path / "a.dbc", "own_right": tmp_path / "b.dbc"}
    assert both(tmp_path / "run", "own", sent, database=database)["found"]["messages"] == {"State": 1, "Other": 2}


def test_a_channel_without_frames_is_named_and_one_twice_is_refused(tmp_path: Path) -> None:
    found = both(tmp_path / "run", "idle", [(1, frame(k)) for k in range(3)])
    assert found["remarks"] == ["virtual:idle_left: no frame came"]
    one, _ = two("idle")
    with pytest.raises(InputError, match="recorded twice"):
        BusRecording(one, tmp_path / "twice", others=(one,))


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


def test_stamps_of_a_clock_without_a_date_keep_their_distances(tmp_path: Path) -> None:
    bus, _ = two("boot")
    messages = [frame(k) for k in range(3)]
    for message, stamp in zip(messages, (7.25, 7.5, 9.0), strict=True):
        message.timestamp = stamp
    with opened(bus) as sender:

        def send_all() -> None:
            for message in messages:
                sender.send(message)

        began = time.time()
        found = record(BusRecording(bus, tmp_path / "run", duration=0.1), ready=send_all).document()
    stamps = [message.timestamp for message in recorded(tmp_path / "run")]
    assert began - 1e-3 <= stamps[0] <= time.time()
    assert [stamp - stamps[0] for stamp in stamps] == pytest.approx([0.0, 0.25, 1.75], abs=1e-5)
    assert any("adapter's clock" in line for line in found["remarks"])


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


@pytest.mark.parametrize("suffix", [".blf", ".asc", ".log"])
def test_a_full_disk_is_said_and_what_was_written_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    folder = tmp_path / "run"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    former = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # beyond this size a write fails, as on a full disk
    monkeypatch.setattr(recorder, "_SYNC", 0.0)

    def random(count: int) -> list[can.Message]:
        return [can.Message(arbitration_id=k, is_extended_id=False, data=os.urandom(8)) for k in range(count)]

    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, before[1]))
        with pytest.raises(RecordError, match=rf"run_0001\{suffix}: cannot be written \(.*\); .* frames up") as failed:
            virtual(f"full{suffix}", folder, *(random(100) for _ in range(100)), suffix=suffix)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, former)
    found = manifest(folder)
    kept = [message for batch in logs.read(folder / f"run_0001{suffix}") for message in batch.messages()]
    assert failed.value.exit_code == 3 and f"{len(kept):,} frames up to there are kept" in str(failed.value)
    assert found["ended"] == "failed" and "cannot be written" in found["failure"]
    assert found["frames"] == found["files"][0]["frames"] == len(kept) and len(kept) > 500


def test_there_is_room_for_the_last_manifest(tmp_path: Path) -> None:
    """It is written into what was reserved, which is no file of the recording in the end."""
    virtual("room", tmp_path / "run", frames(1))
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == ["manifest.json", "run_0001.blf"]
    text = (tmp_path / "run" / "manifest.json").read_text()
    assert text.endswith("}\n") and json.loads(text)["ended"] == "stopped"


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


def test_a_bus_that_does_not_open_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(BusError, match="does not open"):
        record(BusRecording(BusSettings("slcan", str(tmp_path / "none"), BITRATE), tmp_path / "run"))
    assert not (tmp_path / "run").exists()
