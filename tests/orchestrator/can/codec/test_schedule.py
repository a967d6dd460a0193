"""The schedule of a sender comes back from stamps that are late by anything but early by nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus.errors import TraceError
from orchestrator.can.codec import decoding
from orchestrator.can.codec.encoding import Encoder
from orchestrator.can.codec.merging import Series
from orchestrator.can.codec.schedule import on_schedule
from orchestrator.can.database import writing
from orchestrator.can.database.bus import LogDatabase
from orchestrator.can.database.database import load
from orchestrator.trace import Trace

PERIOD = 0.005 * (1 + 80e-6)  # a quartz that is 80 ppm slow
BUTTERFLY = Path(__file__).parents[4] / "scenarios" / "butterfly" / "butterfly.dbc"


def late(count: int, rng: np.random.Generator) -> np.ndarray:
    """Some tenths of a millisecond, and now and then a stall after which many frames come at once."""
    stamps = 7.0 + PERIOD * np.arange(count) + rng.exponential(2e-4, count)
    for begin in rng.integers(0, count - 50, 5):
        stamps[begin : begin + 50] = np.maximum(stamps[begin : begin + 50], stamps[begin + 50])
    return np.maximum.accumulate(stamps)


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10_000), lost=st.floats(0, 0.2))
def test_late_and_lost_frames_leave_the_schedule_as_it_was(seed: int, lost: float) -> None:
    rng = np.random.default_rng(seed)
    kept = np.flatnonzero(rng.random(4000) >= lost)
    stamps = late(4000, rng)[kept]
    found, schedule = on_schedule(Series(stamps, {}, {}), "State", kept % 256.0, 256)
    true = 7.0 + PERIOD * kept
    assert np.ptp(found.time - true) < 2e-5
    assert abs(np.mean(found.time - true)) < 2e-5
    assert schedule.period == pytest.approx(PERIOD, rel=2e-6)
    assert schedule.late[1] > 0.1
    assert schedule.left == 0


def test_in_a_long_log_the_earliest_frames_of_each_part_make_the_line() -> None:
    """Frames are 1 ms late on average, the earliest of all 10 ns; stamps begin far from 0."""
    count, rng = np.arange(100_000), np.random.default_rng(4)
    true = 7000.0 + PERIOD * count
    stamps = np.maximum.accumulate(true + rng.exponential(1e-3, len(count)))
    found, schedule = on_schedule(Series(stamps, {}, {}), "State", count % 256.0, 256)
    assert np.abs(found.time - true).max() < 3e-7
    assert schedule.late == pytest.approx((np.median(stamps - true), np.max(stamps - true)), abs=3e-7)


def test_a_log_of_too_few_frames_keeps_its_stamps_and_says_so() -> None:
    stamps = 7.0 + PERIOD * np.arange(19)
    found, schedule = on_schedule(Series(stamps, {}, {}), "State", np.arange(19.0), 256)
    assert np.array_equal(found.time, stamps)
    assert (schedule.period, schedule.late, schedule.left) == (0.0, (0.0, 0.0), 19)


def test_each_stretch_between_long_gaps_has_a_line_of_its_own_and_few_frames_keep_their_stamps() -> None:
    rng = np.random.default_rng(1)
    stamps = np.concatenate([late(1000, rng), [30.0, 30.5], 40.0123 + late(1000, rng), [300.0]])
    counter = np.concatenate([np.arange(1000), [3, 4], np.arange(1000), [3]]) % 256.0
    found, schedule = on_schedule(Series(stamps, {}, {}), "State", counter, 256)
    assert np.ptp(found.time[:1000] - PERIOD * np.arange(1000)) < 2e-5
    assert np.ptp(found.time[1002:2002] - PERIOD * np.arange(1000)) < 2e-5
    assert found.time[1002] - found.time[0] == pytest.approx(40.0123, abs=4e-5)
    for few in (slice(1000, 1002), slice(2002, None)):
        assert np.array_equal(found.time[few], stamps[few])
    assert "3 frames too far from others keep theirs" in str(schedule)


def test_a_log_is_read_with_the_stamps_of_the_sender() -> None:
    database, rng = load(BUTTERFLY), np.random.default_rng(2)
    time = 0.005 * np.arange(2000)
    angle = np.round(np.sin(3 * time), 4)
    sent = Encoder(database, ["State.angle"]).encode(Trace(time, {"State.angle": angle}, {}))
    object.__setattr__(sent, "time", np.maximum.accumulate(sent.time + rng.exponential(1e-3, len(sent))))
    plain, steady = (
        decoding.trace([sent], LogDatabase(database), ["angle"], steady=names) for names in ((), ("State",))
    )
    assert np.abs(np.diff(steady.trace.time) - 0.005).max() < 1e-5 < np.abs(np.diff(plain.trace.time) - 0.005).max()
    assert steady.trace["angle"] == pytest.approx(angle, abs=1e-9)
    assert steady.trace.names == ("angle",)
    assert str(steady.schedules[0]).startswith("State: stamps put on a schedule of 5 ms")


def test_a_message_without_a_counter_has_no_schedule_to_be_found(tmp_path: Path) -> None:
    writing.generate([writing.Declared("angle", "rad", -1.0, 1.0, None, 0.01)], tmp_path / "a.dbc")
    database = load(tmp_path / "a.dbc")
    with pytest.raises(TraceError, match="has no counter, so its schedule cannot be recovered"):
        decoding.trace([], LogDatabase(database), steady=[database.messages[0].name])
