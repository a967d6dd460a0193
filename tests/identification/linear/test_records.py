"""Records cut at gaps, and what is refused before anything is estimated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import IdentificationError, TraceError
from identification.linear.records import InputOutputData, without_gaps
from orchestrator.trace import Trace


def ramp(samples: int, step: float = 0.01, name: str = "ramp") -> InputOutputData:
    return InputOutputData(np.arange(float(samples)), np.arange(2.0 * samples).reshape(-1, 2), step, name=name)


def test_columns_get_names_and_one_dimension_is_one_column() -> None:
    assert ramp(10).u.shape == (10, 1)
    assert (ramp(10).inputs, ramp(10).outputs) == (("u1",), ("y1", "y2"))


@pytest.mark.parametrize(
    "change",
    [
        {"u": np.zeros(9)},
        {"step": 0.0},
        {"step": np.nan},
        {"inputs": ("a", "b")},
        {"y": np.zeros((10, 2, 2))},
        {"y": np.zeros((10, 0))},
    ],
)
def test_sizes_and_steps_that_make_no_sense_are_refused(change: dict[str, object]) -> None:
    given: dict[str, object] = {"u": np.zeros(10), "y": np.zeros((10, 2)), "step": 0.01} | change
    with pytest.raises(IdentificationError):
        InputOutputData(**given)  # type: ignore[arg-type]


def test_a_record_is_split_where_a_sample_is_missing_and_short_pieces_are_counted() -> None:
    whole = ramp(100)
    u, y = whole.u.copy(), whole.y.copy()
    y[30, 1], u[35] = np.nan, np.inf
    pieces = without_gaps(replace(whole, u=u, y=y), 10)
    assert [len(piece) for piece in pieces.records] == [30, 64]
    assert pieces.records[1].u[0] == 36
    assert (pieces.dropped, pieces.lost, pieces.samples) == (1, 4, 94)


@given(st.lists(st.integers(0, 59), max_size=12, unique=True), st.integers(1, 8))
def test_pieces_and_losses_add_up_to_the_finite_samples(gaps: list[int], shortest: int) -> None:
    u = ramp(80).u.copy()
    u[gaps] = np.nan
    pieces = without_gaps(replace(ramp(80), u=u), shortest)
    assert pieces.samples + pieces.lost == 80 - len(gaps)
    assert all(np.isfinite(piece.u).all() and len(piece) >= shortest for piece in pieces.records)
    assert all(np.all(np.diff(piece.u[:, 0]) == 1) for piece in pieces.records)


def test_records_of_different_steps_are_refused_with_both() -> None:
    with pytest.raises(IdentificationError, match=r"fast: is sampled every 0.002 s, slow every 0.01 s; resample"):
        without_gaps([ramp(50, name="slow"), ramp(50, 0.002, "fast")], 5)


def test_records_of_different_columns_are_refused() -> None:
    other = InputOutputData(np.zeros(50), np.zeros((50, 2)), 0.01, ("torque",))
    with pytest.raises(IdentificationError, match="torque"):
        without_gaps([ramp(50), other], 5)


def test_nothing_long_enough_is_refused_with_the_longest() -> None:
    with pytest.raises(IdentificationError, match="has 50 samples, 51 are needed"):
        without_gaps(ramp(50), 51)
    with pytest.raises(IdentificationError, match="there are none"):
        without_gaps([], 5)


def test_a_trace_becomes_a_record_with_its_names() -> None:
    time = 0.1 + 0.002 * np.arange(300)
    trace = Trace(time, {"v": np.sin(time), "angle": time, "strain": -time}, name="run 3")
    made = InputOutputData.of(trace, ["v"], ["angle", "strain"])
    assert made.step == pytest.approx(0.002)
    assert (made.name, made.inputs, made.outputs) == ("run 3", ("v",), ("angle", "strain"))
    assert np.array_equal(made.y[:, 1], -time)


def test_uneven_stamps_are_refused() -> None:
    time = 0.002 * np.arange(300.0)
    time[150:] += 0.001
    with pytest.raises(TraceError, match="off an even grid"):
        InputOutputData.of(Trace(time, {"v": time, "angle": time}), ["v"], ["angle"])
    with pytest.raises(TraceError, match="1 samples"):
        InputOutputData.of(Trace(time[:1], {"v": time[:1], "angle": time[:1]}), ["v"], ["angle"])


def test_values_whose_squares_overflow_are_refused() -> None:
    whole = replace(ramp(50), y=np.full((50, 2), -1e200))
    with pytest.raises(IdentificationError, match=r"ramp: holds a value of 1e\+200"):
        without_gaps(whole, 5)


def test_data_cannot_be_written_to_and_do_not_change_with_the_array_they_came_from() -> None:
    u = np.zeros(10)
    data = InputOutputData(u, np.zeros((10, 1)), 0.01)
    u[3] = 1.0
    assert not data.u.any()
    with pytest.raises(ValueError, match="read-only"):
        data.y[0] = 1.0
    assert repr(data) == "<InputOutputData record: u1 to y1, 10 samples every 0.01 s>"
