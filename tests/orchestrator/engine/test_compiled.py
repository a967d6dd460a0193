"""The compiled loop is the Python loop, to the last bit: over random systems, at every failure, at every interrupt."""

from __future__ import annotations

import gc
import logging
import os
import shutil
import signal
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from fmus.errors import FmuError, WiringError
from fmus.packaging import targets
from orchestrator.engine import (
    CycleSettings,
    Engine,
    Interrupted,
    Order,
    Result,
    Run,
    RunFailed,
    Simulation,
    Timing,
    compiled,
)
from orchestrator.engine.recording import Columns, Recorder
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.interface import Port, Value
from orchestrator.fmi.slave import Slave
from orchestrator.rational import clock
from orchestrator.system import Part, System, wire
from orchestrator.trace import FloatArray, Trace
from tests.support import moody, third_party
from tests.support.scripted import Clock, Gain, simulation

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work

BOTH = (Engine.PYTHON, Engine.COMPILED)
STEP = Fraction(1, 5)  # [s], a multiple of the fixed steps of all FMUs below
MODELS = ("Feedthrough", "Dahlquist", "VanDerPol", "Stair", "BouncingBall")

needs_loop = pytest.mark.skipif(not compiled.available(), reason="the compiled loop was not built")


def test_the_loop_is_built_where_there_is_a_compiler() -> None:
    assert compiled.available() or shutil.which("cc") is None


Shelf = Mapping[str, FmuFile]


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shelf]:
    """Reference FMUs of both versions as "Stair2", "Stair3", ..., and two Python FMUs."""
    folder = tmp_path_factory.mktemp("fmus")
    paths = {f"{model}{version}": third_party.reference(version, model) for model in MODELS for version in (2, 3)}
    for name in ("pendulum", "daq"):
        paths[name] = targets.build(name, folder / f"{name}.fmu", target="python")
    paths["moody"] = moody.build(folder)
    with ExitStack() as stack:
        yield {name: stack.enter_context(FmuFile(path)) for name, path in paths.items()}


@dataclass(frozen=True)
class Case:
    """A system and a run of it; components are c0, c1, ...

    Attributes:
        scale: target -> factor and offset of its connection.
    """

    kinds: tuple[str, ...]
    links: tuple[tuple[str, str], ...] = ()
    scale: Mapping[str, tuple[float, float]] | None = None
    every: tuple[int, ...] = ()
    order: Order = Order.GAUSS_SEIDEL
    stimuli: Mapping[str, FloatArray] | None = None
    values: Mapping[str, Value] | None = None
    steps: int = 20
    step: Fraction = STEP
    start: Fraction = Fraction(0)
    record_every: int = 1

    def system(self, shelf: Shelf) -> System:
        every = self.every or (1,) * len(self.kinds)
        parts = {
            f"c{i}": Part(shelf[kind].interface, each * self.step)
            for i, (kind, each) in enumerate(zip(self.kinds, every, strict=True))
        }
        wired = wire(parts, self.links, self.stimuli or {})
        scale = self.scale or {}
        links = tuple(
            replace(link, factor=scale[str(link.target)][0], offset=scale[str(link.target)][1])
            if str(link.target) in scale
            else link
            for link in wired.connections
        )
        return replace(wired, connections=links)

    def simulation(self, shelf: Shelf, engine: Engine) -> Simulation:
        timing = Timing(self.start + self.steps * self.step, self.step, self.start, self.order, engine=engine)
        slaves = {f"c{i}": Slave(shelf[kind], f"c{i}") for i, kind in enumerate(self.kinds)}
        return Simulation(self.system(shelf), slaves, timing)

    def run(self, shelf: Shelf, engine: Engine, **more: Any) -> Result:
        with self.simulation(shelf, engine) as made:
            inputs = [target for _, target in self.links] + list(self.stimuli or {})
            record = [*inputs[::2], *made.outputs, *inputs[1::2]]
            return made.run(self.values, self.stimuli, record, record_every=self.record_every, **more)

    def outcome(self, shelf: Shelf, engine: Engine) -> Any:
        """All that can be seen of a run: bits of every sample, calls and warnings; or the error."""
        try:
            result = self.run(shelf, engine)
        except RunFailed as error:
            return str(error), bits(error.result.trace), error.result.account.reached
        except FmuError as error:
            return str(error)
        calls = {name: each.calls for name, each in result.statistics.items()}
        return result.ended, bits(result.trace), calls, dict(result.warnings)


