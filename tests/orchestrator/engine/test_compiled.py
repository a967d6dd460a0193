"""The compiled loop is the Python loop, to the last bit: over random systems, at every failure, at every interrupt."""

from __future__ import annotations

import logging
import os
import shutil
import signal
import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from fmus.errors import FmuError, WiringError
from orchestrator.assembly.wiring import wire
from orchestrator.engine import (
    CycleSettings,
    Engine,
    Interrupted,
    Order,
    Simulation,
    Timing,
    compiled,
)
from orchestrator.engine.initialisation import initialise
from orchestrator.fmi.interface import Port, Value
from orchestrator.fmi.slave import Slave
from orchestrator.system import Part
from orchestrator.trace import FloatArray
from tests.support.simulation.both_loops import BOTH, MODELS, STEP, Case, Shelf, bits, needs_loop
from tests.support.simulation.scripted import Clock, Gain, simulation

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work


def test_the_loop_is_built_where_there_is_a_compiler() -> None:
    assert compiled.available() or shutil.which("cc") is None


def agree(case: Case, shelf: Shelf) -> Any:
    """The outcome, once it is seen to be the same in both loops."""
    first, second = (case.outcome(shelf, engine) for engine in BOTH)
    assert first == second
    return first


PYTHON_KINDS = ("pendulum", "daq")


KINDS = tuple(f"{model}{version}" for model in MODELS for version in (2, 3))


FLOATS = st.floats(-1e3, 1e3) | st.sampled_from([0.0, -0.0, 0.5, -1.5, 2.5, 1e300, -1e-310, 1 / 3])


REAL = ("Real", "Float64", "Float32")


@st.composite
def cases(draw: st.DrawFn, interfaces: Mapping[str, Any]) -> Case:
    """Any system of one to five FMUs: chains in any direction under Gauss-Seidel, circles too under Jacobi."""
    kinds = tuple(draw(st.lists(st.sampled_from(KINDS) | st.sampled_from(PYTHON_KINDS), min_size=1, max_size=5)))
    order = draw(st.sampled_from((Order.GAUSS_SEIDEL, Order.JACOBI)))
    steps = draw(st.sampled_from([1, 7, 20, 60]))
    rank = draw(st.permutations(range(len(kinds))))
    outputs = [(i, port) for i, kind in enumerate(kinds) for port in interfaces[kind].of("output") if port.numeric]
    links, stimuli, scale = [], {}, {}
    for i, kind in enumerate(kinds):
        for port in interfaces[kind].of("input"):
            target = f"c{i}.{port.name}"
            sources = [
                f"c{j}.{other.name}"
                for j, other in outputs
                if (other.type not in REAL or port.type in REAL)
                and port.numeric
                and (order is Order.JACOBI or rank[j] < rank[i])
            ]
            choice = draw(st.sampled_from(["free", "link", "link", "scaled", "stimulus"]))
            if choice in ("link", "scaled") and sources:
                links.append((draw(st.sampled_from(sources)), target))
                if choice == "scaled":
                    scale[target] = draw(st.tuples(FLOATS, FLOATS))
            elif choice == "stimulus" and port.numeric:
                stimuli[target] = samples(draw, port, steps + 1)
    every = tuple(draw(st.sampled_from([1, 1, 2, 3])) for _ in kinds)
    start = draw(st.sampled_from([Fraction(0), Fraction(1, 3), Fraction(-7, 5)]))
    record_every = draw(st.sampled_from([1, 1, 3]))
    values: dict[str, Value] = {}
    return Case(kinds, tuple(links), scale, every, order, stimuli, values, steps, STEP, start, record_every)


def samples(draw: st.DrawFn, port: Port, count: int) -> FloatArray:
    """Values of a stimulus; now and then one that a short integer cannot hold."""
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    if port.type in REAL:
        return random.normal(size=count) * 10.0 ** draw(st.integers(-3, 3))
    if port.type == "Enumeration":
        return random.integers(1, 3, count).astype(float)
    return random.uniform(-0.4, draw(st.sampled_from([1.0, 100.0, 100.0, 140.0])), count)


@needs_loop
@settings(max_examples=60, deadline=None)
@given(st.data())
def test_both_loops_are_equal_to_the_last_bit(shelf: Shelf, data: st.DataObject) -> None:
    case = data.draw(cases({kind: file.interface for kind, file in shelf.items()}))
    try:
        case.system(shelf)
    except WiringError:
        reject()
    agree(case, shelf)


