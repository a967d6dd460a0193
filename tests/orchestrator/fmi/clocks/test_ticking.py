"""FMUs are ticked when they are to be, in co-simulation and model exchange, alone, connected and isolated.

The FMU refuses clocks and inputs out of event mode, inputs of a clock that does not tick, and calls out of order.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest

from fmus.errors import FmuError, WiringError
from orchestrator import open_system
from orchestrator.engine import Timing
from orchestrator.fmi.isolation import Isolation
from orchestrator.scenario.run import run_scenario
from orchestrator.trace import Trace
from tests.support.fmus import clocks as fmus
from tests.support.fmus.clocks import CO_SIMULATION, MODEL_EXCHANGE

KINDS = pytest.mark.parametrize("interfaces", [CO_SIMULATION, MODEL_EXCHANGE], ids=["co-simulation", "exchange"])
Build = Callable[..., Path]
CHAIN = ["a.out -> b.trigger", "a.sampled -> b.w"]


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    folder = tmp_path_factory.mktemp("clocks")
    return lambda *clocks, **more: fmus.build(folder, clocks, name=f"f{len(list(folder.glob('*.fmu')))}", **more)


def run(
    parts: dict[str, Path], wires: Sequence[str] = (), step: float | str = 0.25, stop: float = 1.0, **more: Any
) -> Trace:
    stimuli = more.pop("stimuli", {})
    with open_system(parts, wires, stimuli) as system:
        return system.run(stop, step, more.pop("values", {}), stimuli, **more).trace


def ramp(rate: float = 1.0) -> Trace:
    time = np.arange(0, 1.01, 0.25)
    return Trace(time, {"u": rate * time})


@KINDS
def test_a_constant_clock_ticks_within_steps_and_at_their_beginning(build: Build, interfaces: str) -> None:
    found = run({"a": build("tick", interfaces=interfaces)})
    assert found["a.n_tick"].tolist() == [0, 3, 5, 8, 10]  # 0 to 0.2; to 0.4; to 0.7 (0.5 begins a step); to 0.9
    assert found["a.last_time"].tolist() == [0.0, 0.2, 0.4, 0.7, 0.9]


@KINDS
@pytest.mark.parametrize("step", ["0.1", "0.05", "0.25", "1", "1/3"])
def test_the_step_does_not_change_how_often_a_clock_ticks(build: Build, interfaces: str, step: str) -> None:
    found = run({"a": build("tick", "changing", "fixed", interfaces=interfaces)}, step=step, stop=3)
    stop = float(found.time[-1])
    assert found["a.n_tick"][-1] == np.ceil(round(stop / 0.1, 6))
    assert found["a.n_fixed"][-1] == np.ceil(round(stop / 0.2, 6))
    changing = np.cumsum([0.0, *(0.1 * 2.0 ** np.arange(8))])
    assert found["a.n_changing"][-1] == np.count_nonzero(changing < stop - 1e-9)


@KINDS
def test_a_clock_samples_the_input_of_its_time(build: Build, interfaces: str) -> None:
    found = run({"a": build("tick", interfaces=interfaces)}, stimuli={"a.u": ramp()})
    assert found["a.sampled"].tolist() == [0.0, 0.0, 0.25, 0.5, 0.75]  # an input is held over a step


@KINDS
def test_a_tunable_clock_takes_the_interval_of_the_fmu(build: Build, interfaces: str) -> None:
    found = run({"a": build("tune", interfaces=interfaces)}, values={"a.period": 0.3})
    assert found["a.n_tune"].tolist() == [0, 1, 2, 3, 4]


@KINDS
@pytest.mark.parametrize("clock", ["fixed", "tune"])
def test_a_clock_whose_interval_is_not_declared_has_the_shift_that_the_fmu_tells(
    build: Build, interfaces: str, clock: str
) -> None:
    fmu = build(clock, interfaces=interfaces)
    found = run({"a": fmu}, values={"a.period": 0.3, "a.shift": 0.26})
    assert found[f"a.n_{clock}"].tolist() == [0, 0, 1, 2, 3]  # at 0.26, 0.56 and 0.86 s
    with pytest.raises(FmuError, match=f"gives its .* clock '{clock}' the shift -1 s"):
        run({"a": fmu}, values={"a.shift": -1.0})


@KINDS
def test_an_fmu_that_refuses_to_tell_shifts_is_told_of(
    build: Build, interfaces: str, caplog: pytest.LogCaptureFixture
) -> None:
    found = run({"a": build("fixed", interfaces=interfaces)}, values={"a.period": 0.3, "a.shift": -2.0})
    assert found["a.n_fixed"].tolist() == [0, 1, 2, 3, 4]
    assert [record.getMessage() for record in caplog.records if "Shift" in record.getMessage()] == [
        "a: fmi3GetShiftDecimal returned error, so the shift of its clocks 'fixed' is taken as 0 s"
    ]


@KINDS
def test_a_connected_clock_ticks_with_the_values_of_its_tick(build: Build, interfaces: str) -> None:
    parts = {
        "a": build("tick", "out", interfaces=interfaces),
        "b": build("trigger", "countdown", interfaces=interfaces),
    }
    found = run(parts, ["a.out -> b.trigger", "a.last_time -> b.w"])
    assert found["b.n_trigger"].tolist() == [0, 1, 1, 2, 3]  # at 0.2, 0.5 and 0.8
    assert found["b.heard"].tolist() == [0.0, 0.2, 0.2, 0.5, 0.8]
    assert found["b.n_countdown"].tolist() == [0, 0, 1, 1, 2]  # at 0.45, 0.75 and, beyond the end, 1.05


def test_co_simulation_and_exchange_tick_each_other(build: Build) -> None:
    parts = {
        "a": build("tick", "out", interfaces=MODEL_EXCHANGE),
        "b": build("trigger", "relay", interfaces=CO_SIMULATION),
        "c": build("trigger", interfaces=MODEL_EXCHANGE),
    }
    found = run(parts, ["b.relay -> c.trigger", "a.out -> b.trigger", "a.last_time -> b.w", "b.last_time -> c.w"])
    assert found["c.n_trigger"].tolist() == found["b.n_trigger"].tolist() == [0, 1, 1, 2, 3]
    assert found["c.heard"].tolist() == [0.0, 0.2, 0.2, 0.5, 0.8]


def test_slower_components_tick_faster_ones_in_time(build: Build, tmp_path: Path) -> None:
    parts = {"a": build("tick", "out"), "b": build("trigger")}
    document: dict[str, Any] = {
        "title": "ticks",
        "components": {"a": {"fmu": str(parts["a"]), "step": 0.5}, "b": {"fmu": str(parts["b"]), "step": 0.1}},
        "connections": ["a.out -> b.trigger", "a.last_time -> b.w"],
        "run": {"stop": 1, "step": 0.1},
    }
    (tmp_path / "s.yaml").write_text(json.dumps(document))
    result = run_scenario(tmp_path / "s.yaml").cases[0].result
    assert result is not None
    assert result.trace["b.n_trigger"].tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3]
    document["components"]["a"]["step"], document["components"]["b"]["step"] = 0.1, 0.5
    (tmp_path / "s.yaml").write_text(json.dumps(document))
    with pytest.raises(WiringError, match=r"a\.out -> b\.trigger: b steps by 0\.5 s, ahead of a, .*give b a `step`"):
        run_scenario(tmp_path / "s.yaml")


def test_a_step_ends_early_at_an_event_of_the_fmu_and_goes_on(build: Build) -> None:
    parts = {"a": build("tick", "alarm"), "b": build("trigger")}
    found = run(parts, ["a.alarm -> b.trigger", "a.gauge -> b.w"], values={"a.alarm_at": 0.625})
    assert found["b.n_trigger"].tolist() == [0, 0, 0, 1, 1]
    assert found["b.heard"].tolist() == [0, 0, 0, 0.625, 0.625]
    assert found["a.gauge"].tolist() == found.time.tolist()


@KINDS
def test_a_clock_that_ticks_in_the_initialisation_ticks_others_in_the_first_step(build: Build, interfaces: str) -> None:
    parts = {"a": build("tick", "alarm", interfaces=interfaces), "b": build("trigger", interfaces=interfaces)}
    found = run(parts, ["a.alarm -> b.trigger", "a.sampled -> b.w"], values={"a.alarm_at": 0.0})
    assert found["b.n_trigger"].tolist() == [0, 1, 1, 1, 1]


def test_early_returns_are_those_that_fmpy_sees(build: Build) -> None:
    path = build("tick", "alarm")
    found = run({"a": path}, values={"a.alarm_at": 0.625, "a.event_at": 0.3})
    theirs = fmpy.simulate_fmu(
        str(path),
        stop_time=1.0,
        output_interval=0.25,
        start_values={"alarm_at": 0.625, "event_at": 0.3},
        output=["gauge", "seen", "n_alarm"],
        use_event_mode=True,
        early_return_allowed=True,
    )
    assert found["a.gauge"][-1] == theirs["gauge"][-1] == 1.0
    assert 0.625 in theirs["time"]


@KINDS
def test_an_event_that_the_fmu_foretells_is_met(build: Build, interfaces: str) -> None:
    found = run({"a": build("trigger", interfaces=interfaces)}, values={"a.event_at": 0.3})
    assert found["a.seen"].tolist() == [0, 0, 0.3, 0.3, 0.3]


def test_isolated_components_tick_each_other(build: Build) -> None:
    parts = {"a": build("tick", "out"), "b": build("trigger", "countdown")}
    with open_system(parts, CHAIN) as system:
        timing = Timing(Fraction(1), Fraction(1, 4))
        with system.simulation(timing) as here, system.simulation(timing, Isolation()) as apart:
            assert here.run().trace == apart.run().trace
            assert here.run().trace == apart.run().trace  # after a reset, too


@pytest.mark.parametrize(
    ("wires", "problem"),
    [
        (["a.out -> b.tick"], "the constant clock 'tick' ticks by itself; remove the connection"),
        (["2 * a.out -> b.trigger"], "gives a clock a factor or an offset; remove it"),
        (["a.sampled -> b.trigger"], "a Clock cannot be connected; connect a clock to a clock"),
        (["a.out -> a.trigger"], "has a component tick itself"),
        (["a.out -> b.trigger", "a.relay -> b.trigger"], "has two sources, a.out and a.relay"),
        (["a.out -> b.trigger", "b.out -> a.trigger"], "is on a circle: b acts on a"),
        (["a.trigger -> b.trigger"], "is an input; only an output can be a source"),
    ],
    ids=["timed", "factor", "value", "itself", "two", "circle", "input"],
)
def test_connections_of_clocks_that_cannot_be_are_refused(build: Build, wires: list[str], problem: str) -> None:
    path = build("tick", "trigger", "out", "relay")
    with pytest.raises(WiringError, match=problem):
        run({"a": path, "b": path}, wires)


def test_clocks_without_event_mode_are_refused_where_they_are_connected(build: Build) -> None:
    plain = build("tick", "trigger", "out", interfaces=CO_SIMULATION.replace(' hasEventMode="true"', ""))
    with pytest.raises(WiringError, match=r"'a\.out' is a clock of an FMU without event mode.*hasEventMode"):
        run({"a": plain, "b": plain}, ["a.out -> b.trigger"])


def test_ticks_a_step_late_are_refused(build: Build, tmp_path: Path) -> None:
    document = {
        "title": "late",
        "components": {"a": {"fmu": str(build("tick", "out"))}, "b": {"fmu": str(build("trigger"))}},
        "connections": ["a.out -> b.trigger"],
        "run": {"stop": 1, "step": 0.1, "order": "jacobi"},
    }
    (tmp_path / "late.yaml").write_text(json.dumps(document))
    with pytest.raises(WiringError, match=r"a\.out -> b\.trigger: would tick a step late.*remove `order`"):
        run_scenario(tmp_path / "late.yaml")


@KINDS
@pytest.mark.parametrize(("clock", "values"), [("tune", {"a.period": 0.0}), ("changing", {"a.growth": -0.1})])
def test_an_interval_that_cannot_be_ends_the_run(
    build: Build, interfaces: str, clock: str, values: dict[str, float]
) -> None:
    with pytest.raises(FmuError, match=f"a: .*gives its .* clock '{clock}' the interval"):
        run({"a": build(clock, interfaces=interfaces)}, values=values)


def test_a_run_can_be_repeated(build: Build) -> None:
    parts = {"a": build("tick", "out", "changing"), "b": build("trigger", "countdown")}
    with open_system(parts, CHAIN) as system:
        assert system.run(1, 0.25).trace == system.run(1, 0.25).trace


def test_a_circle_that_is_iterated_takes_its_clocks_back(build: Build, tmp_path: Path) -> None:
    path = str(build("tick", "changing"))
    document: dict[str, Any] = {
        "title": "circle",
        "components": {"a": {"fmu": path}, "b": {"fmu": path}},
        "connections": ["a.sampled -> b.u", "0.5 * b.sampled + 1 -> a.u"],
        "run": {"stop": 1, "step": 0.25, "cycles": {}},
    }
    (tmp_path / "circle.yaml").write_text(json.dumps(document))
    result = run_scenario(tmp_path / "circle.yaml").cases[0].result
    assert result is not None and result.iterations > 10
    assert result.trace["a.n_tick"].tolist() == result.trace["b.n_tick"].tolist() == [0, 3, 5, 8, 10]
    assert result.trace["a.sampled"][-1] == pytest.approx(2.0)  # a = 0.5 b + 1, b = a
