"""Conditions on signals say from which frame to which a bus is recorded, and none of those is lost."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import DatabaseError, InputError
from orchestrator.can.database.bus import LogDatabase, load_all
from orchestrator.can.live.trigger import RecordingLimits, Trigger

DATABASE = """VERSION ""
BS_:
BU_:
BO_ 256 State: 8 Vector__XXX
 SG_ angle : 0|16@1- (0.001,0) [0|0] "rad" Vector__XXX
 SG_ speed : 16|16@1- (1,0) [0|0] "rad/s" Vector__XXX
BO_ 257 Other: 8 Vector__XXX
 SG_ angle : 0|16@1- (1,0) [0|0] "rad" Vector__XXX
"""


@cache
def log() -> LogDatabase:
    with TemporaryDirectory() as folder:
        path = Path(folder, "rig.dbc")
        path.write_text(DATABASE)
        return load_all(path)


def speeds(*values: int) -> list[can.Message]:
    """Frames with these speeds, one in a tenth of a second."""
    return [
        can.Message(
            timestamp=1.7e9 + 0.1 * k,
            arbitration_id=256,
            is_extended_id=False,
            data=bytes(2) + value.to_bytes(2, "little", signed=True) + bytes(4),
            channel=0,
        )
        for k, value in enumerate(values)
    ]


def places(limits: RecordingLimits, messages: list[can.Message], size: int = 3) -> list[int]:
    """Which of the frames pass, given so many at once."""
    trigger = Trigger(limits, log(), ["can0"])
    parts = [messages[begin : begin + size] for begin in range(0, len(messages), size)]
    passed = [message for part in parts for message in trigger.passed(part)]
    return [next(k for k, own in enumerate(messages) if own is message) for message in passed]


@pytest.mark.parametrize(
    ("limits", "passing"),
    [
        (RecordingLimits(), range(8)),
        (RecordingLimits(start="speed > 4"), range(5, 8)),
        (RecordingLimits(start="speed>=4"), range(4, 8)),
        (RecordingLimits(start="State.speed == 4", before=0.25), range(2, 8)),
        (RecordingLimits(stop="speed > 4"), range(6)),
        (RecordingLimits(start="speed > 2", stop="speed != 0"), range(3, 5)),  # the one that starts it does not end it
        (RecordingLimits(start="speed > 2", stop="State.angle < -1", before=100), range(8)),
        (RecordingLimits(start="speed > 99", before=1), ()),
    ],
)
def test_frames_pass_from_the_one_to_the_other(limits: RecordingLimits, passing: Iterable[int]) -> None:
    assert places(limits, speeds(*range(8))) == list(passing)


@given(st.lists(st.integers(-5, 5), max_size=40), st.integers(1, 7), st.integers(0, 20))
def test_what_passes_does_not_depend_on_how_many_frames_come_at_once(values: list[int], size: int, before: int) -> None:
    limits = RecordingLimits("speed > 2", "speed < -2", before * 0.1)
    found = places(limits, speeds(*values), size)
    assert found == places(limits, speeds(*values), 1)
    first = next((k for k, value in enumerate(values) if value > 2), None)
    if first is None:
        assert not found
    else:
        last = next((k for k, value in enumerate(values) if k > first and value < -2), len(values) - 1)
        assert found == list(range(found[0], last + 1))
        assert max(0, first - before) <= found[0] <= max(0, first - before) + 1


def test_only_frames_of_the_channel_that_has_the_signal_count() -> None:
    own = LogDatabase(None, {"right": log().databases[0]})
    trigger = Trigger(RecordingLimits(start="speed > 0"), own, ["left", "right"])
    other, own_message = speeds(1, 1)
    own_message.channel = 1
    assert trigger.passed([other]) == []
    assert trigger.passed([own_message]) == [own_message]


def test_a_condition_that_never_held_is_told_with_what_was_seen() -> None:
    trigger = Trigger(RecordingLimits(start="speed > 9"), log(), ["can0"])
    trigger.passed(speeds(1, 2, 3))
    assert trigger.remarks() == ["'speed > 9' has never held in 3 frames, so none was recorded"]


@pytest.mark.parametrize(
    ("limits", "problem"),
    [
        (RecordingLimits(start="speed"), "write SIGNAL < NUMBER"),
        (RecordingLimits(start="speed > fast"), "write SIGNAL < NUMBER"),
        (RecordingLimits(stop="speed > nan"), "write SIGNAL < NUMBER"),
        (RecordingLimits(stop="sped > 1"), "did you mean 'speed'"),
        (RecordingLimits(stop="angle > 1"), "write 'State.angle' or 'Other.angle'"),
        (RecordingLimits(before=1.0), "--start-when"),
        (RecordingLimits(start="speed > 1", before=float("nan")), "number of seconds"),
    ],
)
def test_what_cannot_be_understood_is_refused(limits: RecordingLimits, problem: str) -> None:
    with pytest.raises((InputError, DatabaseError), match=problem):
        Trigger(limits, log(), ["can0"])


def test_a_condition_needs_a_database() -> None:
    with pytest.raises(InputError, match="give --dbc"):
        Trigger(RecordingLimits(start="speed > 1"), None, ["can0"])
