"""Circles without a delay: they are iterated until they settle at the solution, or refused."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import FmuError
from orchestrator.engine import CycleSettings
from tests.support.simulation.scripted import Clock, Gain, Sampler, simulation

RAMP = np.arange(11.0)
ITERATE = CycleSettings(iterate=True, tolerance=1e-13, limit=200)
SEEDS = st.integers(0, 2**32 - 1)


def circle(a: float, b: float, cycles: CycleSettings = ITERATE, **more: Any) -> Any:
    """y_one = a y_two + 1, y_two = b y_one + 2, without delay."""
    parts = [Gain("one", a, 1.0), Gain("two", b, 2.0)]
    return simulation(parts, ["one.y0 -> two.u0", "two.y0 -> one.u0"], cycles=cycles, **more)


@given(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9))
def test_an_iterated_circle_is_the_algebraic_solution(a: float, b: float) -> None:
    trace = circle(a, b).run().trace
    assert trace["one.y0"] == pytest.approx((1 + 2 * a) / (1 - a * b), rel=1e-10)
    assert trace["two.y0"] == pytest.approx((2 + b) / (1 - a * b), rel=1e-10)


@given(SEEDS, st.integers(2, 5))
def test_any_contracting_network_of_gains_settles_at_its_solution(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    W, offsets = random.normal(size=(count, count)), random.normal(size=count)
    W *= 0.8 / np.linalg.norm(W, np.inf)
    parts = [Gain(f"g{i}", W[[i]], offsets[i]) for i in range(count)]
    links = [f"g{j}.y0 -> g{i}.u{j}" for i in range(count) for j in range(count)]
    trace = simulation(parts, links, stop=Fraction(1, 10), cycles=ITERATE).run().trace
    solution = np.linalg.solve(np.eye(count) - W, offsets)
    assert [trace[f"g{i}.y0"][-1] for i in range(count)] == pytest.approx(solution, rel=1e-9, abs=1e-9)


def test_circles_through_several_outputs_of_one_component_settle_together_at_every_step() -> None:
    K, back = np.array([[0.5, 0.2], [0.1, -0.3]]), [0.5, -0.4]
    both = Gain("both", np.column_stack((K, [1.0, 2.0])), 1.0)
    links = [link for i in range(2) for link in (f"both.y{i} -> back{i}.u0", f"back{i}.y0 -> both.u{i}")]
    parts = [both, *(Gain(f"back{i}", gain) for i, gain in enumerate(back))]
    trace = simulation(parts, links, cycles=ITERATE, stimulated=["both.u2"]).run(stimuli={"both.u2": RAMP}).trace
    driven = np.column_stack((1 + RAMP, 1 + 2 * RAMP))[:-1]
    expected = np.linalg.solve(np.eye(2) - K * back, driven.T)
    assert [trace[f"both.y{i}"][1:] for i in range(2)] == pytest.approx(expected, rel=1e-10)


def test_when_a_circle_counts_as_settled_does_not_depend_on_what_is_recorded() -> None:
    """An output that nobody reads settles last: it is near 0, where tolerances are absolute."""
    drive = 1000 + 100 * RAMP
    stimuli = {"one.u1": drive, "one.u2": 0.5 * (0.9 * (drive + 1) / 0.55 + 2)}

    def ran(record: list[str] | None) -> Any:
        parts = [Gain("one", [[0.5, 1.0, 0.0], [0.5, 0.0, -1.0]]), Gain("two", 0.9, 2.0)]
        links, cycles = ["one.y0 -> two.u0", "two.y0 -> one.u0"], CycleSettings(iterate=True, tolerance=1e-3)
        return simulation(parts, links, cycles=cycles, stimulated=stimuli).run(stimuli=stimuli, record=record)

    some, everything = ran(["two.y0"]), ran(None)
    assert some.iterations == everything.iterations
    assert np.array_equal(some.trace["two.y0"], everything.trace["two.y0"])


def test_states_in_a_circle_advance_once_a_step_however_often_it_is_iterated() -> None:
    F, G, H, K, gain, z = 0.5, 1.0, 1.0, 0.4, -0.5, 1.0
    parts = [Sampler("sampler", [[F]], [[G]], [[H]], [[K]], [z]), Gain("gain", gain)]
    made = simulation(parts, ["sampler.y0 -> gain.u0", "gain.y0 -> sampler.u0"], cycles=ITERATE)
    result = made.run()
    expected = []
    for _ in range(10):
        y = H * z / (1 - K * gain)
        expected.append(y)
        z = F * z + G * gain * y
    assert result.trace["sampler.y0"][1:] == pytest.approx(expected, rel=1e-10)
    assert result.iterations > 10
    assert result.statistics["sampler"].calls == result.iterations + 10


def test_every_snapshot_of_an_iteration_is_freed() -> None:
    made = circle(0.5, 0.5)
    made.run()
    logs = [component.log for component in made.components.values()]
    assert all(log.count("save") == log.count("drop") == 10 for log in logs)


def test_snapshots_are_freed_when_a_step_fails() -> None:
    made = circle(0.5, 0.5)
    made.components["two"].fail_at = 7
    with pytest.raises(FmuError, match="two: step"):
        made.run()
    logs = [component.log for component in made.components.values()]
    assert all(log.count("save") == log.count("drop") >= 1 for log in logs)


@pytest.mark.parametrize("gain", [-2.0, 1.5, 1e200])
def test_a_circle_that_does_not_settle_is_an_error_with_components_and_time(gain: float) -> None:
    parts = [Gain("one", [[gain, 1.0]]), Gain("two", 1.0)]
    made = simulation(parts, ["one.y0 -> two.u0", "two.y0 -> one.u0"], cycles=ITERATE, stimulated=["one.u1"])
    kick = np.where(np.arange(11) == 3, 1.0, 0.0)
    with pytest.raises(FmuError) as failed:
        made.run(stimuli={"one.u1": kick})
    assert str(failed.value) == (
        "one, two: the cycle did not settle in 200 iterations at t = 0.3 s; shorten the step, or relax its tolerance"
    )


def test_initial_values_that_do_not_settle_are_an_error_with_components() -> None:
    with pytest.raises(FmuError, match=r"^one, two: the initial values run in a circle and do not settle"):
        circle(-2.0, 1.0).run()


def test_a_component_that_feeds_itself_is_iterated() -> None:
    made = simulation([Gain("gain", 0.5, 3.0)], ["gain.y0 -> gain.u0"], cycles=ITERATE)
    assert made.run().trace["gain.y0"] == pytest.approx(6.0, rel=1e-10)


def test_a_circle_of_two_rates_holds_the_slow_value_between_its_steps() -> None:
    parts = [Gain("slow", 0.5, 1.0), Gain("fast", [[0.5, 1.0]]), Clock("clock")]
    made = simulation(
        parts,
        ["slow.y0 -> fast.u0", "fast.y0 -> slow.u0", "clock.y -> fast.u1"],
        step=Fraction(1),
        stop=Fraction(4),
        steps={"slow": Fraction(2)},
        cycles=ITERATE,
    )
    trace = made.run(record=["slow.y0", "fast.y0"]).trace
    slow = [(1 + 0.5 * t) / 0.75 for t in (0, 0, 0, 2, 2)]  # left limits: computed at t = 0 and 2
    fast = [0.5 * s + t for s, t in zip(slow, (0, 0, 1, 2, 3), strict=True)]
    assert trace["slow.y0"] == pytest.approx(slow, rel=1e-9)
    assert trace["fast.y0"] == pytest.approx(fast, rel=1e-9)
