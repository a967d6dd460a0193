"""What of recordings is left out, and what of the rest has no value."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruamel.yaml import YAML

from fmus.errors import TraceError
from identification.recordings.marks import Exclusion, excluded, require_known, sound
from identification.recordings.schema import TracesBlock
from orchestrator.trace import Trace

NAMES = st.sampled_from(["rig", "rig_0.5__a", "7 kg, cold", "a: b", "yes", "null", "Größe", "it's {odd}"])


def exclusions(message: str) -> list[Any]:
    """What a message says of `traces`, as a study reads it."""
    said = message[message.index("`traces.") + len("`traces.") : message.rindex("`")]
    block = TracesBlock(files="*.csv", **YAML(typ="safe").load(said))
    return [stretch.exclusion() for stretch in block.exclude]


@given(NAMES, st.lists(st.integers(0, 99), min_size=1, max_size=4), st.integers(1, 9000), st.integers(-9000, 9000))
def test_what_a_message_says_leaves_out_the_samples_without_a_value_and_single_ones_between_them(
    name: str, lost: list[int], thousandths: int, begin: int
) -> None:
    values = np.arange(100.0)
    values[lost] = math.nan
    trace = Trace((begin + thousandths * np.arange(100)) / 1000, {"a": values, "b": np.ones(100)}, name=name)
    require_known(name, [trace], ["b"])
    with pytest.raises(TraceError, match="a: is not finite at t = ") as refused:
        require_known(name, [trace], ["b", "a"])
    other = Trace(trace.time, {"a": np.ones(100)}, name="another")
    marks, kept = excluded(exclusions(str(refused.value)), [trace, other])
    out = set(np.flatnonzero(~sound(trace, marks)).tolist())
    between = {number for number in range(100) if {number - 1, number + 1} <= set(lost)}
    assert (out, kept) == (set(lost) | between, [])
    left = trace.rows(sound(trace, marks))
    require_known(name, [left], ["a", "b"])


def test_of_many_stretches_the_first_and_their_number_are_said() -> None:
    trace = Trace(np.arange(100.0), {"a": np.where(np.arange(100) % 2, np.inf, 1.0)}, name="rig")
    with pytest.raises(TraceError, match=r"1 s \(50 samples\).*from: 7\.0, to: 7\.0}, \.\.\.\]`, 50 stretches"):
        require_known("rig", [trace], ["a"])


def test_a_condition_that_is_met_nowhere_is_told_and_one_of_no_signal_names_its_place(
    caplog: pytest.LogCaptureFixture,
) -> None:
    trace = Trace(np.arange(10.0), {"a": np.arange(10.0)}, name="rig")
    assert excluded([Exclusion(signal="a", above=5.0)], [trace]) != [[]]
    assert not caplog.messages
    assert excluded([Exclusion(signal="a", above=9.0)], [trace]) == [[]]
    assert caplog.messages == ["traces.exclude[0] leaves nothing out: 'a' is nowhere beyond its limit there"]
    with pytest.raises(TraceError, match=r"traces\.exclude\[0\]: rig: has no signal 'b'; it holds a"):
        excluded([Exclusion(signal="b", above=9.0)], [trace])
