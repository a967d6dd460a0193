"""The BLF reader gives python-can's frames, many at once, and gets what there is out of damaged files."""

from __future__ import annotations

import io
import struct
import tracemalloc
import zlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus.errors import TraceError
from orchestrator.can import logs
from orchestrator.can.frames import Flag, Frames, from_messages
from orchestrator.can.logs.blf import objects as blf_objects
from orchestrator.can.logs.blf import reading as blf
from orchestrator.can.logs.findings import Findings
from tests.support.can.can_samples import START, all_of, any_frames, different, messages, rig_frames

quick = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])

SYSTEMTIME = (2023, 11, 2, 14, 22, 13, 20, 250)  # START


def write_blf(path: Path, sent: Sequence[can.Message], **options: int) -> Path:
    """The messages as python-can writes them."""
    writer = can.BLFWriter(path, **options)  # type: ignore[arg-type]
    for message in sent:
        writer.on_message_received(message)
    writer.stop()
    return path


def header() -> bytes:
    """The header of a file that begins at START."""
    return struct.pack("<4sL8BQQLL8H8H72x", b"LOGG", 144, *[0] * 8, 0, 0, 0, 0, *SYSTEMTIME, *SYSTEMTIME)


def an_object(kind: int, body: bytes, stamp: int = 0, version: int = 1, unit: int = 2) -> bytes:
    """An object with its header, padded as Vector pads."""
    more = struct.pack("<LHHQ" if version == 1 else "<LBxHQ8x", unit, 0, 0, stamp)
    size = 16 + len(more) + len(body)
    return struct.pack("<4sHHLL", b"LOBJ", 16 + len(more), version, size, kind) + more + body + bytes(size % 4)


def container(content: bytes, method: int = 2) -> bytes:
    """A container, compressed by zlib (2) or not (0)."""
    packed = zlib.compress(content) if method == 2 else content
    size = 32 + len(packed)
    return struct.pack("<4sHHLLHxxxxxxLxxxx", b"LOBJ", 16, 1, size, 10, method, len(content)) + packed + bytes(size % 4)


def classic(identifier: int, data: bytes, flags: int = 0, channel: int = 1) -> bytes:
    return struct.pack("<HBBL8s", channel, flags, len(data), identifier, data)


def fd_64(identifier: int, data: bytes, flags: int = 0x3000, valid: int | None = None) -> bytes:
    told = len(data) if valid is None else valid
    return struct.pack("<BBBBLLLLLLLHBBL", 2, 15, told, 0, identifier, 0, flags, 0, 0, 0, 0, 0, 1, 0, 0) + data


def file_of(path: Path, *containers: bytes) -> Path:
    path.write_bytes(header() + b"".join(containers))
    return path


def same(one: Frames, other: Frames) -> bool:
    """Whether frames are the same, their stamps up to what a double of a date can hold."""
    return different(one, other) == [] and bool(np.all(np.abs(one.time - other.time) < 3e-7))


def theirs(path: Path) -> Frames:
    return from_messages(can.BLFReader(path))


@quick
@given(
    sent=st.lists(messages(), min_size=1, max_size=60),
    size=st.sampled_from([250, 500, 1 << 17]),
    level=st.sampled_from([-1, 0, 9]),
)
def test_frames_equal_those_of_python_can_one_by_one(
    tmp_path: Path, sent: list[can.Message], size: int, level: int
) -> None:
    path = write_blf(tmp_path / "a.blf", sent, max_container_size=size, compression_level=level)
    log = logs.read(path)
    assert same(all_of(log), theirs(path))
    assert log.damage == [] and log.findings.skipped == 0


@quick
@given(sent=st.lists(messages(), min_size=1, max_size=60))
def test_python_can_reads_the_frames_that_are_written_here(tmp_path: Path, sent: list[can.Message]) -> None:
    frames = from_messages(sorted(sent, key=lambda message: message.timestamp))
    path = tmp_path / "a.blf"
    logs.write(path, [frames[:20], frames[20:]], lost=Counter())
    reader = can.BLFReader(path)
    back = from_messages(reader)
    assert same(back, all_of(logs.read(path)))
    frames.flags[frames.has(Flag.ERROR)] &= ~np.uint8(Flag.SENT)
    assert different(back, frames) == [] and np.abs(back.time - frames.time).max() < 1e-6
    assert reader.object_count == len(frames) and reader.file_size == path.stat().st_size


