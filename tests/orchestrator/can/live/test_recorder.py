"""What a recorder writes: formats, files, counts and stamps, and what it does where the disk or the queue is full."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import time
from pathlib import Path

import can
import pytest

from fmus.errors import BusError, InputError, RecordError
from fmus.json_document import document_of
from orchestrator.can import logs
from orchestrator.can.live import recorder
from orchestrator.can.live.bus import BusSettings, opened
from orchestrator.can.live.manifest import BusRecording
from orchestrator.can.live.recorder import record
from tests.support.can.recordings import DATABASE, frames, manifest, numbers, recorded, virtual
from tests.support.can.scripted_adapter import ScriptedAdapter
from tests.support.can.wiring import BITRATE, HANG, frame, number

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work


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
        found = document_of(record(BusRecording(bus, tmp_path / "run", duration=0.1), ready=lambda: jump(sender)))
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


def test_stamps_of_a_clock_without_a_date_keep_their_distances(tmp_path: Path) -> None:
    bus = BusSettings("virtual", "boot", BITRATE, options={"preserve_timestamps": "true"})
    messages = [frame(k) for k in range(3)]
    for message, stamp in zip(messages, (7.25, 7.5, 9.0), strict=True):
        message.timestamp = stamp
    with opened(bus) as sender:

        def send_all() -> None:
            for message in messages:
                sender.send(message)

        began = time.time()
        found = document_of(record(BusRecording(bus, tmp_path / "run", duration=0.1), ready=send_all))
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


def test_what_an_adapter_says_that_is_no_frame_is_told_while_it_is_recorded(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    told, until = list[str](), time.monotonic() + HANG

    def go_on(share: float, doing: str) -> None:
        adapter.say(b"\a#\r" * (not told))
        told.append(doing)
        if "refusals of the adapter" in caplog.text or time.monotonic() > until:
            signal.raise_signal(signal.SIGINT)

    with ScriptedAdapter() as adapter:
        record(BusRecording(BusSettings("slcan", adapter.path), tmp_path / "run"), go_on)
    assert "1 lines of the adapter that are no frames" in told[-1] and "1 refusals of the adapter (BEL)" in told[-1]
    assert "refusals of the adapter" in caplog.text


def test_there_is_room_for_the_last_manifest(tmp_path: Path) -> None:
    """It is written into what was reserved, which is no file of the recording in the end."""
    virtual("room", tmp_path / "run", frames(1))
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == ["manifest.json", "run_0001.blf"]
    text = (tmp_path / "run" / "manifest.json").read_text()
    assert text.endswith("}\n") and json.loads(text)["ended"] == "stopped"


@pytest.mark.parametrize("suffix", [".asc", ".log"])
def test_of_a_small_disk_that_fills_at_once_every_frame_that_is_whole_there_is_kept(
    tmp_path: Path, suffix: str
) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    former = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (14_336, before[1]))
        with pytest.raises(RecordError) as failed:
            virtual(f"small{suffix}", tmp_path / "run", *(frames(50) for _ in range(20)), suffix=suffix)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, former)
    kept = len(numbers(tmp_path / "run"))
    assert kept >= 50 and f"; {kept:,} frames up to there are kept" in str(failed.value)
    assert manifest(tmp_path / "run")["frames"] == kept


def test_where_there_is_no_room_for_another_manifest_it_is_written_into_the_first(tmp_path: Path) -> None:
    _, folder = _narrowed(tmp_path, ".manifest.json")
    assert manifest(folder)["ended"] == "stopped" and manifest(folder)["frames"] == len(numbers(folder)) == 3


def test_where_there_is_no_room_for_any_manifest_the_frames_that_are_kept_are_told(tmp_path: Path) -> None:
    failure, folder = _narrowed(tmp_path, ".manifest.json", "manifest.json")
    assert re.search(r"manifest.json: cannot be written \(.*\); make room on the disk; 3 frames are kept", str(failure))
    assert failure is not None and failure.exit_code == 3
    assert [number(message) for batch in logs.read(folder / "run_0001.blf") for message in batch.messages()] == [
        0,
        1,
        2,
    ]


def _narrowed(tmp_path: Path, *names: str) -> tuple[RecordError | None, Path]:
    """What ends a recording of three frames in whose folder no files of these names can be written any more."""
    folder, bus = tmp_path / "run", BusSettings("virtual", names[-1])

    def narrow(share: float, doing: str) -> None:
        if doing.startswith("3 frames"):
            for place in map(folder.joinpath, names):
                place.unlink()
                place.mkdir()
            signal.raise_signal(signal.SIGINT)

    with opened(bus) as sender:
        try:
            record(BusRecording(bus, folder, duration=HANG), narrow, lambda: [*map(sender.send, frames(3))] and None)
        except RecordError as failure:
            return failure, folder
    return None, folder


def test_a_bus_that_does_not_open_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(BusError, match="does not open"):
        record(BusRecording(BusSettings("slcan", str(tmp_path / "none"), BITRATE), tmp_path / "run"))
    assert not (tmp_path / "run").exists()