@needs_loop
def test_every_type_travels_through_the_compiled_loop(shelf: Shelf) -> None:
    ports = shelf["Feedthrough3"].interface
    kinds = (
        "Int8",
        "UInt8",
        "Int16",
        "UInt16",
        "Int32",
        "UInt32",
        "Int64",
        "UInt64",
        "Boolean",
        "Float32_continuous",
        "Float64_continuous",
    )
    assert all(f"{kind}_input" in ports.ports for kind in kinds)
    wave = 63.0 * np.abs(np.sin(np.arange(31)))
    case = Case(("Feedthrough3",), stimuli={f"c0.{kind}_input": wave for kind in kinds}, steps=30)
    agree(case, shelf)
    trace = case.run(shelf, Engine.COMPILED).trace
    for kind in kinds:
        expected = {"B": wave != 0, "I": np.rint(wave), "U": np.rint(wave)}.get(kind[0], wave)
        expected = expected.astype(np.float32) if kind.startswith("Float32") else expected
        assert np.array_equal(trace[f"c0.{kind}_output"][1:], expected[:-1])


def outcome_of_turning_bad(shelf: Shelf, engine: Engine, stage: str, status: int) -> Any:
    """What comes of a run whose FMU returns this status from a function as soon as the steps begin."""
    slave = Slave(shelf["moody"], "c0")
    system = wire({"c0": Part(shelf["moody"].interface)}, [], ["c0.input"])
    stimuli = {"c0.input": np.arange(11.0)}

    def turn_bad(*details: Any) -> None:
        initialise(*details)
        slave.set({stage: status})

    with Simulation(system, {"c0": slave}, Timing(Fraction(1), Fraction(1, 10), engine=engine)) as made:
        try:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr("orchestrator.engine.simulation.initialise", turn_bad)
                return bits(made.run(stimuli=stimuli).trace), slave.warnings, None
        except FmuError as error:
            fatal = status == 4
            if fatal:
                assert len(made.run(stimuli=stimuli).trace) == 11
            return str(error), slave.warnings, fatal


@needs_loop
@pytest.mark.parametrize("stage", ["step", "get", "set"])
@pytest.mark.parametrize("status", [1, 2, 3, 4, 5, -1])
def test_a_status_means_the_same_in_both_loops(shelf: Shelf, stage: str, status: int) -> None:
    first, second = (outcome_of_turning_bad(shelf, engine, stage, status) for engine in BOTH)
    assert first == second
    if status == 1:
        assert first[1] == 10
    else:
        assert first[0].startswith("c0: ")
        assert {"step": "step from t = 0 s", "get": "get outputs", "set": "set inputs"}[stage] in first[0]


@needs_loop
@pytest.mark.parametrize("kind", ["moody", "Stair2", "Stair3"])
def test_an_fmu_that_asks_to_stop_does_so_at_the_same_step_in_both_loops(shelf: Shelf, kind: str) -> None:
    case = Case((kind,), steps=70)
    ended, *_ = agree(case, shelf)
    reached = {"moody": 5.0}.get(kind, 9.0)
    assert ended == f"c0: asked to stop at t = {reached:g} s"
    assert case.run(shelf, Engine.COMPILED).trace.time[-1] == pytest.approx(reached)


@needs_loop
@pytest.mark.parametrize(
    ("model", "kind", "value"),
    [
        ("Feedthrough3", "Int8", 128.0),
        ("Feedthrough3", "Int8", -129.0),
        ("Feedthrough3", "UInt8", -0.6),
        ("Feedthrough3", "UInt16", 65535.5),
        ("Feedthrough3", "Int64", 2.0**63),
        ("Feedthrough3", "UInt64", 2.0**64),
        ("Feedthrough3", "Int32", -1e300),
        ("Feedthrough2", "Int32", 2.0**31),
    ],
)
def test_a_value_that_does_not_fit_is_refused_at_its_tick_in_both_loops(
    shelf: Shelf, model: str, kind: str, value: float
) -> None:
    stimulus = np.where(np.arange(21) == 13, value, 1.0)
    case = Case((model,), stimuli={f"c0.{kind}_input": stimulus})
    assert "does not fit" in agree(case, shelf)[0]
    assert isinstance(agree(replace(case, steps=12), shelf), tuple)