def test_a_written_log_has_containers_as_vectors_tools_make_them(tmp_path: Path) -> None:
    logs.write(tmp_path / "a.blf", [rig_frames(3000), any_frames(3000)], lost=Counter())
    content, place, sizes = (tmp_path / "a.blf").read_bytes(), 144, []
    while place < len(content):
        signature, _, _, size, kind, _, announced = struct.unpack_from("<4sHHLLHxxxxxxL", content, place)
        assert (signature, kind) == (b"LOBJ", 10)
        assert len(zlib.decompress(content[place + 32 : place + size])) == announced
        sizes.append(announced)
        place += size + size % 4
    assert len(sizes) > 2 and set(sizes[:-1]) == {1 << 17}


def test_frames_whose_header_is_not_known_are_damage_and_not_passed_over(tmp_path: Path) -> None:
    frame = classic(0x123, b"12345678")
    good, strange = an_object(1, frame), bytearray(an_object(86, frame + bytes(8)))
    strange[6:8] = (3).to_bytes(2, "little")
    log = logs.read(file_of(tmp_path / "a.blf", container(good + bytes(strange) * 2)))
    assert len(all_of(log)) == 1 and log.findings.skipped == 0
    assert [damage.problem for damage in log.damage] == [
        "2 CAN frames have an object header of version 3, which is not known"
    ]
    with pytest.raises(TraceError, match=r"no frame that can be read .*version 3"):
        all_of(logs.read(file_of(tmp_path / "b.blf", container(bytes(strange)))))


def test_an_error_of_can_fd_is_an_error_frame(tmp_path: Path) -> None:
    body = struct.pack("<BBBBHHHBBLLLLLLLHH", 2, 9, 12, 0, 0, 0, 0, 0, 0, 1 << 31 | 0x18FEF1FE, *[0] * 6, 0, 0)
    log = logs.read(file_of(tmp_path / "a.blf", container(an_object(104, body + bytes(range(12))))))
    frames = all_of(log)
    assert frames.flags.tolist() == [Flag.ERROR | Flag.EXTENDED] and frames.id.tolist() == [0x18FEF1FE]
    assert (frames.channel.tolist(), frames.length.tolist()) == ([1], [12])
    assert frames.data[0, :12].tolist() == list(range(12)) and log.findings.skipped == 0


def test_all_objects_of_frames_and_both_units_of_time_are_read(tmp_path: Path) -> None:
    objects = [
        an_object(1, classic(0x123, b"12345678"), 1_500_000_000),
        an_object(86, classic(0x80000001, b"abc", flags=1) + bytes(8), 150_001, unit=1),
        an_object(100, struct.pack("<HBBLLBBB5x64s", 3, 0, 9, 0x7FF, 0, 0, 7, 12, bytes(range(64))), 1, version=2),
        an_object(101, fd_64(0x5, bytes(range(64))), 2),
        an_object(101, fd_64(0x6, b"\x01\x02", valid=12), 3),
        an_object(73, struct.pack("<HHLBBBxLLH2x8s", 1, 0, 0, 0, 0, 2, 0, 0x10, 0, b"\x07\x08"), 4),
        an_object(1, classic(0x77, b"", flags=0x80), 5),
    ]
    path = file_of(tmp_path / "a.blf", container(b"".join(objects)))
    log = logs.read(path)
    frames = all_of(log)
    assert same(frames, theirs(path))
    assert frames.length.tolist() == [8, 3, 12, 64, 12, 2, 0]
    assert "frames hold fewer data bytes than they say, and 0 for the others" in log.findings.notes
    assert (frames.time[:2] - START).tolist() == pytest.approx([1.5, 1.50001], abs=1e-6)
    assert frames.flags[3] == Flag.FD | Flag.BITRATE_SWITCH | Flag.SENT


def test_an_error_without_details_is_an_error_frame(tmp_path: Path) -> None:
    """python-can passes over this kind of object."""
    path = file_of(tmp_path / "a.blf", container(an_object(2, struct.pack("<HHL", 2, 6, 0), 10**9)))
    frames = all_of(logs.read(path))
    assert (frames.flags.tolist(), frames.channel.tolist()) == ([Flag.ERROR], [1])
    assert frames.time[0] == START + 1