def bits(trace: Trace) -> dict[str, bytes]:
    return {"time": trace.time.tobytes(), **{name: trace[name].tobytes() for name in trace.names}}


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
    order = draw(st.sampled_from(Order))
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
    with Simulation(system, {"c0": slave}, Timing(Fraction(1), Fraction(1, 10), engine=engine)) as made:
        initialise = made._initialise

        def turn_bad(*details: Any) -> None:
            initialise(*details)
            slave.set({stage: status})

        made._initialise = turn_bad  # type: ignore[method-assign]
        try:
            return bits(made.run(stimuli=stimuli).trace), slave.warnings, None
        except FmuError as error:
            fatal = status == 4
            if fatal:
                made._initialise = initialise  # type: ignore[method-assign]
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
    ("kind", "value"),
    [
        ("Int8", 128.0),
        ("Int8", -129.0),
        ("UInt8", -0.6),
        ("UInt16", 65535.5),
        ("Int64", 2.0**63),
        ("UInt64", 2.0**64),
        ("Int32", -1e300),
    ],
)
def test_a_value_that_does_not_fit_is_refused_at_its_tick_in_both_loops(shelf: Shelf, kind: str, value: float) -> None:
    stimulus = np.where(np.arange(21) == 13, value, 1.0)
    case = Case(("Feedthrough3",), stimuli={f"c0.{kind}_input": stimulus})
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


@pytest.mark.parametrize("engine", [Engine.PYTHON, pytest.param(Engine.COMPILED, marks=needs_loop)])
@pytest.mark.parametrize("every", [1, 2, 7, 100])
def test_every_nth_row_is_every_nth_row_of_the_whole_record(shelf: Shelf, engine: Engine, every: int) -> None:
    case = Case(("VanDerPol2", "Feedthrough2"), (("c0.x0", "c1.Float64_continuous_input"),), every=(1, 3), steps=50)
    whole = case.run(shelf, engine).trace
    part = replace(case, record_every=every).run(shelf, engine).trace
    assert part.time.tolist() == whole.time[::every].tolist()
    assert all(np.array_equal(part[name], whole[name][::every]) for name in whole.names)


@pytest.mark.parametrize("engine", [Engine.PYTHON, pytest.param(Engine.COMPILED, marks=needs_loop)])
def test_what_is_recorded_does_not_change_what_is_simulated(shelf: Shelf, engine: Engine) -> None:
    links = (("c0.x0", "c1.Float64_continuous_input"), ("c1.Float64_continuous_output", "c2.torque"))
    with Case(("VanDerPol2", "Feedthrough2", "pendulum"), links).simulation(shelf, engine) as made:
        whole = made.run().trace
        for chosen in (["c2.angle"], ["c1.Int32_output", "c2.speed"], ["c2.torque"], [], ["c0.x1"]):
            trace = made.run(record=chosen).trace
            assert trace.names == tuple(chosen)
            assert all(np.array_equal(trace[name], whole[name]) for name in chosen if name in whole.names)


def test_a_record_of_every_zeroth_row_is_refused(shelf: Shelf) -> None:
    with pytest.raises(WiringError, match="record_every: is 0; give 1 or more"):
        Case(("Stair2",), record_every=0).run(shelf, Engine.AUTO)


def joined(pieces: Sequence[Trace]) -> dict[str, bytes]:
    names = pieces[0].names
    columns = {name: np.concatenate([piece[name] for piece in pieces]) for name in names}
    return bits(Trace(np.concatenate([piece.time for piece in pieces]), columns))


@pytest.mark.parametrize("engine", [Engine.PYTHON, pytest.param(Engine.COMPILED, marks=needs_loop)])
@pytest.mark.parametrize("steps", [1, 4095, 4096, 9000])
def test_the_pieces_a_sink_is_given_are_the_record(shelf: Shelf, engine: Engine, steps: int) -> None:
    case = Case(("Dahlquist2",), steps=steps, step=Fraction(1, 1000))
    pieces: list[Trace] = []
    result = case.run(shelf, engine, sink=pieces.append)
    assert len(result.trace) == 0
    assert joined(pieces) == bits(case.run(shelf, engine).trace)


