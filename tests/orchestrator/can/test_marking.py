"""What of a message's frames is not to be trusted, and how many are missing, in however many batches they come."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import TraceError
from orchestrator.can import logs
from orchestrator.can.codec.encoding import Encoder
from orchestrator.can.database.database import load
from orchestrator.can.frames import Frames
from orchestrator.can.marking import Absences
from orchestrator.formats import Layout, read
from orchestrator.info import about_trace
from orchestrator.trace import Trace

DBC = """VERSION ""
BU_: Rig
BO_ 100 State: 8 Rig
 SG_ angle : 0|16@1- (0.01,0) [-10|10] "rad" Rig
 SG_ page M : 16|8@1+ (1,0) [0|1] "" Rig
 SG_ one m0 : 24|8@1+ (1,0) [0|255] "" Rig
 SG_ two m1 : 24|8@1+ (1,0) [0|255] "" Rig
 SG_ crc : 56|8@1+ (1,0) [0|255] "" Rig
BO_ 101 Event: 1 Rig
 SG_ level : 0|8@1+ (1,0) [0|200] "" Rig
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "ChecksumSignal" STRING ;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "ChecksumSignal" "";
BA_ "GenMsgCycleTime" BO_ 100 10;
"""
PROTECTED = 'BA_ "ChecksumSignal" BO_ 100 "crc";\n'


@given(
    lost=st.sets(st.integers(1, 398), max_size=80),
    pause=st.tuples(st.integers(10, 200), st.integers(5, 150)),
    modulus=st.sampled_from([0, 4, 16]),
    size=st.integers(1, 400),
    seed=st.integers(0, 99),
)
def test_batches_of_any_size_miss_as_many_frames_and_late_ones_are_none_of_them(
    lost: set[int], pause: tuple[int, int], modulus: int, size: int, seed: int
) -> None:
    count = np.delete(np.arange(400), sorted(lost))
    time = 0.01 * count + np.random.default_rng(seed).uniform(0, 0.001, len(count))
    begin, length = pause
    time = np.where((count > begin) & (count <= begin + length), 0.01 * (begin + length) + 1e-6 * count, time)
    time = np.maximum.accumulate(time)
    steps = np.diff(count, prepend=count[0] - 1)
    by_counter = steps % modulus - 1 if modulus else np.zeros(len(count))
    absences = Absences(0.01, modulus)
    found = sum(
        absences.feed(time[row : row + size], by_counter[row : row + size].astype(float))
        for row in range(0, len(count), size)
    )
    longest = int(steps.max()) - 1
    assert found == pytest.approx(len(lost), abs=0 if modulus > 2 * longest + 2 else modulus or 3)


def log(folder: Path, frames: Frames, protected: bool = False) -> Path:
    (folder / "rig.dbc").write_text(DBC + (PROTECTED if protected else ""))
    logs.write(folder / "run.blf", [frames])
    return folder / "run.blf"


def states(folder: Path, protected: bool = False) -> Frames:
    """400 frames of State with an angle of 1 rad, whose pages alternate."""
    (folder / "rig.dbc").write_text(DBC + (PROTECTED if protected else ""))
    time = 0.01 * np.arange(400)
    columns = {"angle": np.full(400, 1.0), "page": np.arange(400) % 2.0, "one": np.ones(400), "two": np.ones(400)}
    return Encoder(load(folder / "rig.dbc"), list(columns)).encode(Trace(time, columns))


def marks(folder: Path, frames: Frames, *signals: str) -> list[str]:
    path = log(folder, frames)
    return [str(mark) for mark in read(path, Layout(database=folder / "rig.dbc", signals=signals)).marks]


def test_a_page_that_stops_is_a_gap_of_its_signals_alone(tmp_path: Path) -> None:
    frames = states(tmp_path)
    frames.data[100:200, 2] = 0
    assert marks(tmp_path, frames, "angle", "one", "two") == ["gap of two from 0.99 to 2.01 s"]


def test_a_message_that_ends_before_the_log_does_has_a_gap_until_there(tmp_path: Path) -> None:
    frames = states(tmp_path)
    frames.id[300:] = 101
    frames.length[300:] = 1
    assert marks(tmp_path, frames, "angle", "level") == ["gap of angle from 2.99 to 3.99 s"]


def test_values_beyond_their_range_are_marked_with_the_samples_on_either_side(tmp_path: Path) -> None:
    frames = states(tmp_path)
    frames.data[[50, 51, 200], 1] = 0x7F
    expected = ["0.49 to 0.52", "1.99 to 2.01"]
    assert marks(tmp_path, frames, "angle") == [f"values outside the range of angle from {at} s" for at in expected]


def test_a_message_without_a_cycle_time_that_comes_when_it_likes_has_no_gaps(tmp_path: Path) -> None:
    frames = states(tmp_path)
    frames.id[::40] = 101
    frames.length[::40] = 1
    frames.id[200:360] = np.where(frames.id[200:360] == 101, 100, frames.id[200:360])
    assert marks(tmp_path, frames, "level") == []


def test_a_log_whose_checksums_are_all_wrong_says_so(tmp_path: Path) -> None:
    frames = states(tmp_path, protected=True)
    frames.data[:, 7] ^= 1
    path = log(tmp_path, frames, protected=True)
    with pytest.raises(TraceError, match="State: all of its 400 frames have a wrong checksum; see that the database"):
        read(path, Layout(database=tmp_path / "rig.dbc", signals=["angle"]))


def test_info_names_the_longest_marks_and_its_document_holds_all(tmp_path: Path) -> None:
    frames = states(tmp_path)
    frames.data[100:200, 2] = 0
    kept = np.ones(400, bool)
    kept[300:320] = False
    path = log(tmp_path, frames[kept])
    document = about_trace(path, Layout(database=tmp_path / "rig.dbc"))
    assert str(document["marked"]).startswith("gap of two from 0.99 to 2.01 s, gap of one from 2.98 to 3.2 s, ")
    found = document["found"]["marks"]  # type: ignore[index]
    assert {mark["kind"] for mark in found} == {"gap"} and ["angle", "page", "one", "two", "crc"] in [
        list(mark["signals"]) for mark in found
    ]