def test_events_that_are_no_frames_are_counted(tmp_path: Path) -> None:
    writer = can.BLFWriter(tmp_path / "a.blf")
    writer.on_message_received(can.Message(timestamp=START, arbitration_id=1, data=b"1"))
    writer.log_event("a marker of odd length...", START)
    writer.on_message_received(can.Message(timestamp=START, arbitration_id=2, data=b"2"))
    writer.stop()
    log = logs.read(tmp_path / "a.blf")
    assert all_of(log).id.tolist() == [1, 2] and log.findings.skipped == 1 and not log.damage


def test_objects_outside_of_containers_are_read(tmp_path: Path) -> None:
    objects = [an_object(1, classic(number, b"12345678")) for number in range(5)]
    assert all_of(logs.read(file_of(tmp_path / "a.blf", *objects))).id.tolist() == [0, 1, 2, 3, 4]


def test_a_signature_among_the_data_is_no_object(tmp_path: Path) -> None:
    sent = [can.Message(timestamp=START, arbitration_id=n, data=b"LOBJLOBJ") for n in range(1000)]
    path = write_blf(tmp_path / "a.blf", sent)
    log = logs.read(path)
    assert same(all_of(log), theirs(path)) and not log.damage


@pytest.mark.parametrize("size", [250, 1 << 17])
def test_a_log_cut_anywhere_gives_the_frames_before_the_cut(tmp_path: Path, size: int) -> None:
    whole = any_frames(60)
    path = write_blf(tmp_path / "a.blf", list(whole.messages()), max_container_size=size, compression_level=0)
    content, before = path.read_bytes(), all_of(logs.read(path))
    counts = []
    for end in range(150, len(content) - 1, 23):
        path.write_bytes(content[:end])
        log = logs.read(path)
        try:
            frames = all_of(log)
        except TraceError as error:
            assert "holds no frame that can be read" in str(error)
            continue
        assert different(frames, before[: len(frames)]) == []
        assert log.damage and 144 <= (log.damage[-1].offset or 0) <= end
        counts.append(len(frames))
    assert counts == sorted(counts) and counts[-1] >= 59


def test_a_broken_container_costs_only_its_own_frames(tmp_path: Path) -> None:
    parts = [container(b"".join(an_object(1, classic(n, bytes(8)), n) for n in range(k, k + 50))) for k in (0, 50, 100)]
    place = 144 + len(parts[0])
    for position in range(32, len(parts[1]) - 8, 11):
        damaged = bytearray(parts[1])
        damaged[position] ^= 0x55
        log = logs.read(file_of(tmp_path / "a.blf", parts[0], bytes(damaged), parts[2]))
        frames = all_of(log)
        kept = frames.id.tolist()
        assert kept[:50] == list(range(50)) and kept[-50:] == list(range(100, 150))
        assert log.damage[0].offset == place


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({8: b"\xff\xff\xff\x7f"}, "claims 2147483647 bytes"),
        ({8: b"\xf0\x00\x10\x00"}, "the next begins after"),
        ({8: b"\x00\x00\x00\x00"}, "claims 0 bytes"),
        ({0: b"X"}, "bytes are no objects"),
        ({16: b"\x07"}, "compressed in an unknown way (7)"),
    ],
)
def test_a_broken_head_of_a_container_is_located(tmp_path: Path, change: dict[int, bytes], problem: str) -> None:
    parts = [container(b"".join(an_object(1, classic(n, bytes(8)), n) for n in range(k, k + 50))) for k in (0, 50, 100)]
    damaged = bytearray(parts[1])
    for place, new in change.items():
        damaged[place : place + len(new)] = new
    log = logs.read(file_of(tmp_path / "a.blf", parts[0], bytes(damaged), parts[2]))
    kept = all_of(log).id.tolist()
    assert kept[:50] == list(range(50)) and kept[-50:] == list(range(100, 150))
    assert problem in log.damage[0].problem
    assert (log.damage[0].offset or 0) in range(141 + len(parts[0]), 145 + len(parts[0]))  # with padding before it


def test_a_frame_that_is_too_short_for_its_kind_is_reported(tmp_path: Path) -> None:
    good = an_object(1, classic(1, b"1"))
    log = logs.read(file_of(tmp_path / "a.blf", container(good + an_object(100, bytes(20)) + good)))
    assert len(all_of(log)) == 2 and "too short" in log.damage[0].problem and log.damage[0].offset == 144


