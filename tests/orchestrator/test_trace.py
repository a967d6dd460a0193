"""What a trace promises."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fmus.errors import InputError, TraceError
from orchestrator.stamps import ordered
from orchestrator.trace import FloatArray, Trace, usable

INCREASING = st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=30, unique=True).map(sorted)


def ramp() -> Trace:
    time = np.linspace(0.0, 1.0, 11)
    return Trace(time, {"angle": 2 * time, "mode": np.floor(5 * time)}, {"angle": "rad"}, "ramp")


def test_what_happens_to_the_arrays_that_it_was_made_from_does_not_change_a_trace() -> None:
    time, values = np.arange(3.0), np.ones(3)
    view = values[:]
    view.flags.writeable = False  # although its owner can be written
    trace = Trace(time, {"a": values, "b": view})
    time[0], values[0] = -1.0, 5.0
    assert trace.time.tolist() == [0.0, 1.0, 2.0]
    assert trace["a"].tolist() == trace["b"].tolist() == [1.0, 1.0, 1.0]


MAKERS: list[Callable[[Trace], Trace]] = [
    lambda trace: trace,
    lambda trace: trace.select(["angle"]),
    lambda trace: trace.between(0.2, 0.8),
    lambda trace: trace.shifted(1.0),
    lambda trace: trace.resampled([0.1, 0.2]),
    lambda trace: pickle.loads(pickle.dumps(trace)),
    lambda trace: ordered(trace.time, trace.signals)[0],
]


@pytest.mark.parametrize("make", MAKERS)
def test_no_number_and_no_name_of_a_trace_can_be_written(make: Callable[[Trace], Trace]) -> None:
    trace = make(ramp())
    for array in (trace.time, trace["angle"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 9.0
    with pytest.raises(TypeError):
        trace.signals["angle"] = trace.time  # type: ignore[index]
    with pytest.raises(TypeError):
        trace.units["angle"] = "m"  # type: ignore[index]


def test_a_trace_made_of_a_trace_shares_its_numbers() -> None:
    trace = ramp()
    assert np.shares_memory(trace.select(["angle"])["angle"], trace["angle"])
    assert np.shares_memory(trace.between(0.2, 0.8).time, trace.time)


def test_traces_are_equal_when_all_that_they_hold_is() -> None:
    gap = Trace([0.0, 1.0], {"a": [np.nan, 1.0]}, {"a": "m"}, "log")
    same = pickle.loads(pickle.dumps(gap))
    assert gap == same and hash(gap) == hash(same) and len({gap, same}) == 1
    others = [
        gap.shifted(1.0),
        gap.renamed({"a": "b"}),
        replace(gap, name="other"),
        replace(gap, units={}),
        replace(gap, signals={"a": [np.nan, 2.0]}),
        replace(gap, signals={"a": [0.0, 1.0]}),
    ]
    assert all(gap != other for other in others)
    assert gap != "log"


def test_a_trace_is_shown_in_one_short_line() -> None:
    assert repr(ramp()) == "<Trace 'ramp': 11 samples, 0 to 1 s; angle [rad], mode>"
    assert repr(Trace([], {})) == "<Trace 'trace': 0 samples; >"
    many = Trace(np.arange(2000.0), {f"s{number}": np.arange(2000.0) for number in range(300)})
    assert repr(many) == "<Trace 'trace': 2,000 samples, 0 to 1999 s; s0, s1, s2, s3, s4, s5 and 294 more>"


def test_a_notebook_shows_a_table_of_signals() -> None:
    html = ramp()._repr_html_()
    assert "ramp: 11 samples, 0 to 1 s" in html and html.count("<tr>") == 3
    assert '<td>angle</td><td>rad</td><td class="n">0</td><td class="n">2</td>' in html
    assert "&lt;b&gt;" in Trace([], {"<b>": []})._repr_html_()
    gone = Trace([0.0, 1.0], {"gone": [np.nan, np.nan]})
    assert gone._repr_html_().count("nan") == 2


def test_a_frame_has_the_samples_over_the_time_and_the_units() -> None:
    trace = ramp()
    frame = trace.to_pandas()
    assert frame.index.name == "time [s]" and list(frame.columns) == ["angle", "mode"]
    assert np.array_equal(frame.index, trace.time) and np.array_equal(frame["angle"], trace["angle"])
    assert frame.attrs["units"] == {"angle": "rad"}


def test_without_pandas_a_frame_is_refused_with_the_fix(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="pandas is not installed; pip install pandas"):
        ramp().to_pandas()


def test_a_plot_has_a_window_a_signal_with_its_unit() -> None:
    figure = ramp().plot()
    assert [curve.name for curve in figure.data] == ["angle", "mode"]
    assert (figure.layout.yaxis.title.text, figure.layout.yaxis2.title.text) == ("angle [rad]", "mode")
    assert np.array_equal(figure.data[0].x, ramp().time) and np.array_equal(figure.data[0].y, ramp()["angle"])


@pytest.mark.parametrize("time", [[0.0, 0.0], [1.0, 0.0], [0.0, np.nan], [[0.0, 1.0]]])
def test_a_trace_cannot_be_made_from_bad_stamps(time: list[float]) -> None:
    with pytest.raises(TraceError):
        Trace(np.array(time), {})


def test_an_unknown_signal_is_refused_with_the_known_ones() -> None:
    with pytest.raises(TraceError, match="no signal 'speed'; it holds angle, mode"):
        ramp()["speed"]


def test_selection_keeps_order_units_and_name() -> None:
    chosen = ramp().select(["mode", "angle"])
    assert (chosen.names, chosen.units, chosen.name) == (("mode", "angle"), {"angle": "rad"}, "ramp")


def test_renaming_carries_units_and_refuses_a_clash() -> None:
    assert ramp().renamed({"angle": "theta"}).unit("theta") == "rad"
    with pytest.raises(TraceError, match="two signals would get one name"):
        ramp().renamed({"angle": "mode"})


@given(INCREASING, st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_a_window_holds_exactly_the_samples_inside_with_both_ends(
    stamps: list[float], start: float, stop: float
) -> None:
    window = Trace(np.array(stamps), {"a": np.cos(stamps)}).between(start, stop)
    inside = [t for t in stamps if start <= t <= stop]
    assert window.time.tolist() == inside
    assert np.array_equal(window["a"], np.cos(inside))


def test_shifting_moves_stamps_and_nothing_else() -> None:
    shifted = ramp().shifted(-0.5)
    assert shifted.time[0] == -0.5
    assert np.array_equal(shifted["angle"], ramp()["angle"])


@given(arrays(float, 7, elements=st.floats(0.0, 1.0), unique=True).map(np.sort))
def test_resampling_a_straight_line_is_exact(instants: FloatArray) -> None:
    assert ramp().resampled(instants)["angle"] == pytest.approx(2 * instants, abs=1e-14)


@given(INCREASING)
def test_resampling_at_the_own_stamps_changes_nothing(stamps: list[float]) -> None:
    trace = Trace(np.array(stamps), {"a": np.sin(stamps)})
    assert np.array_equal(trace.resampled(trace.time)["a"], trace["a"])


def test_a_held_signal_keeps_its_last_value_up_to_the_next_stamp() -> None:
    trace = Trace(np.array([0.0, 1.0, 2.0]), {"relay": np.array([1.0, 5.0, 2.0])})
    held = trace.resampled([0.0, 0.999, 1.0, 1.5, 2.0], hold=["relay"])
    assert held["relay"].tolist() == [1.0, 1.0, 5.0, 5.0, 2.0]


@pytest.mark.parametrize("instants", [[-0.1, 0.5], [0.5, 1.1]])
def test_nothing_is_extrapolated(instants: list[float]) -> None:
    with pytest.raises(TraceError, match="covers 0 to 1 s"):
        ramp().resampled(instants)


@pytest.mark.parametrize("instants", [[-1e-13, 0.5], [0.5, 1 + 1e-13]])
def test_an_instant_that_rounding_put_outside_is_taken_as_the_end(instants: list[float]) -> None:
    """Instants computed as start + k step miss the last stamp by some bits."""
    found = ramp().resampled(instants, hold=["mode"])
    assert found["angle"] == pytest.approx(np.clip(instants, 0, 1) * 2, abs=1e-12)


@given(st.integers(1, 400), st.sampled_from([0.01, 0.1, 1 / 3, 1e-4]))
def test_a_held_signal_has_a_stamps_value_at_that_stamp_however_it_was_computed(row: int, step: float) -> None:
    """k step and the sum of k steps differ by some bits; one before the stamp would read the row before."""
    stamps = step * np.arange(401)
    trace = Trace(stamps, {"row": np.arange(401.0)})
    for instant in (float(np.sum(np.full(row, step))), np.nextafter(stamps[row], 0)):
        assert trace.resampled([instant], hold=["row"])["row"] == [row]


def test_an_empty_window_cannot_be_resampled() -> None:
    with pytest.raises(TraceError, match="has no samples"):
        ramp().between(5, 6).resampled([5.5])


def test_usable_signals_pass_unchanged() -> None:
    trace = ramp()
    assert usable(trace, ["angle", "mode"]) is trace


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ([1.0, np.nan, np.inf], r"log\.a: is not finite at t = 1 s \(2 samples\)"),
        ([0.5, 0.5, 0.5], r"log\.a: is constant \(0\.5\)"),
    ],
)
def test_useless_signals_are_refused_by_name(values: list[float], problem: str) -> None:
    trace = Trace(np.arange(3.0), {"a": np.array(values)}, name="log")
    with pytest.raises(TraceError, match=problem):
        usable(trace, ["a"])


def test_usable_refuses_an_empty_window_and_a_missing_signal() -> None:
    with pytest.raises(TraceError, match="has no samples"):
        usable(ramp().between(5, 6), ["angle"])
    with pytest.raises(TraceError, match="no signal 'torque'"):
        usable(ramp(), ["torque"])


def test_a_trace_is_complete_from_where_all_signals_have_begun() -> None:
    late = np.array([np.nan, np.nan, 1.0, np.nan])
    trace = Trace(np.arange(4.0), {"a": np.array([np.nan, 1.0, 2.0, 3.0]), "b": late})
    assert trace.complete().time.tolist() == [2.0, 3.0]
    assert len(Trace(np.arange(4.0), {"a": np.full(4, np.nan)}).complete()) == 0
    with pytest.raises(TraceError, match=r"is not finite at t = 0 s \(3 samples; its first value comes at 2 s\)"):
        usable(trace, ["b"])
