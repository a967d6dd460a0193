"""Two recordings part where they first differ by more than is allowed, and nowhere else."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fmus.errors import TraceError
from orchestrator.measures import partings
from orchestrator.trace import Trace

TIME = np.arange(5) / 10


def trace(name: str = "one", units: dict[str, str] | None = None, **signals: list[float]) -> Trace:
    return Trace(TIME, {key: np.array(values, dtype=float) for key, values in signals.items()}, units or {}, name)


def test_the_signal_that_parts_first_comes_first_with_where_and_by_what() -> None:
    one = trace(x=[0, 1, 2, 3, 4], y=[0, 0, 0, 0, 0], z=[1, 1, 1, 1, 1], only=[0] * 5, units={"x": "rad"})
    other = trace("other", x=[0, 1, 2, 3.5, 2], y=[0, 0.1, 0, 0, 0], z=[1, 1, 1, 1, 1])
    first, second = partings(one, other)
    assert (first.signal, first.time, first.one, first.other, first.samples, first.of) == ("y", 0.1, 0.0, 0.1, 1, 5)
    assert (second.signal, second.time, second.largest, second.largest_at) == ("x", TIME[3], 2.0, 0.4)
    assert str(second) == "x parts at 0.3 s, 3 from 3.5 rad; by 2 rad at most, at 0.4 s"


def test_what_is_allowed_is_no_parting() -> None:
    one, other = trace(x=[0, 1, 2, 3, 4]), trace("other", x=[0, 1, 2, 3.3, 4])
    assert partings(one, other, absolute=0.31) == []
    assert partings(one, other, relative=0.1) == []
    assert len(partings(one, other, absolute=0.29)) == 1
    assert len(partings(one, other, relative=0.05)) == 1


def test_nan_is_like_nan_alone_and_infinity_like_itself() -> None:
    bad = [0.0, math.nan, math.inf, 1.0, 1.0]
    assert partings(trace(x=bad), trace("other", x=bad)) == []
    (parting,) = partings(trace(x=bad), trace("other", x=[0.0, 2.0, math.inf, 1.0, 1.0]), 1e9, 1.0)
    assert parting.time == 0.1 and math.isnan(parting.largest)
    (parting,) = partings(trace(x=bad), trace("other", x=[0.0, math.nan, 3.0, 1.0, 1.0]), 1e9, 1.0)
    assert (parting.time, parting.largest) == (0.2, math.inf)


def test_other_stamps_are_met_on_the_line_or_the_step() -> None:
    one = trace(x=[0, 1, 2, 3, 4])
    coarse = Trace(np.array([0.0, 0.2, 0.3]), {"x": np.array([0.0, 2.0, 3.0])}, {}, "coarse")
    assert partings(one, coarse, absolute=1e-12) == []
    (parting,) = partings(one, coarse, hold=["x"])
    assert (parting.time, parting.other, parting.of) == (0.1, 0.0, 4)


def test_what_cannot_be_compared_is_refused() -> None:
    one = trace(x=[0] * 5, units={"x": "rad"})
    with pytest.raises(TraceError, match="has no signal in common with other"):
        partings(one, trace("other", y=[0] * 5))
    with pytest.raises(TraceError, match="x: is in rad in one, deg in other; convert one of them"):
        partings(one, trace("other", x=[0] * 5, units={"x": "deg"}))
    with pytest.raises(TraceError, match="has no time in common with other"):
        partings(one, trace("other", x=[0] * 5).shifted(9.0))