def test_without_its_header_a_log_keeps_its_frames(tmp_path: Path) -> None:
    path = file_of(tmp_path / "a.blf", container(an_object(1, classic(1, b"1"), 10**9)))
    path.write_bytes(b"XXXX" + path.read_bytes()[4:])
    log = logs.read(path)
    assert all_of(log).time.tolist() == [1.0]
    assert log.damage[0].offset == 0 and "no header" in log.damage[0].problem


@pytest.mark.slow
def test_a_container_that_would_fill_the_memory_is_cut(tmp_path: Path) -> None:
    packer = zlib.compressobj(9)
    packed = b"".join([*(packer.compress(bytes(1 << 20)) for _ in range(256)), packer.flush()])
    bomb = struct.pack("<4sHHLLHxxxxxxLxxxx", b"LOBJ", 16, 1, 32 + len(packed), 10, 2, 1000) + packed
    good = container(an_object(1, classic(1, b"1")))
    path = file_of(tmp_path / "a.blf", good, bomb, good)
    tracemalloc.start()
    log = logs.read(path)
    frames = all_of(log)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(frames) == 2 and "far more" in log.damage[0].problem
    assert peak < 6 * blf.MAX_CONTAINER


def test_an_object_that_claims_to_be_huge_does_not_swallow_what_follows(tmp_path: Path) -> None:
    bad = struct.pack("<4sHHLL", b"LOBJ", 32, 1, blf_objects.MAX_OBJECT + 1, 1) + bytes(32)
    good = an_object(1, classic(1, b"1"))
    log = logs.read(file_of(tmp_path / "a.blf", container(good + bad + good)))
    assert len(all_of(log)) == 2 and "no objects" in log.damage[0].problem


def test_batches_are_bounded_and_a_log_can_be_read_again(tmp_path: Path) -> None:
    frames = rig_frames(50_000)
    content = b"".join(an_object(1, classic(n % 2048, bytes(8))) for n in range(200_000))
    path = file_of(tmp_path / "a.blf", container(content, method=0))
    log = logs.read(path)
    sizes = [len(batch) for batch in log]
    assert sum(sizes) == 200_000 and max(sizes) <= 65_536 < len(frames)
    assert [len(batch) for batch in log] == sizes


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    changes=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=8),
    stored=st.booleans(),
    cut=st.integers(0, 200),
    extra=st.binary(max_size=40),
)
def test_whatever_a_file_holds_reading_ends(
    tmp_path: Path, changes: list[tuple[int, int]], stored: bool, cut: int, extra: bytes
) -> None:
    path = write_blf(
        tmp_path / "a.blf",
        list(any_frames(40).messages()),
        max_container_size=700,
        compression_level=0 if stored else -1,
    )
    content = bytearray(path.read_bytes())
    for place, value in changes:
        content[place % len(content)] = value
    path.write_bytes(bytes(content[: len(content) - cut]) + extra)
    log = logs.read(path)
    try:
        frames = all_of(log)
    except TraceError:
        return
    assert np.isfinite(frames.time).all() and len(frames) <= 60
    assert all(0 <= (damage.offset or 0) <= path.stat().st_size for damage in log.damage)


@quick
@given(
    content=st.lists(
        st.sampled_from([b"LOBJ", b"LOGG", bytes(8), b"\x30\x00\x00\x00", b"\x01\x00\x01\x00", b"xyz"]),
        min_size=1,
        max_size=300,
    )
)
def test_rubble_of_signatures_is_refused_or_read(tmp_path: Path, content: list[bytes]) -> None:
    path = tmp_path / "a.blf"
    path.write_bytes(header() + container(b"".join(content)) + b"".join(content))
    try:
        all_of(logs.read(path))
    except TraceError as error:
        assert "holds no frame that can be read" in str(error)


def test_what_a_recorder_adds_while_a_file_is_read_does_not_disturb_what_was_there(tmp_path: Path) -> None:
    sent = [can.Message(START + k / 100, k, data=bytes(8)) for k in range(60)]
    whole = write_blf(tmp_path / "grows.blf", sent, max_container_size=400).read_bytes()

    def read(content: bytes, size: int) -> tuple[list[blf.ContainerContent], list[str]]:
        findings = Findings()
        return list(blf._contents(io.BytesIO(content), len(header()), size, findings)), findings.lines()

    for size in range(len(header()), len(whole) + 1):
        assert read(whole, size) == read(whole[:size], size)
