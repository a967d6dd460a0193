"""Windows: where they begin, what drives them, and what they start from."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import TraceError, WiringError
from fmus.units import Conversion
from identification.output_error.free_runs.window import FreeRunWindow
from identification.output_error.study import StartSpec
from identification.output_error.times.delays import KnownDelay
from identification.output_error.windows import counted, cut_windows, evenly_weighed, start_curve
from identification.recordings.campaign import StudyTrace
from orchestrator.crossing import noted
from orchestrator.fmi.interface import Port
from orchestrator.marks import Mark, union
from orchestrator.trace import FloatArray, Trace
from tests.support.identification.small_study import plain_study


def recorded(time: FloatArray, mass: float = 0.05, **signals: FloatArray) -> StudyTrace:
    columns = {"voltage": np.sin(7 * time), "angle": np.cos(3 * time)} | signals
    trace = Trace(time, columns, name="run")
    return StudyTrace(trace, {}, Path("data/run.csv"), "00", "fine", values={"hand.added_mass": mass})


def cuts(
    trace: StudyTrace, initial: dict[str, Any] | None = None, step: float = 0.01, **windows: Any
) -> list[FreeRunWindow]:
    asked = plain_study(windows=windows, initial=initial or {}, step=step)
    return cut_windows(asked.run, [trace], asked.windows)


def start_value(trace: Trace, start: float, spec: StartSpec) -> float:
    return float(start_curve(trace, start, spec)(start))


def starts(trace: StudyTrace, **windows: Any) -> list[float]:
    return [cut.start for cut in cuts(trace, **windows)]


EVEN = np.arange(1001) * 0.01  # 10 s


def spoilt(value: float) -> FloatArray:
    """A ramp with one sample of this value, at 5 s."""
    ramp = EVEN.copy()
    ramp[500] = value
    return ramp


def test_windows_lie_back_to_back_by_default_until_the_trace_ends() -> None:
    assert starts(recorded(EVEN), length=3) == [0, 3, 6]
    assert starts(recorded(EVEN), length=2.5) == [0, 2.5, 5, 7.5]


@given(length=st.integers(1, 9), every=st.integers(1, 9), most=st.integers(1, 9))
def test_windows_count_samples_as_often_as_they_hold_them(length: int, every: int, most: int) -> None:
    cut = cuts(recorded(EVEN), length=length, every=every, most=most)
    held = {second for window in cut for second in range(int(window.start), int(window.start) + length)}
    assert counted(cut) == pytest.approx(len(cut) * length / len(held))
    assert every < length or counted(cut) == 1


def test_skip_every_and_most_are_what_they_say() -> None:
    assert starts(recorded(EVEN), length=2, skip=3) == [3, 5, 7]
    assert starts(recorded(EVEN), length=2, every=1) == list(range(9))
    assert starts(recorded(EVEN), length=2, every=3, skip=1, most=2) == [1, 4]


def test_windows_begin_on_the_raster_of_the_step_after_the_first_stamp() -> None:
    (cut,) = cuts(recorded(EVEN + 0.0034), length=9, skip=0)
    assert cut.start == 0.01
    np.testing.assert_array_equal(cut.run_time, 0.01 + np.arange(901) * 0.01)
    np.testing.assert_allclose(cut.time, EVEN[1:901] + 0.0034)  # compared with samples, not between them


@given(begin=st.integers(-500, 500), steps=st.integers(1, 50))
def test_a_trace_as_long_as_a_window_holds_one_whatever_its_first_stamp(begin: int, steps: int) -> None:
    time = np.arange(begin, begin + steps + 1) * 0.1
    (cut,) = cuts(recorded(time), step=0.1, length=str(Fraction(steps, 10)))
    assert len(cut.measured) == steps + 1


def test_what_is_measured_and_what_drives_are_interpolated_at_the_instants() -> None:
    time = np.sort(np.random.default_rng(1).uniform(0, 10, 3000))
    trace = recorded(time)
    (cut,) = cuts(trace, length=4, skip=2, most=1)
    assert len(cut.measured) == 401 and cut.measured.shape[1] == 1
    np.testing.assert_array_equal(cut.measured[:, 0], np.interp(cut.time, time, trace.trace["angle"]))
    np.testing.assert_array_equal(cut.stimuli["motor.voltage"], np.interp(cut.time, time, trace.trace["voltage"]))


@pytest.mark.parametrize(
    "port", [Port("v", 0, "Boolean", "input"), Port("v", 0, "Real", "input", variability="discrete")]
)
@pytest.mark.parametrize("delay", [None, KnownDelay(0.0), KnownDelay(0.25)])
def test_an_input_that_changes_in_steps_holds_each_sample(port: Port, delay: KnownDelay | None) -> None:
    time = np.sort(np.random.default_rng(1).uniform(0, 10, 700))
    trace = recorded(time, voltage=(np.sin(7 * time) > 0).astype(float))
    asked = plain_study(windows={"length": 4, "skip": 2, "most": 1})
    signal = replace(asked.run.inputs["motor.voltage"], delay=delay)
    run = replace(asked.run, inputs={"motor.voltage": signal})
    (cut,) = cut_windows(run, [trace], asked.windows, {"motor.voltage": port})
    late = 0.0 if delay is None else delay.seconds
    expected = [trace.trace["voltage"][time <= instant - late][-1] for instant in cut.run_time]
    np.testing.assert_array_equal(cut.driven({})["motor.voltage"], expected)


def test_what_the_name_of_a_trace_tells_goes_with_each_of_its_windows() -> None:
    assert [cut.constants for cut in cuts(recorded(EVEN, mass=0.154), length=4)] == [{"hand.added_mass": 0.154}] * 2


@pytest.mark.parametrize("windows", [{"length": 10.02}, {"length": 4, "skip": 6.5}])
def test_a_trace_too_short_for_one_window_is_refused_with_its_duration(windows: dict[str, Any]) -> None:
    with pytest.raises(TraceError, match=r"run: lasts 10 s, too short for .* shorten the windows"):
        cuts(recorded(EVEN), **windows)


@pytest.mark.parametrize(
    ("bad", "problem"),
    [
        (spoilt(np.nan), "is not finite at t = 5 s"),
        (spoilt(np.inf), "is not finite at t = 5 s"),
        (np.full(1001, 2.0), r"is constant \(2\)"),
    ],
)
@pytest.mark.parametrize("signal", ["voltage", "angle"])
def test_a_signal_that_says_nothing_is_refused_with_file_and_signal(bad: FloatArray, problem: str, signal: str) -> None:
    with pytest.raises(TraceError, match=rf"data/run\.csv\.{signal}: {problem}"):
        cuts(recorded(EVEN, **{signal: bad}), length=4)


def test_a_signal_that_is_not_used_may_hold_anything() -> None:
    assert len(cuts(recorded(EVEN, humidity=np.full(1001, np.nan)), length=5)) == 2


def test_a_missing_signal_is_refused_with_those_there_are() -> None:
    trace = StudyTrace(Trace(EVEN, {"angle": np.sin(EVEN)}, name="run"), {}, Path("run.csv"), "00", "fine")
    with pytest.raises(TraceError, match=r"run\.csv: has no signal 'voltage'; it holds angle"):
        cuts(trace, length=4)


def test_start_values_come_from_each_windows_own_beginning() -> None:
    near = {"signal": "angle", "half_width": 0.035}
    initial = {"hand.angle_start": near, "hand.speed_start": near | {"derivative": 1}}
    for cut in cuts(recorded(EVEN), initial, length=2):
        assert cut.initial["hand.angle_start"] == pytest.approx(np.cos(3 * cut.start), abs=1e-4)
        assert cut.initial["hand.speed_start"] == pytest.approx(-3 * np.sin(3 * cut.start), abs=0.02)


@given(
    coefficients=st.lists(st.floats(-3, 3), min_size=1, max_size=5),
    derivative=st.integers(0, 2),
    extra=st.integers(0, 2),
    start=st.sampled_from([0.0, 0.3, 1.0]),  # the beginning, where samples lie on one side only; inside; the end
    seed=st.integers(0, 1000),
)
def test_start_values_are_exact_for_polynomials_of_the_degree(
    coefficients: list[float], derivative: int, extra: int, start: float, seed: int
) -> None:
    degree = max(len(coefficients) - 1 + extra, derivative)
    time = np.unique(np.concatenate([[0.0, 1.0], np.random.default_rng(seed).uniform(0, 1, 300)]))
    polynomial = np.polynomial.Polynomial(coefficients)
    block = StartSpec(signal="angle", derivative=derivative, half_width=0.25, degree=degree)
    found = start_value(Trace(time, {"angle": polynomial(time)}), start, block)
    assert found == pytest.approx(float(polynomial.deriv(derivative)(start)), abs=1e-6)


def test_a_factor_makes_start_values_of_readings() -> None:
    counts = Trace(EVEN, {"encoder": 651.9 * np.cos(3 * EVEN)})
    speed = StartSpec("encoder", derivative=1, half_width=0.035)
    radians = replace(speed, conversion=Conversion(1 / 651.9))
    found = start_value(counts, 5.0, radians)
    assert found == pytest.approx(start_value(counts, 5.0, speed) / 651.9, rel=1e-12)
    assert found == pytest.approx(-3 * math.sin(15), abs=0.02)


def test_only_samples_within_the_half_width_count() -> None:
    far = np.abs(EVEN - 5) > 0.018
    trace = Trace(EVEN, {"angle": np.where(far, 1e6, EVEN**2)})
    speed = StartSpec(signal="angle", derivative=1)
    assert start_value(trace, 5.0, speed) == pytest.approx(10.0, abs=1e-6)


def test_too_few_samples_around_a_start_are_refused_with_the_way_out() -> None:
    trace = Trace(EVEN[::10], {"angle": EVEN[::10]}, name="run")
    with pytest.raises(TraceError, match=r"run\.angle: has 1 samples within 0\.018 s of t = 5 s; widen `half_width`"):
        start_value(trace, 5.0, StartSpec(signal="angle"))


def test_outputs_count_alike_in_windows_that_are_judged_whatever_their_units() -> None:
    """Estimated initial states would otherwise follow the output with the largest numbers alone."""
    asked = plain_study(
        windows={"length": 2},
        outputs={"hand.angle": {"signal": "angle", "factor": 1e-3}, "hand.speed": {"signal": "speed", "factor": 57.3}},
    )
    weighed = evenly_weighed(cut_windows(asked.run, [recorded(EVEN, speed=np.sin(3 * EVEN))], asked.windows))
    assert len(weighed) == 5
    scaled = np.concatenate([window.weight * window.measured for window in weighed])
    np.testing.assert_allclose(scaled.std(axis=0), [1, 1], rtol=1e-12)


def test_an_output_that_rests_in_all_windows_keeps_weight_1() -> None:
    asked = plain_study(windows={"length": 1, "most": 1})
    trace = recorded(EVEN, angle=np.maximum(EVEN - 5, 0))
    (window,) = evenly_weighed(cut_windows(asked.run, [trace], asked.windows))
    assert window.weight.tolist() == [1.0]


PORTS = {
    "motor.voltage": Port("voltage", 0, "Real", "input", "V"),
    "hand.angle": Port("angle", 1, "Real", "output", "rad"),
    "hand.speed": Port("speed", 2, "Real", "output", "rad/s"),
    "hand.angle_start": Port("angle_start", 3, "Real", "parameter", "rad"),
    "hand.speed_start": Port("speed_start", 4, "Real", "parameter", "rad/s"),
}


def in_own_units(units: dict[str, str], **changes: Any) -> FreeRunWindow:
    """The first window of a recording with these units, whose numbers are those of `recorded`."""
    given = recorded(EVEN, speed=-3 * np.sin(3 * EVEN))
    asked = plain_study(windows={"length": 3, "skip": 1}, **changes)
    trace = replace(given, trace=replace(given.trace, units=units))
    return cut_windows(asked.run, [trace], asked.windows, PORTS)[0]


def test_each_signal_is_converted_to_the_unit_of_what_it_drives_is_compared_with_or_starts() -> None:
    initial = {
        "hand.angle_start": {"signal": "angle"},
        "hand.speed_start": {"signal": "angle", "derivative": 1},
    }
    outputs = {"hand.angle": {"signal": "angle"}, "hand.speed": {"signal": "speed"}}
    plain = in_own_units({}, initial=initial, outputs=outputs)
    found = in_own_units({"voltage": "mV", "angle": "°", "speed": "1/min"}, initial=initial, outputs=outputs)
    factors = np.array([math.pi / 180, 2 * math.pi / 60])
    np.testing.assert_allclose(found.measured, factors * plain.measured, rtol=1e-12)
    np.testing.assert_allclose(found.stimuli["motor.voltage"], 1e-3 * plain.stimuli["motor.voltage"], rtol=1e-12)
    for name, value in plain.initial.items():
        assert found.initial[name] == pytest.approx(factors[0] * value, rel=1e-12), name
    assert "initial.hand.speed_start from angle: °/s to rad/s, times 0.0174533" in map(str, found.crossings)
    assert not noted(plain.crossings)


def test_a_factor_of_the_study_stands_over_units_and_other_quantities_are_refused_with_the_recording() -> None:
    outputs = {"hand.angle": {"signal": "angle", "factor": 2, "offset": 1}}
    np.testing.assert_allclose(
        in_own_units({"angle": "V"}, outputs=outputs).measured,
        2 * in_own_units({}, outputs={"hand.angle": {"signal": "angle"}}).measured + 1,
    )
    problem = r"outputs\.hand\.angle from angle of data/run\.csv: A does not fit rad"
    with pytest.raises(WiringError, match=problem):
        in_own_units({"angle": "A"}, outputs={"hand.angle": {"signal": "angle"}})


STRETCH = st.tuples(st.integers(-50, 1050), st.integers(1, 300)).map(lambda at: (at[0] * 0.01, (at[0] + at[1]) * 0.01))


@given(marked=st.lists(STRETCH, max_size=6), length=st.integers(20, 300), skip=st.integers(0, 100))
def test_no_window_meets_a_mark_and_no_room_for_one_is_lost(
    marked: list[tuple[float, float]], length: int, skip: int
) -> None:
    trace = replace(recorded(EVEN), marks=tuple(Mark("gap", *stretch, ("voltage",)) for stretch in marked))
    seconds, slack = length * 0.01, 1e-6
    try:
        found = [(cut.start, cut.start + seconds) for cut in cuts(trace, length=f"{length}/100", skip=f"{skip}/100")]
    except TraceError as error:
        assert "no window" in error.problem
        found = []
    for begin, end in found:
        assert all(end <= start + slack or begin >= stop - slack for start, stop in marked)
    taken = union(np.array([*marked, *found, (-1.0, skip * 0.01), (10.0, 11.0)]))
    assert np.all(taken[1:, 0] - taken[:-1, 1] < seconds + 0.01)


@pytest.mark.parametrize("signal", ["voltage", "angle"])
@pytest.mark.parametrize(("delay", "reading"), [(0.0, 0.0), (0.25, 0.035)])
def test_marks_reach_as_far_as_delays_and_readings_do(signal: str, delay: float, reading: float) -> None:
    initial = {"hand.angle_start": {"signal": "angle", "half_width": reading}} if reading else {}
    asked = plain_study(windows={"length": 1}, initial=initial)
    late = {name: replace(spec, delay=KnownDelay(delay)) for name, spec in asked.run.inputs.items()}
    trace = replace(recorded(EVEN), marks=(Mark("gap", 3.5, 4.2, (signal,)),))
    begins = [round(cut.start, 6) for cut in cut_windows(replace(asked.run, inputs=late), [trace], asked.windows)]
    begin, end = {"voltage": (3.5 + delay, 4.2 + delay), "angle": (3.5, 4.2 + reading)}[signal]
    after = min(start for start in begins if start > 3)
    assert (
        [start for start in begins if start < 3] == [0, 1, 2] and 3 not in begins and end - 1e-6 <= after < end + 0.011
    )
    assert begin < 4


def test_marks_of_other_signals_do_not_matter_and_samples_that_are_left_out_may_hold_anything() -> None:
    marks = Mark("gap", 2, 3, ("humidity",)), Mark("excluded", 4.9, 5.1)
    trace = replace(recorded(EVEN, angle=spoilt(np.nan)), marks=marks)
    assert [round(cut.start, 6) for cut in cuts(trace, length=2)] == [0, 2, 5.1, 7.1]


def test_a_trace_without_a_window_left_is_passed_over_unless_it_is_the_only_one() -> None:
    asked = plain_study(windows={"length": 2})
    spoilt_trace = replace(recorded(EVEN), marks=(Mark("late", 1, 9),))
    assert len(cut_windows(asked.run, [spoilt_trace, recorded(EVEN)], asked.windows)) == 5
    with pytest.raises(TraceError, match=r"no window of 2 s is left beside late stamps from 1 to 9 s; .*traces\.keep"):
        cut_windows(asked.run, [spoilt_trace], asked.windows)
    with pytest.raises(TraceError, match=r"no window of 2 s is left beside excluded from -1 to 11 s"):
        cut_windows(asked.run, [replace(recorded(EVEN), marks=(Mark("excluded", -1, 11),))], asked.windows)
