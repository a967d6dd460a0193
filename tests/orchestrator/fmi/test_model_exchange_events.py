"""Model exchange: every event at its time, every failure named, and the way back to a saved state or the start."""

from __future__ import annotations

import ctypes
import re
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from fmus.errors import FmuError, WiringError
from orchestrator.engine import CycleSettings
from orchestrator.fmi.exchange_slave import ExchangeSlave
from orchestrator.fmi.file import FmuFile
from orchestrator.solvers.base import SolverMethod, SolverSettings
from orchestrator.trace import FloatArray
from tests.support.fmus import eventful
from tests.support.simulation.exchanging import (
    METHODS,
    Shelf,
    matrices,
    only,
    same,
    simulation,
    trace,
    with_xml,
)
from tests.support.simulation.scripted import Gain, Scripted, zero_order_hold


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("step", [Fraction(1, 5), Fraction(3, 10), Fraction(2)])
def test_time_events_are_met_and_rows_are_left_limits(version: int, step: Fraction, shelf: Shelf) -> None:
    found = trace(shelf(f"Stair{version}"), step=step, stop=Fraction(6))
    exact = [max(1, -(-step.numerator * k // step.denominator)) for k in range(len(found))]
    assert found["fmu.counter"].tolist() == exact


@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_that_asks_to_stop_ends_the_run(version: int, shelf: Shelf) -> None:
    with simulation({"fmu": shelf(f"Stair{version}")}, stop=Fraction(12)) as made:
        found = made.run()
    assert found.ended == "fmu: asked to stop at t = 9 s" and found.trace.time[-1] == 9.0


@pytest.mark.parametrize("every", [1, 2, 3])
def test_a_controller_that_samples_by_time_events_has_no_hidden_delay(every: int, shelf: Shelf) -> None:
    """Its time events, counted in floating point, fall on communication points only up to rounding."""
    links = [("plant.x1", "controller.u"), ("controller.sample", "plant.force")]
    with simulation({"plant": shelf("masses2"), "controller": shelf("controller")}, links) as made:
        found = made.run({"controller.gain": -0.5, "controller.period": every * 0.1}).trace
    Ad, Bd = zero_order_hold(*matrices(), 0.1)
    x, u = np.array([1.0, 0, 0, 0]), 0.0
    for k in range(20):
        u = -0.5 * x[0] if k % every == 0 else u
        x = Ad @ x + Bd[:, 0] * u
        assert found["plant.x1"][k + 1] == pytest.approx(x[0], abs=1e-8)


SAW = {"rate": 0.0, "u": 1.0, "level": 0.95, "after": 0.05, "x_start": 0.0}


def saw(time: float) -> float:
    return time if time <= 0.95 else 0.05 + (time - 0.95) % 0.9


@pytest.mark.parametrize("solver", METHODS, ids=lambda each: each.method)
def test_states_jump_where_an_indicator_crosses_zero(solver: SolverSettings, shelf: Shelf) -> None:
    with simulation({"fmu": shelf("eventful")}, solver=solver, stop=Fraction(3)) as made:
        found = made.run({f"fmu.{name}": value for name, value in SAW.items()}).trace
        slave = only(made)
        assert (slave.get("crossings"), slave.get("x")) == (3, pytest.approx(saw(3.0)))
        assert slave.get("events") == 4  # with that at the start
    assert found["fmu.x"] == pytest.approx([saw(time) for time in found.time], abs=1e-9)


@pytest.mark.parametrize("early", [0.0, 1e-11])
def test_an_event_at_a_communication_point_shows_in_the_next_row(early: float, shelf: Shelf) -> None:
    found = trace(shelf("eventful"), {**SAW, "level": 0.95 - early}, step=Fraction(19, 20), stop=Fraction(19, 10))
    assert found["fmu.x"] == pytest.approx([0.0, 0.95, 0.1], abs=1e-9)


def test_time_events_between_communication_points_are_counted_each(shelf: Shelf) -> None:
    """The FMU refuses them when they come early or late."""
    with simulation({"fmu": shelf("eventful")}, stop=Fraction(1)) as made:
        made.run({"fmu.period": 0.03})
        slave = only(made)
        assert slave.get("samples") == 34  # at 0, 0.03, ..., 0.99


def test_without_events_the_solver_is_not_restarted(shelf: Shelf) -> None:
    with simulation({"fmu": shelf("eventful")}, step=Fraction(1, 100), stop=Fraction(1), stimulated=["fmu.u"]) as made:
        made.run(stimuli={"fmu.u": np.ones(101)})
        slave = only(made)
        assert slave.get("events") == 1
        steps = slave.get("steps")
    assert isinstance(steps, int)
    assert steps < 250


def test_a_step_event_changes_nothing_that_it_should_not(shelf: Shelf) -> None:
    with simulation({"fmu": shelf("eventful")}, stop=Fraction(1)) as made:
        found = made.run({"fmu.trouble": eventful.TROUBLES.index("step event")}).trace
        slave = only(made)
        steps, events = slave.get("steps"), slave.get("events")
    assert isinstance(steps, int)
    assert events in (1 + steps // 10, steps // 10)  # the latest may still be due
    assert found["fmu.x"] == pytest.approx(np.exp(-found.time), abs=1e-6)


TROUBLE = {
    "endless": "initialise: the event at t = 0 s does not end in 100 iterations; ask its supplier",
    "chatter": "step from t = 1 s by 0.1 s: 100 events at t = 1.05 s; ask its supplier for hysteresis$",
    "undefined": "step from t = 1 s by 0.1 s: cvode at t = 1",
    "discarded": "step from t = 1 s by 0.1 s: cvode at t = 1",
    "failed": r"get derivatives at t = 1 s: returned error \(no rate for you\)$",
    "fatal": "get derivatives at t = 1 s: returned fatal error$",
}
STOP = {"stop at event": "asked to stop at t = 1.1 s$", "stop at step": r"asked to stop at t = 1\.0\d* s$"}


@pytest.mark.parametrize("trouble", STOP)
def test_a_wish_to_stop_is_no_trouble(trouble: str, shelf: Shelf) -> None:
    values = {"fmu.trouble": eventful.TROUBLES.index(trouble), "fmu.period": 0.55 if "event" in trouble else 0.0}
    with simulation({"fmu": shelf("eventful")}) as made:
        found = made.run(values)
    assert re.match(f"fmu: {STOP[trouble]}", found.ended)
    assert found.trace.time[-1] == pytest.approx(1.1 if "event" in trouble else 1.0)


def test_a_wish_to_stop_at_the_very_start_leaves_the_first_row(shelf: Shelf) -> None:
    values = {"fmu.trouble": eventful.TROUBLES.index("stop at event"), "fmu.x_start": 3}
    with simulation({"fmu": shelf("eventful")}, start=Fraction(2), stop=Fraction(3)) as made:
        for _ in range(2):
            found = made.run(values)
            assert found.ended == "fmu: asked to stop at t = 2 s"
            assert found.trace.time.tolist() == [2.0] and found.trace["fmu.x"].tolist() == [3.0]
        assert made.run({"fmu.x_start": 3}).ended == ""


@pytest.mark.parametrize("trouble", TROUBLE)
def test_trouble_is_named_with_component_and_time(trouble: str, shelf: Shelf) -> None:
    values = {"trouble": eventful.TROUBLES.index(trouble), "period": 0.55 if "event" in trouble else 0}
    if trouble == "chatter":
        values["period"] = 1.05
    with pytest.raises(FmuError, match=f"^fmu: {TROUBLE[trouble]}") as failed:
        trace(shelf("eventful"), values)
    assert failed.value.exit_code == 3


def test_after_a_fatal_error_no_function_of_the_fmu_is_called(shelf: Shelf) -> None:
    with simulation({"fmu": shelf("eventful")}) as made:
        with pytest.raises(FmuError, match="fatal"):
            made.run({"fmu.trouble": eventful.TROUBLES.index("fatal")})
        assert len(made.run().trace)
        library = only(made)._fmi.fmu.dll
    assert ctypes.c_int.in_dll(library, "calls_after_fatal").value == 0


@pytest.mark.parametrize("method", SolverMethod)
def test_derivatives_that_are_not_finite_end_in_an_error_with_each_method(method: SolverMethod, shelf: Shelf) -> None:
    undefined = eventful.TROUBLES.index("undefined")
    with pytest.raises(FmuError, match=rf"{method} at t = 1[\d.]* s: .*, for der\(x\) is nan at t = 1") as failed:
        trace(shelf("eventful"), {"trouble": undefined}, solver=SolverSettings(method))
    assert "relative_tolerance" in failed.value.fix


def test_derivatives_that_are_not_finite_at_the_start_are_named(shelf: Shelf) -> None:
    with pytest.raises(FmuError) as failed:
        trace(shelf("masses2"), stimuli={"fmu.force": np.full(21, 1e308)}, values={"d": 1e308, "k": -1e308})
    assert str(failed.value).startswith(
        "fmu: step from t = 0 s by 0.1 s: cannot go on, for there are no derivatives "
        "at t = 0 s (two_masses: 'der(v1)' is"
    )


def test_an_interrupt_comes_through_the_solver(shelf: Shelf, monkeypatch: pytest.MonkeyPatch) -> None:
    with simulation({"fmu": shelf("eventful")}) as made:
        slave = only(made)
        calls = iter(range(30))
        put = slave._fmi.put

        def interrupted(time: float, states: FloatArray) -> int:
            if next(calls, None) is None:
                raise KeyboardInterrupt
            return put(time, states)

        monkeypatch.setattr(slave._fmi, "put", interrupted)
        with pytest.raises(KeyboardInterrupt):
            made.run()


@pytest.mark.parametrize("name", ["masses2", "masses3", "BouncingBall2", "BouncingBall3"])
def test_a_step_from_a_restored_state_is_bitwise_the_same(name: str, shelf: Shelf) -> None:
    with ExitStack() as stack:
        slave = ExchangeSlave(shelf(name), "fmu")
        stack.callback(slave.close)
        slave.bind([], ["x1", "x2"] if name.startswith("masses") else ["h", "v"])
        slave.begin(0.0, None)
        slave.run()
        slave.step(0.0, 0.3)
        state = slave.save()
        ways = []
        for turn in range(3):
            if turn > 0:
                slave.restore(state)
            slave.step(0.3, 0.3)
            slave.step(0.6, 0.3)
            ways.append(list(slave.read()))
        slave.drop(state)
    assert ways[0] == ways[1] == ways[2]


def test_a_cycle_is_iterated_to_the_implicit_solution(shelf: Shelf) -> None:
    """x' = -x + u with u = K times x at the end of the step; the FMU refuses to go back where it may forget."""
    K, decay = -0.8, np.exp(-0.1)
    links = [("fmu.x", "gain.u0"), ("gain.y0", "fmu.u")]
    cycles = CycleSettings(iterate=True, tolerance=1e-12)
    parts: dict[str, FmuFile | Scripted] = {"fmu": shelf("eventful"), "gain": Gain("gain", K)}
    with simulation(parts, links, cycles=cycles, feed_through="all") as made:
        result = made.run()
    factor = decay / (1 - K * (1 - decay))
    assert result.iterations > 20
    assert result.trace["fmu.x"][1:] / result.trace["fmu.x"][:-1] == pytest.approx(factor, abs=1e-7)


def test_an_fmu_that_cannot_go_back_is_refused_in_a_cycle(shelf: Shelf, tmp_path: Path) -> None:
    path = with_xml(shelf("eventful").path, tmp_path, ('canGetAndSetFMUstate="true"', ""))
    links = [("fmu.x", "gain.u0"), ("gain.y0", "fmu.u")]
    with FmuFile(path) as fmu, pytest.raises(WiringError, match="cannot be iterated: fmu cannot go back"):
        parts: dict[str, FmuFile | Scripted] = {"fmu": fmu, "gain": Gain("gain", 0.5)}
        with simulation(parts, links, cycles=CycleSettings(iterate=True), feed_through="all"):
            pass


RUNS = {
    "masses2": ({"k": 1.0}, {"d": 3.0}),
    "masses3": ({"k": 1.0}, {"d": 3.0}),
    "BouncingBall2": ({"e": 0.8}, {"e": 0.5}),
    "BouncingBall3": ({"e": 0.8}, {"e": 0.5}),
    "eventful": (SAW, {"period": 0.03, "rate": -2.0}),
}


@pytest.mark.parametrize("name", RUNS)
def test_run_a_after_run_b_is_bitwise_run_a(name: str, shelf: Shelf) -> None:
    a, b = ({f"fmu.{key}": value for key, value in values.items()} for values in RUNS[name])
    with simulation({"fmu": shelf(name)}) as made:
        first, other = made.run(a).trace, made.run(b).trace
        assert same(made.run(a).trace, first)
        assert not same(first, other)


def test_a_run_after_a_failed_one_is_as_if_there_had_been_none(shelf: Shelf) -> None:
    with simulation({"fmu": shelf("eventful")}) as made:
        first = made.run({f"fmu.{name}": value for name, value in SAW.items()}).trace
        for trouble in ("failed", "undefined", "chatter", "endless"):
            with pytest.raises(FmuError):
                made.run({"fmu.trouble": eventful.TROUBLES.index(trouble), "fmu.period": 1.05})
        assert same(made.run({f"fmu.{name}": value for name, value in SAW.items()}).trace, first)
