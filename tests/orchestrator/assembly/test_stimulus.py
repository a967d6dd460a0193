"""A stimulus drives an input with what its recording holds, and says where it holds nothing."""

from __future__ import annotations

import numpy as np
import pytest

from fmus.errors import TraceError, WiringError
from orchestrator.assembly.stimulus import Stimulus
from orchestrator.fmi.interface import Port
from orchestrator.trace import Trace


@pytest.mark.parametrize("hold", [False, True])
def test_a_recording_that_is_empty_at_the_start_is_refused_with_the_time(hold: bool) -> None:
    trace = Trace(np.arange(4.0), {"u": np.array([np.nan, np.nan, 2.0, 3.0])}, name="log")
    assert Stimulus(trace, hold).values(np.array([2.0, 3.0]), "c.u").tolist() == [2.0, 3.0]
    with pytest.raises(TraceError, match=r"log: u: has no value at t = 0 s; cut the recording"):
        Stimulus(trace, hold).values(np.array([0.0, 2.0]), "c.u")


MODES = {"off": 1, "on": 5}


@pytest.mark.parametrize(
    ("kind", "good", "bad", "problem"),
    [
        ("Integer", [0.0, 3.0 + 1e-12, -7.0], 1.5, "1.5 is not whole"),
        ("Int8", [127.0, -128.0, 0.0], 128.0, "128.0 does not fit into Int8"),
        ("Boolean", [0.0, 1.0, 1.0 - 1e-12], 0.3, "is a Boolean, not 0.3"),
        ("Enumeration", [1.0, 5.0, 1.0], 3.0, r"cannot be 3.0; give off \(1\), on \(5\)"),
    ],
)
def test_values_that_an_input_cannot_take_are_refused_and_not_rounded(
    kind: str, good: list[float], bad: float, problem: str
) -> None:
    port = Port("n", 0, kind, "input", items=MODES if kind == "Enumeration" else None)
    driven, _ = Stimulus(Trace(np.arange(3.0), {"u": np.array(good)}, name="log")).brought("c.n", port)
    assert driven.values(np.arange(3.0), "c.n").tolist() == np.rint(good).tolist()
    for source in (Trace(np.arange(3.0), {"u": np.array([*good[:2], bad])}, name="log"), bad):
        with pytest.raises(WiringError, match=problem):
            Stimulus(source).brought("c.n", port)


def test_an_item_of_an_enumeration_is_a_constant_by_its_name() -> None:
    port = Port("n", 0, "Enumeration", "input", items=MODES)
    driven, _ = Stimulus("on").brought("c.n", port)
    assert driven.source == 5.0