@needs_loop
def test_messages_of_an_fmu_arrive_while_the_compiled_loop_runs(shelf: Shelf, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "servotwin.fmu"):
        result = Case(("moody",), values={"c0.step": 1}, step=Fraction(1, 10)).run(shelf, Engine.COMPILED)
    assert result.warnings == {"c0": 20}
    said = [record.message for record in caplog.records if "step said 1" in record.message]
    assert len(said) == 4 and said[3].endswith("(... 17 more like this)")


@needs_loop
def test_statistics_of_the_compiled_loop_count_calls_and_measure_time(shelf: Shelf) -> None:
    case = Case(("pendulum", "Dahlquist2"), every=(1, 2), steps=2000)
    begun = time.perf_counter()
    statistics = case.run(shelf, Engine.COMPILED).statistics
    elapsed = time.perf_counter() - begun
    assert {name: each.calls for name, each in statistics.items()} == {"c0": 2000, "c1": 1000}
    assert all(each.seconds > 0 for each in statistics.values())
    assert sum(each.seconds for each in statistics.values()) < elapsed


def interrupt_after(seconds: float, sent: list[float]) -> threading.Timer:
    def send() -> None:
        sent.append(time.process_time())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(seconds, send)
    timer.start()
    return timer


@pytest.mark.parametrize("engine", [Engine.PYTHON, pytest.param(Engine.COMPILED, marks=needs_loop)])
@pytest.mark.parametrize("kinds", [("Feedthrough2", "Feedthrough2"), ("Dahlquist3", "VanDerPol2")])
def test_an_interrupt_ends_the_run_at_once_with_all_up_to_there(
    shelf: Shelf, engine: Engine, kinds: tuple[str, ...]
) -> None:
    case = Case(kinds, step=Fraction(1), steps=50_000_000, record_every=10)
    sent: list[float] = []
    with pytest.raises(Interrupted) as interrupted:
        timer = interrupt_after(0.3, sent)
        case.run(shelf, engine)
    took = time.process_time() - sent[0]
    timer.join()
    trace = interrupted.value.result.trace
    assert took < 2  # seconds of processor time, whatever else the machine does
    assert len(trace) > 100
    calls = interrupted.value.result.statistics["c0"].calls
    assert 10 * (len(trace) - 1) < calls <= 10 * len(trace) + 1
    again = replace(case, steps=10 * (len(trace) - 1)).run(shelf, engine).trace
    assert bits(again) == bits(trace)


@needs_loop
def test_what_the_compiled_loop_does_not_know_is_stepped_in_python_and_said_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    compiled._say.cache_clear()
    with caplog.at_level(logging.INFO, "servotwin.engine"):
        for _ in range(2):
            simulation([Clock("clock"), Gain("gain", 1.0)]).run()
    assert [record.message for record in caplog.records] == [
        "stepping in Python, not in the compiled loop: clock is no co-simulation FMU in this process"
    ]


@needs_loop
def test_the_compiled_loop_can_be_demanded(shelf: Shelf) -> None:
    made = simulation([Clock("clock")], engine=Engine.COMPILED)
    with pytest.raises(WiringError, match="engine: cannot be the compiled one: clock is no co-simulation FMU"):
        made.run()


def test_without_the_extension_python_steps_and_a_warning_says_so(
    shelf: Shelf, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    case = Case(("VanDerPol2",))
    expected = case.run(shelf, Engine.AUTO).trace
    compiled._say.cache_clear()
    monkeypatch.setattr(compiled, "_compiled", None)
    with caplog.at_level(logging.WARNING, "servotwin.engine"):
        assert bits(case.run(shelf, Engine.AUTO).trace) == bits(expected)
        case.run(shelf, Engine.AUTO)
    assert len(caplog.records) == 1
    assert "not built" in caplog.records[0].message


@needs_loop
def test_a_circle_that_is_iterated_is_stepped_in_python(shelf: Shelf) -> None:
    parts = {name: Part(shelf["Feedthrough2"].interface) for name in ("c0", "c1")}
    links = [
        ("c0.Float64_continuous_output", "c1.Float64_continuous_input"),
        ("c1.Float64_continuous_output", "c0.Float64_continuous_input"),
    ]
    timing = Timing(Fraction(1), Fraction(1, 10), cycles=CycleSettings(iterate=True), engine=Engine.COMPILED)
    slaves = {name: Slave(shelf["Feedthrough2"], name) for name in parts}
    with (
        Simulation(wire(parts, links), slaves, timing) as made,
        pytest.raises(WiringError, match="cycle of direct feed-through"),
    ):
        made.run()
