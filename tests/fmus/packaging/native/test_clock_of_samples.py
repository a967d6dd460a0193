"""Sampled models declare in FMI 3.0 the clock of their samples; they sample alike whether anybody ticks it or not."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from fmus import library
from fmus.modelling.model import Delay, parameter
from fmus.packaging import targets
from orchestrator import open_system
from orchestrator.engine import Engine, Timing
from orchestrator.fmi.file import FmuFile
from orchestrator.trace import FloatArray, Trace
from tests.support.simulation.both_loops import bits, needs_loop

SAMPLED = ("daq", "pd", "disturbance_observer")
STEPS = (Fraction(1, 500), Fraction(1, 1000), Fraction(1, 90))
Build = Callable[[str, int], Path]


def run(fmu: Path, step: Fraction, engine: Engine = Engine.PYTHON) -> Trace:
    with FmuFile(fmu) as file:
        inputs = [f"c.{port.name}" for port in file.interface.of("input") if port.numeric]
    with (
        open_system({"c": fmu}, (), inputs) as system,
        system.simulation(Timing(50 * step, step, engine=engine)) as simulation,
    ):
        time = simulation.instants()
        return simulation.run({}, {name: np.sin(700 * time + place) for place, name in enumerate(inputs)}).trace


def clocks(fmu: Path) -> list[tuple[str, str]]:
    with FmuFile(fmu) as file:
        return [(clock.causality, str(clock.kind)) for clock in file.interface.clocks.values()]


@pytest.mark.slow
def test_who_samples_has_a_clock_and_nobody_else(native_fmu: Build) -> None:
    for name in library.names():
        fmu = native_fmu(name, 3)
        assert validate_fmu(str(fmu)) == [], name
        assert clocks(fmu) == ([("input", "fixed")] if library.find(name).sampled else []), name


@pytest.mark.slow
def test_where_an_input_acts_late_there_is_no_clock(tmp_path: Path) -> None:
    model = library.find("daq")
    more = (
        parameter("late", "s", 0.01, "How much later the signal acts", minimum=0),
        parameter("before", "1", 0.0, "What the signal was before the start"),
        parameter("shape", "1", 0, "Held or a line"),
    )
    delayed = replace(model, variables=(*model.variables, *more), delays=(Delay("signal", "late", "before", "shape"),))
    assert clocks(targets.build(delayed, tmp_path / "late.fmu", target="native", fmi=3)) == []


@pytest.mark.slow
@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("name", SAMPLED)
def test_ticked_it_samples_as_without_a_clock(name: str, step: Fraction, native_fmu: Build) -> None:
    alone, ticked = (run(native_fmu(name, fmi), step) for fmi in (2, 3))
    assert bits(alone) == bits(ticked)


@needs_loop
@pytest.mark.parametrize("name", SAMPLED)
def test_both_loops_tick_it_alike(name: str, native_fmu: Build) -> None:
    one, other = (run(native_fmu(name, 3), STEPS[0], engine) for engine in (Engine.PYTHON, Engine.COMPILED))
    assert bits(one) == bits(other)


@pytest.mark.parametrize("events", [False, True])
def test_it_samples_where_event_mode_is_used_and_nobody_ticks(events: bool, native_fmu: Build) -> None:
    step, count = 0.002, 100
    driven = np.zeros(count, dtype=[("time", float), ("signal", float)])
    driven["time"] = step * np.arange(count)
    driven["signal"] = np.sin(70 * driven["time"])

    def theirs(fmi: int, events: bool) -> FloatArray:
        fmu, length = str(native_fmu("daq", fmi)), {"step_size": step, "output_interval": step, "stop_time": 0.15}
        found = fmpy.simulate_fmu(fmu, input=driven, use_event_mode=events, early_return_allowed=events, **length)
        return np.asarray(found["measured"])

    assert np.ptp(theirs(2, False)) > 0
    assert np.array_equal(theirs(3, events), theirs(2, False))


def test_its_interval_is_the_sample_time_that_is_set(native_fmu: Build) -> None:
    timing = Timing(Fraction(1, 10), Fraction(1, 100))
    with (
        open_system({"c": native_fmu("daq", 3)}, (), ["c.signal"]) as system,
        system.simulation(timing) as simulation,
    ):
        values = {"c.signal": np.arange(float(len(simulation.instants())))}
        found = simulation.run({"c.sample_time": 0.03}, values).trace["c.measured"]
    assert len(set(found.tolist())) == 4  # what came at 0, 0.03, 0.06 and 0.09 s; the first is 0 as the start


def test_a_tick_at_another_time_than_that_of_a_sample_is_an_error(native_fmu: Build, tmp_path: Path) -> None:
    unpacked = fmpy.extract(str(native_fmu("daq", 3)), str(tmp_path / "unpacked"))
    description = fmpy.read_model_description(unpacked)
    fmu = FMU3Slave(
        guid=description.instantiationToken,
        unzipDirectory=unpacked,
        modelIdentifier=description.coSimulation.modelIdentifier,
    )
    fmu.instantiate(eventModeUsed=True)
    fmu.enterInitializationMode(startTime=0.0)
    clock = [one.valueReference for one in description.modelVariables if one.type == "Clock"]
    listed, found, kind = (ctypes.c_uint * 1)(*clock), (ctypes.c_double * 1)(9.0), (ctypes.c_int * 1)()
    fmu.fmi3GetIntervalDecimal(fmu.component, listed, 1, found, kind)
    assert found[0] == 0.001
    fmu.fmi3GetShiftDecimal(fmu.component, listed, 1, found)
    assert found[0] == 0.0
    fmu.exitInitializationMode()
    fmu.updateDiscreteStates()
    fmu.enterStepMode()
    fmu.doStep(0.0, 0.0015)
    fmu.enterEventMode()
    fmu.setClock(clock, [True])
    with pytest.raises(Exception, match="fmi3UpdateDiscreteStates"):
        fmu.updateDiscreteStates()
    fmu.freeInstance()
