"""The record of a run: which rows and columns it has, where they go, and that it changes nothing."""

from __future__ import annotations

import tracemalloc
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from fmus.errors import WiringError
from orchestrator.engine import (
    Engine,
)
from orchestrator.engine.recording import RecordColumns, Recorder
from orchestrator.rational import clock
from orchestrator.trace import Trace
from tests.support.simulation.both_loops import STEP, Case, Shelf, bits, needs_loop

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work


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
    recorder = Recorder(RecordColumns(["a", "b"], ["b", "a"], {}), clock(Fraction(0), STEP), 1, count, None)
    assert recorder.rows.strides[1] // 64 % 2 == 1
    assert recorder.rows.strides[1] % 64 == 0


def test_a_record_is_kept_where_it_was_written() -> None:
    recorder = Recorder(RecordColumns(["a", "b"], ["b", "a"], {}), clock(Fraction(0), STEP), 1, 3, None)
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
