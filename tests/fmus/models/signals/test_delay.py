"""A delay loses and adds nothing, whatever the steps, and a smooth one is the curve through what it was given."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from fmus import library
from fmus.modelling.instance import Instance, StepError
from fmus.modelling.late import LONGEST
from fmus.modelling.model import Delay, Model, State, input_, output, parameter

FloatArray = NDArray[np.float64]
DELAY = library.find("delay")
HELD, SMOOTH = 1, 2
steps = st.lists(st.sampled_from([0.5e-3, 1e-3, 1.7e-3, 4e-3]), min_size=5, max_size=40)


def late(
    delay: float, durations: list[float], signal: FloatArray, shape: int = HELD, before: float = 0.0
) -> FloatArray:
    """(K,) the output after each step."""
    instance = Instance(DELAY, {"delay": delay, "shape": shape, "before": before})
    found, time = [], 0.0
    for duration, value in zip(durations, signal, strict=True):
        instance.set("signal", value)
        instance.step(time, duration)
        found.append(instance.get("late"))
        time += duration
    return np.array(found)


@given(durations=steps, delay=st.floats(0, 0.02), before=st.floats(-2, 2), seed=st.integers(0, 99))
def test_a_held_signal_comes_as_its_exact_mean_over_each_step(
    durations: list[float], delay: float, before: float, seed: int
) -> None:
    signal = np.random.default_rng(seed).uniform(-3, 3, len(durations))
    edges = np.concatenate([[0.0], np.cumsum(durations)])
    fine = np.linspace(0, 1, 4001)[:-1] + 0.5 / 4000
    expected = []
    for start, stop in pairwise(edges):
        earlier = start + (stop - start) * fine - delay
        held = signal[np.clip(np.searchsorted(edges, earlier, side="right") - 1, 0, len(signal) - 1)]
        expected.append(np.mean(np.where(earlier < 0, signal[0] + before, held)))
    quadrature = 2 * 8 * 3 / 4000  # each of at most eight jumps in a step lies within one of the 4000 parts
    assert late(delay, durations, signal, before=before) == pytest.approx(np.array(expected), abs=quadrature)


@given(durations=steps, delay=st.floats(0, 0.02), seed=st.integers(0, 99))
def test_what_has_come_by_then_does_not_depend_on_the_steps(durations: list[float], delay: float, seed: int) -> None:
    signal = np.random.default_rng(seed).uniform(-3, 3, len(durations))
    halves = [part for duration in durations for part in (duration / 3, 2 * duration / 3)]
    whole = np.cumsum(late(delay, durations, signal) * durations)
    parts = np.cumsum(late(delay, halves, np.repeat(signal, 2)) * halves)[1::2]
    assert parts == pytest.approx(whole, abs=1e-12)


def test_a_smooth_signal_is_the_cubic_with_slopes_by_central_differences() -> None:
    step, delay, rows = 1e-3, 5.3e-3, np.arange(60)
    signal = np.sin(70 * rows * step) + 0.3 * rows**2 * step
    found = late(delay, [step] * len(rows), signal, SMOOTH)
    curve = CubicHermiteSpline(rows * step, signal, np.gradient(signal, rows * step, edge_order=2))
    ends = (rows + 1) * step - delay
    inside = (ends > 0) & (ends < rows[-3] * step)
    assert found[inside] == pytest.approx(curve(ends[inside]), abs=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.4e-3, 1.5e-3, 9e-3])
def test_a_smooth_parabola_comes_exactly_also_where_the_delay_is_shorter_than_the_step(delay: float) -> None:
    durations = [1e-3, 2e-3, 1.5e-3] * 8
    begins = np.concatenate([[0.0], np.cumsum(durations)[:-1]])
    found = late(delay, durations, 2 + 3 * begins - 40 * begins**2, SMOOTH)
    ends = np.cumsum(durations) - delay
    assert found[8:] == pytest.approx((2 + 3 * ends - 40 * ends**2)[8:], abs=1e-12)


def test_what_is_set_shows_as_it_will_act_over_another_step_as_long() -> None:
    instance = Instance(DELAY, {"delay": 0.25e-3})
    for k in range(3):
        instance.set("signal", float(k))
        shown = instance.get("late")
        instance.step(k * 1e-3, 1e-3)
        assert instance.get("late") == pytest.approx(max(k - 0.25, 0.0))
        assert k == 0 or shown == pytest.approx(instance.get("late"))


def test_a_snapshot_holds_what_is_on_its_way() -> None:
    instance = Instance(DELAY, {"delay": 3e-3})

    def go_on() -> list[float]:
        found = []
        for k in range(5, 12):
            instance.set("signal", -1.0)
            instance.step(k * 1e-3, 1e-3)
            found.append(instance.get("late"))
        return found

    for k in range(5):
        instance.set("signal", float(k))
        instance.step(k * 1e-3, 1e-3)
    kept = instance.snapshot()
    first = go_on()
    assert first[:4] == pytest.approx([2.0, 3.0, 4.0, -1.0])
    instance.restore(kept)
    assert go_on() == first


def test_more_steps_within_a_delay_than_are_kept_are_an_error() -> None:
    instance = Instance(DELAY, {"delay": 1.0})
    with pytest.raises(StepError, match="'signal' is later than 1024 steps"):
        for k in range(LONGEST + 3):
            instance.step(k * 1e-4, 1e-4)


def test_the_input_of_a_model_with_dynamics_acts_late_within_its_equations() -> None:
    model = Model(
        name="integrator",
        description="Integral of what comes later",
        variables=(
            input_("rate", "1", "Rate"),
            output("sum", "1", "Integral"),
            parameter("delay", "s", 4.3e-3, "Delay", minimum=0),
            parameter("before", "1", 0.0, "Before"),
            parameter("shape", "1", 1, "Shape"),
        ),
        states=(State("sum"),),
        derivatives=lambda t, x, u, p: {"sum": u.rate},
        solver_step=lambda p: 1.0,
        delays=(Delay("rate", "delay", "before", "shape"),),
    )
    instance = Instance(model)
    for k in range(20):
        instance.set("rate", float(k >= 5))
        instance.step(k * 1e-3, 1e-3)
    assert instance.get("sum") == pytest.approx(0.02 - 0.005 - 4.3e-3, abs=1e-15)


@pytest.mark.parametrize(
    ("delay", "problem"),
    [
        (Delay("nothing", "delay", "before", "shape"), "needs 'nothing' to be an input of type Real"),
        (Delay("signal", "delay", "before", "before"), "needs 'before' to be a parameter of type Integer"),
        (Delay("signal", "before", "before", "shape"), "'before' needs a minimum of 0"),
    ],
)
def test_a_delay_of_what_cannot_have_one_is_refused(delay: Delay, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        Model(DELAY.name, "", DELAY.variables, outputs=DELAY.outputs, delays=(delay,))