@pytest.mark.parametrize("count", [1, 8, 20_000, 20_479])
def test_columns_of_a_record_do_not_push_each_other_out_of_the_cache(count: int) -> None:
    recorder = Recorder(Columns(["a", "b"], ["b", "a"], {}), clock(Fraction(0), STEP), 1, count, None)
    assert recorder.rows.strides[1] // 64 % 2 == 1
    assert recorder.rows.strides[1] % 64 == 0


def test_a_record_is_kept_where_it_was_written() -> None:
    recorder = Recorder(Columns(["a", "b"], ["b", "a"], {}), clock(Fraction(0), STEP), 1, 3, None)
    for number in range(3):
        recorder.row(number)[:] = [number, 10 + number]
    recorder.empty(3)
    trace = recorder.trace()
    assert trace.names == ("b", "a")
    assert trace["a"].tolist() == [0, 1, 2]
    assert np.shares_memory(trace["b"], recorder.rows)


@needs_loop
def test_memory_of_a_run_into_a_sink_does_not_depend_on_its_length(shelf: Shelf) -> None:
    def peak(steps: int) -> int:
        tracemalloc.start()
        Case(("Feedthrough2",), steps=steps, step=Fraction(1, 1000)).run(
            shelf, Engine.COMPILED, sink=lambda piece: None
        )
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    assert peak(100_000) < peak(10_000) + 100_000  # the record has 4 MB


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


def resources() -> tuple[int, int]:
    """Resident memory [B] and number of shared libraries of this process."""
    gc.collect()
    maps = Path("/proc/self/maps").read_text().splitlines()
    libraries = {line.split()[-1] for line in maps if ".so" in line}
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE"), len(libraries)


def leaves(cycle: Callable[[], object], count: int) -> str:
    """What so many cycles leave behind each time, four times one after the other; nothing where one time did not.

    What leaks does so each time; allocators that fill their pools or take a new one do not.
    """
    grown = ""
    before = resources()
    for _ in range(4):
        for _ in range(count):
            cycle()
        after = resources()
        memory, libraries = after[0] - before[0], after[1] - before[1]
        if memory < 500 * count and not libraries:
            return ""
        grown, before = f"{memory} bytes and {libraries} libraries more", after
    return grown


linux_only = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")


@linux_only
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["Feedthrough2", "Feedthrough3"])
def test_a_thousand_instances_leave_nothing_behind(shelf: Shelf, kind: str) -> None:
    file = shelf[kind]
    system = wire({"c0": Part(file.interface)}, [])
    timing = Timing(100 * STEP, STEP)

    def cycle() -> None:
        with Simulation(system, {"c0": Slave(file, "c0")}, timing) as made:
            made.run()

    assert leaves(cycle, 1000) == ""


@linux_only
def test_a_thousand_runs_of_one_simulation_leave_nothing_behind(shelf: Shelf) -> None:
    with Case(("Feedthrough2", "VanDerPol3"), steps=10).simulation(shelf, Engine.AUTO) as made:
        assert leaves(made.run, 1000) == ""


def test_many_runs_are_the_runs_one_by_one(shelf: Shelf) -> None:
    case = Case(("VanDerPol2", "Feedthrough2"), stimuli={"c1.Float64_continuous_input": np.zeros(21)})
    waves = [np.random.default_rng(seed).normal(size=21) for seed in range(4)]
    runs = [
        Run({"c0.mu": float(n)}, {"c1.Float64_continuous_input": wave}, ["c0.x1", "c1.Float64_continuous_output"])
        for n, wave in enumerate(waves)
    ]
    seen: list[float] = []
    with case.simulation(shelf, Engine.AUTO) as made:
        results = made.run_many(runs, seen.append)
    assert seen == [0.25, 0.5, 0.75, 1.0]
    for run, result in zip(runs, results, strict=True):
        with case.simulation(shelf, Engine.AUTO) as alone:
            assert bits(result.trace) == bits(alone.run(run.values, run.stimuli, run.record).trace)


def test_the_error_of_one_of_many_runs_says_which() -> None:
    made = simulation([Clock("clock")])
    with pytest.raises(WiringError, match=r"^run 1: clock\.nothing: no variable"):
        made.run_many([Run(), Run({"clock.nothing": 1.0})])


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
    made = simulation([Clock("clock")])
    made.timing = replace(made.timing, engine=Engine.COMPILED)
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
