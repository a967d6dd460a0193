"""Native FMUs compute what an instance computes, to the last bit, however they are stepped, saved and restored."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus import library
from fmus.modelling.instance import Instance, StepError
from fmus.modelling.model import Table
from fmus.packaging.native import build as native
from fmus.packaging.native import compiler
from fmus.packaging.python import build as python
from tests.support.fmus.either import opened
from tests.support.fmus.natives import (
    CONTINUOUS,
    NAMES,
    PENDULUM,
    RICH,
    VERSIONS,
    advance,
    cached,
    drive,
    everything,
    value_of,
)
from tests.support.fmus.stepping import grid, stepped

Built = Callable[[str, int], Path]

pytestmark = [
    pytest.mark.slow,  # processes, compilers or minutes of work
    pytest.mark.skipif(not compiler.available(), reason="no C compiler here"),
]


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_random_parameters_inputs_and_steps_give_what_an_instance_gives(
    native_fmu: Built, name: str, fmi: int, data: st.DataObject
) -> None:
    model = library.find(name)
    values = data.draw(st.fixed_dictionaries({v.name: value_of(name, v) for v in model.of("parameter")}))
    inputs = [variable.name for variable in model.of("input")]
    outputs = [variable.name for variable in model.of("output")]
    instance = Instance(model, values)
    with cached(native_fmu(name, fmi)) as fmu:
        try:
            fmu.start(**values)
        except FMICallException:  # parameters that do not fit together
            with pytest.raises((StepError, ArithmeticError, ValueError)):
                instance.step(0.0, 1e-4)
            return
        time = 0.0
        for _ in range(4):
            duration = data.draw(st.floats(1e-4, 0.3))
            for key in inputs:
                value = data.draw(st.floats(-2, 2))
                fmu.set(key, value)
                instance.set(key, value)
            try:
                instance.step(time, duration)
            except (StepError, ArithmeticError, ValueError):
                with pytest.raises(FMICallException):
                    fmu.step(time, duration)
                return
            fmu.step(time, duration)
            time += duration
            expected = [instance.get(key) for key in outputs]
            assert fmu.get(*outputs) == pytest.approx(expected, rel=1e-9, abs=1e-12), (values, time)


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", CONTINUOUS)
def test_model_exchange_with_cvode_gives_the_trajectory_of_the_instance(native_fmu: Built, name: str, fmi: int) -> None:
    outputs = [variable.name for variable in library.find(name).of("output")]
    values = {
        "pendulum": {"angle_start": 1.0},
        "geared_pendulum": {"angle_start": 1.0},
        "linear_axis": {"speed_start": 0.5, "coulomb_friction_positive": 0.3, "friction_speed": 0.05},
        "dc_motor": {"inductance": 0.01, "voltage": 1.0},
        "flexible_arm": {"bending_stiffness": 0.01, "hub_inertia": 0.1, "coulomb_friction": 0.01, "speed_start": 0.6},
        "flexible_link": {"participation_2": 0.0, "participation_3": 0.0, "coulomb_friction": 10.0, "speed_start": 0.6},
    }[name]
    time = grid(1.0, 0.0625)
    result = fmpy.simulate_fmu(
        str(native_fmu(name, fmi)),
        stop_time=1.0,
        output_interval=0.0625,
        start_values=values,
        output=outputs,
        fmi_type="ModelExchange",
        solver="CVode",
        relative_tolerance=1e-10,
        record_events=False,
    )
    found = np.column_stack([result[key] for key in outputs])
    assert found == pytest.approx(stepped(library.find(name), values, outputs, time), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_the_python_fmu_and_the_native_one_are_equal_bit_by_bit(native_fmu: Built, tmp_path: Path, fmi: int) -> None:
    path = python.build(library.find("daq"), tmp_path / "daq.fmu")
    results = []
    for packaged in (path, native_fmu("daq", fmi)):
        with opened(packaged) as fmu:
            fmu.start(**RICH["daq"])
            rows = []
            for k in range(40):
                fmu.set("signal", drive(k * 0.03))
                fmu.step(k * 0.03, 0.03)
                rows += fmu.get("measured")
            results.append(rows)
    assert results[0] == results[1]


@pytest.mark.parametrize("shape", range(1, 10))
@pytest.mark.parametrize("fmi", VERSIONS)
def test_every_signal_of_the_excitation_is_equal_bit_by_bit(tmp_path: Path, shape: int, fmi: int) -> None:
    model = library.find("excitation")
    tables = {"playback": Table("playback", (0.1, 0.35, 0.9), (1.0, -2.5, 1 / 3))}
    path = native.build(model, tmp_path / "e.fmu", {"shape": shape, "seed": -7}, tables, fmi=fmi)
    time = grid(1.2, 0.01)
    expected = stepped(model, {"shape": shape, "seed": -7}, ["signal"], time, tables=tables)
    with opened(path) as fmu:
        fmu.start()
        found = fmu.get("signal")
        for now, after in pairwise(time):
            fmu.step(now, after - now)
            found += fmu.get("signal")
    assert found == expected[:, 0].tolist()


@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_step_of_any_length_and_a_start_at_any_time_are_stepped_as_the_instance_does(
    native_fmu: Built, fmi: int
) -> None:
    values = {"sample_time": 0.013, "filter_order": 1, "cutoff": 3.0}
    instance = Instance(library.find("daq"), values)
    instance.begin(2.5)
    with opened(native_fmu("daq", fmi)) as fmu:
        fmu.start(at=2.5, **values)
        time = 2.5
        for duration in (1e-9, 0.0, 7.0, 0.0131, 1e-3, 300.0):
            for running in (fmu, instance):
                running.set("signal", duration + 1)
                running.step(time, duration)
            time += duration
            assert fmu.get("measured", "filtered") == [instance.get("measured"), instance.get("filtered")]


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize(("time", "duration"), [(0.0, -0.1), (0.0, math.nan), (math.inf, 0.1), (0.0, math.inf)])
def test_a_step_backwards_or_without_end_is_refused_and_the_run_goes_on(
    native_fmu: Built, fmi: int, time: float, duration: float
) -> None:
    with opened(native_fmu("pendulum", fmi)) as fmu:
        fmu.start()
        with pytest.raises(FMICallException):
            fmu.step(time, duration)
        fmu.step(0.0, 0.1)
        assert "cannot step" in fmu.log[-1][2]


@pytest.mark.parametrize("fmi", VERSIONS)
def test_start_values_follow_their_parameter_and_outputs_their_inputs(native_fmu: Built, fmi: int) -> None:
    with opened(native_fmu("pendulum", fmi)) as fmu:
        fmu.set("angle_start", 0.5)
        assert fmu.get("angle") == [0.5]
        fmu.start(speed_start=2.0, inertia=0.01)
        assert fmu.get("angle", "speed", "der(angle)") == [0.5, 2.0, 2.0]
        before = fmu.get("acceleration")[0]
        fmu.set("torque", 1.0)
        assert fmu.get("acceleration")[0] - before == pytest.approx(100.0)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_parameter_cannot_be_set_after_the_initialisation_nor_an_output_ever(native_fmu: Built, fmi: int) -> None:
    with opened(native_fmu("pendulum", fmi)) as fmu:
        with pytest.raises(FMICallException):
            fmu.set("energy", 1.0)
        assert "'energy' is computed" in fmu.log[-1][2]
        fmu.start()
        with pytest.raises(FMICallException):
            fmu.set("inertia", 1.0)
        assert fmu.log[-1] == (3, "logStatusError", "pendulum: 'inertia' is fixed once the initialisation is over")
        assert fmu.get("inertia") == [0.00325]


@pytest.mark.parametrize("fmi", VERSIONS)
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_states_are_refused(native_fmu: Built, fmi: int, data: st.DataObject) -> None:
    with cached(native_fmu("daq", fmi)) as fmu:
        fmu.start()
        good = fmu.serialize(fmu.save())
        at = data.draw(st.integers(0, len(good) - 1))
        noise = data.draw(st.binary(min_size=1, max_size=len(good) - at))
        bad = good[:at] + noise + good[at + len(noise) :]
        for wrong in (bad, good[:at]):
            if wrong != good:
                with pytest.raises(FMICallException):
                    fmu.deserialize(wrong)
        fmu.restore(fmu.deserialize(good))


def test_a_hundred_interleaved_instances_do_not_know_of_each_other(native_fmu: Built) -> None:
    """Each has its own inertia; each must end where it ends alone."""
    path = native_fmu("pendulum", 2)
    values = [{"inertia": 0.001 * (k + 1), "angle_start": 0.01 * k} for k in range(100)]
    contexts = [opened(path) for _ in values]
    fmus = [context.__enter__() for context in contexts]
    for fmu, start in zip(fmus, values, strict=True):
        fmu.start(**start)
    time = grid(0.2, 0.01)
    for now, after in pairwise(time):
        for fmu in fmus:
            fmu.step(now, after - now)
    for fmu, start in zip(fmus, values, strict=True):
        expected = stepped(PENDULUM, start, ["angle", "speed"], time)[-1]
        assert fmu.get("angle", "speed") == expected.tolist()
    for context in contexts:
        context.__exit__(None, None, None)


def test_instances_in_threads_step_as_they_do_alone(native_fmu: Built) -> None:
    """FMPy changes the working directory of all threads while it loads a library: one loads at a time."""
    path, results, loading = native_fmu("daq", 3), {}, threading.Lock()

    def run(number: int) -> None:
        with ExitStack() as stack:
            with loading:
                fmu = stack.enter_context(opened(path))
            fmu.start(noise=0.1, seed=number)
            results[number] = advance(fmu, 0, 300)

    threads = [threading.Thread(target=run, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    together = dict(results)
    for number in range(8):
        run(number)
    assert together == results
    assert len({tuple(result) for result in results.values()}) == 8


@pytest.mark.parametrize("fmi", VERSIONS)
def test_every_function_computes_in_c_what_it_computes_in_python(tmp_path: Path, fmi: int) -> None:
    model, tables = everything(), {"played": Table("played", (0.0, 1.2, 1.9), (0.1, -0.4, 0.6))}
    names = ["x", "y", "z"]
    with opened(native.build(model, tmp_path / "all.fmu", tables=tables, fmi=fmi)) as fmu:
        fmu.start()
        instance = Instance(model, tables=tables)
        for k in range(30):
            for running in (fmu, instance):
                running.set("a", 0.5 + 0.4 * math.sin(k))
                running.set("b", 0.4 * math.cos(3 * k))
                running.step(0.1 * k, 0.1)
            assert fmu.get(*names) == pytest.approx([instance.get(name) for name in names], rel=1e-12, abs=1e-14)
