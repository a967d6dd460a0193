"""A stimulus drives an input with what its recording holds, and says where it holds nothing."""

from __future__ import annotations

import numpy as np
import pytest

from fmus.errors import TraceError
from orchestrator.assembly.stimulus import Stimulus
from orchestrator.trace import Trace


@pytest.mark.parametrize("hold", [False, True])
def test_a_recording_that_is_empty_at_the_start_is_refused_with_the_time(hold: bool) -> None:
    trace = Trace(np.arange(4.0), {"u": np.array([np.nan, np.nan, 2.0, 3.0])}, name="log")
    assert Stimulus(trace, hold).values(np.array([2.0, 3.0]), "c.u").tolist() == [2.0, 3.0]
    with pytest.raises(TraceError, match=r"log\.u: has no value at t = 0 s; cut the recording"):
        Stimulus(trace, hold).values(np.array([0.0, 2.0]), "c.u")
