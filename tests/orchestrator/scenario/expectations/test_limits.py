"""Expectations hold exactly where they should, and say by how much."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from fmus.errors import FmuError, ScenarioError, TraceError
from orchestrator import formats
from orchestrator.scenario.expectations import Check, Ran
from orchestrator.scenario.expectations.schema import ExpectationBlock
from orchestrator.trace import Trace


def check(fields: dict[str, Any], trace: Trace | None, error: FmuError | None = None, base: Path = Path()) -> Check:
    return ExpectationBlock(**fields).expectation(base).check(Ran(trace, error))


def ramp(**signals: Any) -> Trace:
    """y = t from 0 to 1 s in tenths, and others."""
    time = np.linspace(0.0, 1.0, 11)
    return Trace(time, {"y": time, **signals}, {"y": "rad"}, "ramp")


def judged(trace: Trace | None = None, **fields: Any) -> Check:
    return check({"signal": "y", **fields}, trace or ramp())


@pytest.mark.parametrize(
    ("fields", "held", "found"),
    [
        ({"below": 1.0}, False, "largest 1 rad"),
        ({"below": 1.0001}, True, "largest 1 rad"),
        ({"above": 0.0}, False, "smallest 0 rad"),
        ({"above": -0.1}, True, "smallest 0 rad"),
        ({"near": 0.5, "within": 0.5}, True, "largest deviation 0.5 rad"),
        ({"near": 0.5, "within": 0.49}, False, "largest deviation 0.5 rad"),
        ({"below": 0.51, "before": 0.5}, True, "largest 0.5 rad"),
        ({"above": 0.49, "after": 0.5}, True, "smallest 0.5 rad"),
        ({"near": 0.6, "within": 0.11, "after": 0.5, "before": 0.7}, True, "largest deviation 0.1 rad"),
    ],
)
def test_limits_and_values_are_judged_on_the_samples_between_the_times(
    fields: dict[str, float], held: bool, found: str
) -> None:
    result = judged(**fields)
    assert (result.held, result.found) == (held, found)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"below": 2.0}, "y stays below 2"),
        ({"above": -1.5, "after": 0.5}, "y stays above -1.5 after 0.5 s"),
        ({"near": 0.5, "within": 1.0, "after": 0.1, "before": 0.9}, "y is 0.5 within 1 after 0.1 s before 0.9 s"),
    ],
)
def test_a_check_says_in_words_what_was_asked(fields: dict[str, float], text: str) -> None:
    assert judged(**fields).text == text


@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=20), st.floats(-1e6, 1e6), st.floats(0, 1e6))
def test_near_is_the_largest_deviation(values: list[float], near: float, within: float) -> None:
    trace = Trace(np.arange(len(values)), {"y": np.array(values)})
    assert judged(trace, near=near, within=within).held == all(abs(value - near) <= within for value in values)


@pytest.mark.parametrize("fields", [{"below": 9.0}, {"above": -9.0}, {"near": 0.5, "within": 9.0}])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_sample_that_is_not_finite_never_lets_near_hold_and_nan_lets_nothing_hold(
    fields: dict[str, float], bad: float
) -> None:
    values = np.linspace(0, 1, 11)
    values[4] = bad
    held = judged(ramp(y=values), **fields).held
    if math.isnan(bad) or "near" in fields:
        assert not held
    else:
        assert held == ((bad < 0) == ("below" in fields))


def follow(trace: Trace, reference: Trace, folder: Path, within: float, **times: float) -> Check:
    formats.write(reference, folder / "reference.csv")
    block = {"file": "reference.csv", "signal": "angle"}
    return check({"signal": "y", "reference": block, "within": within, **times}, trace, base=folder)


def test_a_reference_is_followed_at_the_samples_of_the_run_between_those_of_the_reference(tmp_path: Path) -> None:
    coarse = Trace(np.array([0.0, 0.35, 1.0]), {"angle": np.array([0.0, 0.35, 1.02])}, {"angle": "rad"}, "reference")
    assert follow(ramp(), coarse, tmp_path, 0.021).held
    result = follow(ramp(), coarse, tmp_path, 0.019)
    assert (result.held, result.found) == (False, "largest deviation 0.02 rad")
    assert result.text == "y follows angle of reference.csv within 0.019"
    assert follow(ramp(), coarse, tmp_path, 0.001, before=0.3).held


def test_a_reference_that_does_not_cover_the_window_is_an_error_not_extrapolated(tmp_path: Path) -> None:
    short = Trace(np.array([0.0, 0.5]), {"angle": np.array([0.0, 0.5])}, {}, "short")
    with pytest.raises(ScenarioError, match=r"covers 0 to 0\.5 s, not 0 to 1 s"):
        follow(ramp(), short, tmp_path, 1.0)
    assert follow(ramp(), short, tmp_path, 1e-9, before=0.5).held


def test_a_reference_that_is_missing_is_an_error(tmp_path: Path) -> None:
    block = {"file": "missing.csv", "signal": "angle"}
    with pytest.raises(TraceError, match=r"missing\.csv: there is no such file"):
        check({"signal": "y", "reference": block, "within": 1.0}, ramp(), base=tmp_path)


def test_a_window_without_samples_is_an_error() -> None:
    with pytest.raises(ScenarioError, match="expect y: there is no sample from 5 to 1 s; correct `after` and `before`"):
        judged(below=1.0, after=5.0)


def test_a_signal_that_was_not_recorded_is_an_error() -> None:
    with pytest.raises(TraceError, match="no signal 'z'"):
        check({"signal": "z", "below": 1.0}, ramp())


@pytest.mark.parametrize(
    ("error", "held", "found"),
    [
        (FmuError("hand", "step", "rest at the equilibrium"), True, "hand: step; rest at the equilibrium"),
        (FmuError("hand", "step", "another reason"), False, "hand: step; another reason"),
        (None, False, "the run went through"),
    ],
)
def test_refusal_holds_only_for_the_expected_reason(error: FmuError | None, held: bool, found: str) -> None:
    result = check({"refused": "rest at the equilibrium"}, None if error else ramp(), error)
    assert result == Check("refused because of 'rest at the equilibrium'", held, found)


def test_a_run_that_failed_fulfils_nothing_else() -> None:
    result = check({"signal": "y", "below": 9.0}, None, FmuError("hand", "step"))
    assert result == Check("y stays below 9", False, "hand: step")


REFERENCE = {"file": "a.csv", "signal": "b"}


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"signal": "y"}, "give one of near, reference, below, above, equals, refused"),
        ({"signal": "y", "below": 1, "above": 0}, "give one of near, reference, below, above, equals, refused"),
        ({"signal": "y", "near": 1}, "`within` goes with `near` and `reference`"),
        ({"signal": "y", "reference": REFERENCE}, "`reference` goes with one of within, funnel"),
        ({"signal": "y", "below": 1, "within": 1}, "`within` goes with `near` and `reference`"),
        ({"below": 1}, "`signal` goes with everything but `refused`"),
        ({"signal": "y", "refused": "x"}, "`signal` goes with everything but `refused`"),
        ({"signal": "y", "below": math.nan}, "finite number"),
    ],
)
def test_an_expectation_of_no_kind_or_two_is_refused(fields: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValidationError, match=problem):
        ExpectationBlock(**fields)
