"""Native FMUs as another tool sees them: valid, complete, equal to the model to the last bit, and robust."""

from __future__ import annotations

import math
import threading
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from either import opened, schema
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lxml import etree
from stepping import grid, stepped

from fmus import library
from fmus.errors import ModelError
from fmus.instance import Instance, StepError
from fmus.model import Model, Requirement, State, Table, Variable, input_, output, parameter
from fmus.packaging import compiler, defaults, interface, native, python

Built = Callable[[str, int], Path]
NAMES = library.names()
CONTINUOUS = [name for name in NAMES if interface.exchangeable(library.find(name))]
VERSIONS = (2, 3)
PENDULUM = library.find("pendulum")
RICH: dict[str, dict[str, float]] = {
    "pendulum": {"angle_start": 1.0, "coulomb_friction_positive": 0.004, "stribeck_friction": 0.002},
    "dc_motor": {"inductance": 0.01, "current_limit": 0.8, "back_emf": 0.2},
    "energy_controller": {"amplitude": 1.2, "sample_time": 0.03},
    "excitation": {"shape": 2, "amplitude": 2.0, "begin": 0.1},
    "daq": {"noise": 0.1, "bits": 8, "range": 2.0, "filter_order": 2, "cutoff": 5.0, "sample_time": 0.02},
}

pytestmark = pytest.mark.skipif(not compiler.available(), reason="no C compiler here")


def drive(t: float) -> float:
    return 0.5 + 0.3 * math.sin(5 * t)


def description(path: Path) -> ET.Element:
    with zipfile.ZipFile(path) as archive:
        return ET.fromstring(archive.read("modelDescription.xml"))


# The archive and its description


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", NAMES)
def test_fmpy_has_no_complaint(native_fmu: Built, name: str, fmi: int) -> None:
    assert validate_fmu(str(native_fmu(name, fmi))) == []


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", NAMES)
def test_description_fits_the_schema_of_the_standard(native_fmu: Built, name: str, fmi: int) -> None:
    with zipfile.ZipFile(native_fmu(name, fmi)) as archive:
        etree.XMLSchema(file=str(schema(fmi))).assertValid(etree.fromstring(archive.read("modelDescription.xml")))


@pytest.mark.parametrize("name", NAMES)
def test_build_description_fits_the_schema_of_the_standard(native_fmu: Built, name: str) -> None:
    with zipfile.ZipFile(native_fmu(name, 3)) as archive:
        document = etree.fromstring(archive.read("sources/buildDescription.xml"))
        listed = {file.get("name") for file in document.iter("SourceFile")}
        units = {n.removeprefix("sources/") for n in archive.namelist() if n.startswith("sources/") and n.endswith(".c")}
    etree.XMLSchema(file=str(schema(3).with_name("fmi3BuildDescription.xsd"))).assertValid(document)
    assert listed == units


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", NAMES)
def test_description_carries_what_the_model_declares(native_fmu: Built, name: str, fmi: int) -> None:
    found = {v.name: v for v in fmpy.read_model_description(str(native_fmu(name, fmi))).modelVariables}
    for variable in library.find(name).variables:
        assert_described(found[variable.name], variable, fmi)


def assert_described(found: Any, variable: Variable, fmi: int) -> None:
    kind = "Enumeration" if variable.choices else variable.type
    assert found.type == (kind if fmi == 2 else {"Real": "Float64", "Integer": "Int32"}.get(kind, kind))
    assert (found.causality, found.description) == (variable.causality, variable.description)
    if variable.type == "Real":
        assert found.unit == (None if variable.unit == "1" else variable.unit)
    for text, limit in ((found.min, variable.minimum), (found.max, variable.maximum), (found.start, variable.start)):
        assert (text is None) == (limit is None), variable.name
        if limit is not None:
            assert float(text) == limit, variable.name


@pytest.mark.parametrize("fmi", VERSIONS)
def test_inputs_are_not_declared_exact_and_angles_are_shown_in_degrees(native_fmu: Built, fmi: int) -> None:
    variables = {v.get("name"): v for v in description(native_fmu("pendulum", fmi)).find("ModelVariables") or ()}
    assert variables["torque"].get("initial") is None
    typed = variables["angle"] if fmi == 3 else variables["angle"][0]
    assert (typed.get("unit"), typed.get("displayUnit")) == ("rad", "deg")


def structure(path: Path) -> dict[str, dict[str, set[str]]]:
    """Section -> unknown -> what it depends on."""
    described = fmpy.read_model_description(str(path))
    sections = {"outputs": described.outputs, "rates": described.derivatives, "initial": described.initialUnknowns}
    return {
        key: {u.variable.name: {d.name for d in u.dependencies} for u in unknowns} for key, unknowns in sections.items()
    }


@pytest.mark.parametrize("fmi", VERSIONS)
def test_dependencies_of_the_pendulum_are_those_of_its_equations(native_fmu: Built, fmi: int) -> None:
    found = structure(native_fmu("pendulum", fmi))
    assert found["outputs"] == {
        "angle": {"angle"}, "speed": {"speed"}, "acceleration": {"angle", "speed", "torque"},
        "energy": {"angle", "speed"},
    }  # fmt: skip
    assert found["rates"] == {"der(angle)": {"speed"}, "der(speed)": {"angle", "speed", "torque"}}
    assert found["initial"]["angle"] == {"angle_start"}
    assert found["initial"]["der(angle)"] == {"speed_start"}
    assert {"torque", "angle_start", "inertia"} <= found["initial"]["acceleration"]
    assert "gravity_torque" not in found["initial"]["speed"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("fmi", VERSIONS)
def test_declared_dependencies_are_the_ones_that_show_in_values(native_fmu: Built, name: str, fmi: int) -> None:
    """Whatever moves an output at the start when it is changed is declared to do so."""
    declared = structure(native_fmu(name, fmi))["initial"]
    with opened(native_fmu(name, fmi)) as fmu:
        fmu.start(**RICH[name])
        before = dict(zip(declared, fmu.get(*declared), strict=True))
        for variable in library.find(name).of("parameter"):
            if variable.type != "Real":
                continue
            fmu.fmu.reset()
            value = RICH[name].get(variable.name, variable.start)
            fmu.start(**(RICH[name] | {variable.name: 1.01 * float(value or 0.0) + 0.01}))
            moved = {key for key in declared if fmu.get(key)[0] != before[key]}
            assert all(variable.name in declared[key] for key in moved), variable.name


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", NAMES)
def test_model_exchange_is_offered_for_continuous_models_only(native_fmu: Built, name: str, fmi: int) -> None:
    described = fmpy.read_model_description(str(native_fmu(name, fmi)))
    assert described.coSimulation is not None
    assert (described.modelExchange is not None) == (name in ("pendulum", "dc_motor"))


def test_equal_inputs_give_equal_bytes_and_other_values_another_token(tmp_path: Path) -> None:
    first, again = (native.build(PENDULUM, tmp_path / name) for name in ("a.fmu", "b.fmu"))
    assert first.read_bytes() == again.read_bytes()
    other = native.build(PENDULUM, tmp_path / "c.fmu", {"inertia": 0.004})
    guids = {description(path).get("guid") for path in (first, other)}
    assert len(guids) == 2


@pytest.mark.parametrize("fmi", VERSIONS)
def test_sources_in_the_fmu_build_it_again_without_a_warning(native_fmu: Built, tmp_path: Path, fmi: int) -> None:
    for name in NAMES:
        with zipfile.ZipFile(native_fmu(name, fmi)) as archive:
            sources = {
                n.removeprefix("sources/"): archive.read(n).decode()
                for n in archive.namelist()
                if n.startswith("sources/") and n.endswith((".c", ".h"))
            }
        strict = ("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Wno-sign-conversion", "-Werror")
        assert compiler.compile_library(sources, name, compiler.host(), strict)


def test_the_page_of_documentation_shows_equations_variables_and_references(native_fmu: Built) -> None:
    with zipfile.ZipFile(native_fmu("pendulum", 3)) as archive:
        text = archive.read("documentation/index.html").decode()
    assert "<math" in text
    assert all(variable.description in text for variable in PENDULUM.variables)
    assert all(reference in text for reference in PENDULUM.references)
    assert "http" not in text.replace("http://www.w3.org/1998/Math/MathML", "")


@pytest.mark.parametrize(
    ("values", "problem"),
    [({"inertai": 1.0}, "no such variable"), ({"inertia": -1.0}, "outside"), ({"inertia": math.nan}, "no Real value")],
)
def test_values_that_do_not_fit_are_refused_before_anything_is_built(
    tmp_path: Path, values: dict[str, float], problem: str
) -> None:
    with pytest.raises(ModelError, match=problem):
        native.build(PENDULUM, tmp_path / "a.fmu", values)
    assert list(tmp_path.iterdir()) == []


def test_another_version_of_fmi_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="FMI 1 is not offered"):
        native.build(PENDULUM, tmp_path / "a.fmu", fmi=1)


# Behaviour


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", NAMES)
def test_fmpy_simulates_what_an_instance_computes(native_fmu: Built, name: str, fmi: int) -> None:
    """Bit by bit, on the grid of the communication points, with every input driven."""
    model = library.find(name)
    outputs = [variable.name for variable in model.of("output")]
    inputs = [variable.name for variable in model.of("input")]
    time = grid(1.0, 0.0625)
    driven = np.array([(t, *[drive(t)] * len(inputs)) for t in time],
                      dtype=[("time", float), *((key, float) for key in inputs)])  # fmt: skip
    result = fmpy.simulate_fmu(
        str(native_fmu(name, fmi)), stop_time=1.0, step_size=0.0625, output_interval=0.0625, start_values=RICH[name],
        input=driven if inputs else None, output=outputs, fmi_type="CoSimulation",
    )  # fmt: skip
    expected = stepped(model, RICH[name], outputs, time, dict.fromkeys(inputs, drive))
    assert np.array_equal(np.column_stack([result[key] for key in outputs])[1:], expected[1:])


def value_of(name: str, variable: Variable) -> st.SearchStrategy[Any]:
    """Values within the bounds, near that of the rich example."""
    start = float(RICH[name].get(variable.name, variable.start or 0))
    low = max(start - 5, -math.inf if variable.minimum is None else max(variable.minimum, 0.02))
    high = max(low, min(start + 5, math.inf if variable.maximum is None else variable.maximum))
    return st.integers(math.ceil(low), math.floor(high)) if variable.type == "Integer" else st.floats(low, high)


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
        fmu.start(**values)
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


KEPT: dict[Path, Any] = {}


class cached:  # noqa: N801 - reads as the function `opened` does
    """One instance an FMU for all examples, reset before each."""

    def __init__(self, path: Path) -> None:
        if path not in KEPT:
            KEPT[path] = opened(path).__enter__()
        self.fmu = KEPT[path]

    def __enter__(self) -> Any:
        self.fmu.fmu.reset()
        return self.fmu

    def __exit__(self, *_: object) -> None:
        pass


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", CONTINUOUS)
def test_model_exchange_with_cvode_gives_the_trajectory_of_the_instance(
    native_fmu: Built, name: str, fmi: int
) -> None:
    outputs = [variable.name for variable in library.find(name).of("output")]
    values = {"pendulum": {"angle_start": 1.0}, "dc_motor": {"inductance": 0.01, "voltage": 1.0}}[name]
    time = grid(1.0, 0.0625)
    result = fmpy.simulate_fmu(str(native_fmu(name, fmi)), stop_time=1.0, output_interval=0.0625, start_values=values,
                               output=outputs, fmi_type="ModelExchange", solver="CVode", relative_tolerance=1e-10,
                               record_events=False)  # fmt: skip
    found = np.column_stack([result[key] for key in outputs])
    assert found == pytest.approx(stepped(library.find(name), values, outputs, time), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_the_python_fmu_and_the_native_one_are_equal_bit_by_bit(native_fmu: Built, tmp_path: Path, fmi: int) -> None:
    path = python.build(library.find("daq"), tmp_path / "daq.fmu")
    results = []
    for each in (path, native_fmu("daq", fmi)):
        with opened(each) as fmu:
            fmu.start(**RICH["daq"])
            rows = []
            for k in range(40):
                fmu.set("signal", drive(k * 0.03))
                fmu.step(k * 0.03, 0.03)
                rows += fmu.get("measured")
            results.append(rows)
    assert results[0] == results[1]


@pytest.mark.parametrize("shape", range(1, 9))
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
        for now, after in zip(time[:-1], time[1:], strict=True):
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
            for each in (fmu, instance):
                each.set("signal", duration + 1)
                each.step(time, duration)
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
        assert fmu.log[-1] == (
            3, "logStatusError", "pendulum: 'inertia' is fixed once the initialisation is over"
        )  # fmt: skip
        assert fmu.get("inertia") == [0.00325]


@pytest.mark.parametrize("fmi", VERSIONS)
def test_reset_brings_the_defaults_and_the_start_back(native_fmu: Built, fmi: int) -> None:
    with opened(native_fmu("pendulum", fmi)) as fmu:
        runs = []
        for values in ({"angle_start": 1.0, "inertia": 0.01}, {}, {"angle_start": 1.0, "inertia": 0.01}, {}):
            fmu.start(**values)
            fmu.set("torque", 0.01)
            fmu.step(0.0, 0.3)
            runs.append(fmu.get("angle", "speed", "inertia"))
            fmu.fmu.reset()
        assert fmu.get("angle", "inertia", "torque") == [0.0, 0.00325, 0.0]
    assert runs[0] == runs[2]
    assert runs[1] == runs[3]
    assert runs[0][0] != runs[1][0]


def advance(fmu: Any, first: int, last: int) -> list[float]:
    for k in range(first, last):
        fmu.set("signal", drive(k * 0.01))
        fmu.step(k * 0.01, 0.01)
    values: list[float] = fmu.get("measured", "signal")
    return values


@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_saved_state_continues_as_if_nothing_had_come_between(native_fmu: Built, fmi: int) -> None:
    with opened(native_fmu("daq", fmi)) as daq:
        daq.start(**RICH["daq"])
        at_save = advance(daq, 0, 10)
        state = daq.save()
        expected = advance(daq, 10, 25)
        daq.restore(state)
        assert daq.get("measured", "signal") == at_save
        assert advance(daq, 10, 25) == expected
        daq.drop(state)
        assert not state.value


@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_serialised_state_continues_in_another_instance(native_fmu: Built, fmi: int) -> None:
    with opened(native_fmu("daq", fmi)) as one, opened(native_fmu("daq", fmi)) as other:
        one.start(**RICH["daq"])
        advance(one, 0, 10)
        data = one.serialize(one.save())
        assert data == one.serialize(one.save())
        other.start()
        other.restore(other.deserialize(data))
        assert advance(other, 10, 25) == advance(one, 10, 25)


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
        for each in (bad, good[:at]):
            if each != good:
                with pytest.raises(FMICallException):
                    fmu.deserialize(each)
        fmu.restore(fmu.deserialize(good))


def test_a_hundred_interleaved_instances_do_not_know_of_each_other(native_fmu: Built) -> None:
    """Each has its own inertia; each must end where it ends alone."""
    path = native_fmu("pendulum", 2)
    values = [{"inertia": 0.001 * (k + 1), "angle_start": 0.01 * k} for k in range(100)]
    contexts = [opened(path) for _ in values]
    fmus = [context.__enter__() for context in contexts]
    for fmu, each in zip(fmus, values, strict=True):
        fmu.start(**each)
    time = grid(0.2, 0.01)
    for now, after in zip(time[:-1], time[1:], strict=True):
        for fmu in fmus:
            fmu.step(now, after - now)
    for fmu, each in zip(fmus, values, strict=True):
        expected = stepped(PENDULUM, each, ["angle", "speed"], time)[-1]
        assert fmu.get("angle", "speed") == expected.tolist()
    for context in contexts:
        context.__exit__(None, None, None)


def test_instances_in_threads_step_as_they_do_alone(native_fmu: Built) -> None:
    path, results = native_fmu("daq", 3), {}

    def run(number: int) -> None:
        with opened(path) as fmu:
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
    assert len({tuple(each) for each in results.values()}) == 8


# Derivatives


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", CONTINUOUS)
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_directional_derivatives_are_the_slopes_of_the_values(
    native_fmu: Built, name: str, fmi: int, data: st.DataObject
) -> None:
    """In initialisation mode: rates and outputs by every input and real parameter, start values included."""
    model = library.find(name)
    knowns = [v for v in model.variables if v.causality != "output" and v.type == "Real"]
    values = {v.name: data.draw(value_of(name, v)) if v.causality == "parameter" else data.draw(st.floats(-1, 1))
              for v in knowns}  # fmt: skip
    unknowns = [v.name for v in model.of("output")] + [f"der({state.name})" for state in model.continuous]
    known = data.draw(st.sampled_from([v.name for v in knowns]))
    step = 1e-6 * max(1.0, abs(values[known]))
    with cached(native_fmu(name, fmi)) as fmu:
        for key, value in values.items():
            fmu.set(key, value)
        fmu.fmu.enterInitializationMode()
        found = fmu.sensitivity(unknowns, known)
        sides = []
        for sign in (1, -1):
            fmu.set(known, values[known] + sign * step)
            sides.append(np.array(fmu.get(*unknowns)))
        slope = (sides[0] - sides[1]) / (2 * step)
        scale = 1 + np.abs(sides[0]) + np.abs(slope)
        assert np.abs(found - slope) / scale == pytest.approx(0, abs=1e-4), known


@pytest.mark.parametrize("fmi", VERSIONS)
def test_derivatives_by_the_states_are_those_of_the_equations(native_fmu: Built, fmi: int) -> None:
    with opened(native_fmu("pendulum", fmi)) as fmu:
        fmu.start(angle_start=0.7, speed_start=3.0, viscous_friction=0.002)
        inertia, weight = 0.00325, 0.04905
        found = fmu.sensitivity(["der(angle)", "der(speed)", "angle", "energy"], "angle")
        assert found == pytest.approx([0, -weight / inertia * math.cos(0.7), 1, weight * math.sin(0.7)])
        found = fmu.sensitivity(["der(angle)", "der(speed)", "angle", "energy"], "speed")
        assert found == pytest.approx([1, -0.002 / inertia, 0, inertia * 3.0])
        assert fmu.sensitivity(["der(speed)", "angle"], "torque") == pytest.approx([1 / inertia, 0])


def test_adjoint_derivatives_are_the_transposed_ones(native_fmu: Built) -> None:
    with opened(native_fmu("pendulum", 3)) as fmu:
        fmu.start(angle_start=0.7, speed_start=3.0)
        unknowns, knowns = ["der(speed)", "energy", "angle"], ["angle", "speed", "torque", "inertia"]
        jacobian = np.array([fmu.sensitivity(unknowns, known) for known in knowns]).T
        seed = [0.3, -2.0, 5.0]
        references = [[fmu.variables[name].valueReference for name in names] for names in (unknowns, knowns)]
        found = fmu.fmu.getAdjointDerivative(*references, seed, len(knowns))
        assert found == pytest.approx(jacobian.T @ seed)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_derivatives_of_a_model_with_every_function_are_its_slopes(tmp_path: Path, fmi: int) -> None:
    path = native.build(everything(), tmp_path / "all.fmu", fmi=fmi)
    unknowns = ["der(x)", "y", "z"]
    with opened(path) as fmu:
        for known, at in (("a", 0.73), ("b", -0.4), ("k", 1.3), ("x_start", 0.6)):
            step = 1e-6
            fmu.fmu.reset()
            fmu.set(known, at)
            fmu.fmu.enterInitializationMode()
            found = np.array(fmu.sensitivity(unknowns, known))
            sides = []
            for sign in (1, -1):
                fmu.set(known, at + sign * step)
                sides.append(np.array(fmu.get(*unknowns)))
            assert found == pytest.approx((sides[0] - sides[1]) / (2 * step), rel=1e-5, abs=1e-7), known


def everything() -> Model:
    """A model that calls each function of ops, nested choices in conditions too."""
    from fmus import ops

    def derivatives(t: Any, x: Any, u: Any, p: Any) -> dict[str, Any]:
        side = ops.where(ops.where(u.a > 0, p.k, u.b) > ops.minimum(p.k, 2.0), u.a * x.x, ops.absolute(u.b - x.x))
        return {"x": side - x.x**3 + ops.playback(p.played, t + p.k) + ops.tan(0.3 * u.a) / (1 + p.k**-2)}

    def outputs(t: Any, x: Any, u: Any, p: Any) -> dict[str, Any]:
        first = ops.exp(-(x.x**2)) * ops.sin(u.a) + ops.log(2 + p.k) ** 2 - ops.sqrt(1 + x.x**2) / (3 - ops.cos(u.b))
        second = ops.clip(x.x * u.a, -0.2, 5.0) + ops.sign(u.b) * ops.tanh(p.k) + ops.floor(u.a * 10) * u.b
        noise = ops.uniform(p.seed, ops.floor(t)) * u.a + ops.maximum(u.a, ops.maximum(u.b, x.x)) ** p.k
        return {"y": first - second * 2.0**p.k / (1 / x.x), "z": noise - (first - (second - 1.5)) - -u.b}

    return Model(
        name="everything", description="Every function", derivatives=derivatives, outputs=outputs,
        variables=(
            input_("a", "1", "Input", 0.5), input_("b", "1", "Input", -0.3), output("y", "1", "Output"),
            output("z", "1", "Output"), parameter("k", "1", 1.1, "Parameter"), parameter("seed", "1", 3, "Seed"),
            parameter("x_start", "1", 0.4, "Start"),
        ),
        states=(State("x", "x_start"),), solver_step=lambda p: 0.05 / ops.maximum(p.k, 0.1), tables=("played",),
    )  # fmt: skip


@pytest.mark.parametrize("fmi", VERSIONS)
def test_every_function_computes_in_c_what_it_computes_in_python(tmp_path: Path, fmi: int) -> None:
    model, tables = everything(), {"played": Table("played", (0.0, 1.2, 1.9), (0.1, -0.4, 0.6))}
    names = ["x", "y", "z"]
    with opened(native.build(model, tmp_path / "all.fmu", tables=tables, fmi=fmi)) as fmu:
        fmu.start()
        instance = Instance(model, tables=tables)
        for k in range(30):
            for each in (fmu, instance):
                each.set("a", 0.5 + 0.4 * math.sin(k))
                each.set("b", 0.4 * math.cos(3 * k))
                each.step(0.1 * k, 0.1)
            assert fmu.get(*names) == pytest.approx([instance.get(name) for name in names], rel=1e-12, abs=1e-14)


# Trouble


@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_requirement_that_does_not_hold_fails_the_step_with_its_reason(native_fmu: Built, fmi: int) -> None:
    with opened(native_fmu("energy_controller", fmi)) as controller:
        controller.start()
        for _ in range(2):
            with pytest.raises(FMICallException):
                controller.step(0.0, 0.1)
        assert "start energy is that of the downward equilibrium" in controller.log[0][2]
        controller.fmu.reset()
        controller.start(angle=0.5)
        controller.step(0.0, 0.1)


def unstable(**functions: Any) -> Model:
    return Model(
        name="unstable", description="Runs away", derivatives=lambda t, x, u, p: {"a": p.rate * x.a**2, "b": 0.0},
        variables=(output("a", "1", "Output"), parameter("a_start", "1", 10.0, "Start"), parameter("rate", "1", 1.0, "Rate")),
        states=(State("a", "a_start"), State("b")), **({"solver_step": lambda p: 0.01} | functions),
    )  # fmt: skip


@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_state_that_is_not_finite_is_an_error_with_the_words_of_the_instance(tmp_path: Path, fmi: int) -> None:
    instance = Instance(unstable(), {"a_start": math.nan})
    with pytest.raises(StepError) as error:
        instance.step(0.0, 0.5)
    with opened(native.build(unstable(), tmp_path / "u.fmu", fmi=fmi)) as fmu:
        fmu.start(a_start=math.nan)
        with pytest.raises(FMICallException):
            fmu.step(0.0, 0.5)
        assert fmu.log == [(3, "logStatusError", f"unstable: {error.value}")]
        fmu.fmu.reset()
        fmu.start()
        with pytest.raises(FMICallException):
            fmu.step(0.0, 0.5)
        assert "unstable: state 'a' is" in fmu.log[-1][2]


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("step", ["p.rate - 1", "p.rate * -1", "1e-30 * p.rate"])
def test_a_solver_step_that_leads_nowhere_is_an_error_and_not_a_loop(tmp_path: Path, fmi: int, step: str) -> None:
    model = unstable(solver_step=eval(f"lambda p: {step}"))  # noqa: S307
    with opened(native.build(model, tmp_path / "u.fmu", fmi=fmi)) as fmu:
        fmu.start()
        with pytest.raises(FMICallException):
            fmu.step(0.0, 0.5)


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_a_sample_time_that_is_not_positive_is_an_error_and_not_a_loop(native_fmu: Built, fmi: int, value: float) -> None:
    with opened(native_fmu("daq", fmi)) as fmu:
        fmu.start(sample_time=value)
        with pytest.raises(FMICallException):
            fmu.step(0.0, 0.5)
        assert "'sample_time' is" in fmu.log[-1][2]


@pytest.mark.parametrize("fmi", VERSIONS)
def test_model_exchange_checks_the_requirements_and_the_states_too(tmp_path: Path, fmi: int) -> None:
    requirement = Requirement(lambda t, x, u, p: p.rate > 0, "the rate is not 100% positive")
    path = native.build(unstable(requirements=(requirement,)), tmp_path / "u.fmu", fmi=fmi)
    with opened(path, exchange=True) as fmu:
        fmu.start(rate=-1.0)
        with pytest.raises(FMICallException):
            fmu.fmu.enterContinuousTimeMode()
        assert fmu.log[-1][2] == "unstable: the rate is not 100% positive"
        fmu.fmu.reset()
        fmu.start(a_start=math.inf)
        fmu.fmu.enterContinuousTimeMode()
        with pytest.raises(FMICallException):
            fmu.fmu.completedIntegratorStep()
        assert "state 'a' is inf" in fmu.log[-1][2]


@pytest.mark.parametrize("fmi", VERSIONS)
def test_functions_are_refused_in_modes_that_do_not_allow_them(native_fmu: Built, fmi: int) -> None:
    with opened(native_fmu("pendulum", fmi)) as fmu:
        with pytest.raises(FMICallException):
            fmu.step(0.0, 0.1)
        assert fmu.log[-1][2] == f"pendulum: fmi{fmi}DoStep may not be called in instantiated mode"
        fmu.start()
        for forbidden in (fmu.fmu.enterInitializationMode, fmu.fmu.exitInitializationMode):
            with pytest.raises(FMICallException):
                forbidden()
        fmu.step(0.0, 0.1)
        fmu.fmu.terminate()
        with pytest.raises(FMICallException):
            fmu.step(0.1, 0.1)
        assert fmu.get("inertia") == [0.00325]


@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_sampled_model_cannot_be_instantiated_for_model_exchange(native_fmu: Built, fmi: int) -> None:
    path = native_fmu("daq", fmi)
    with opened(path) as fmu:
        library_ = fmu.fmu
        if fmi == 2:
            handle = library_.fmi2Instantiate(b"x", 0, fmu.description.guid.encode(), library_.resourceLocation.encode()
                                              if hasattr(library_, "resourceLocation") else b"", fmu._kept, 0, 0)  # fmt: skip
            assert not handle
        else:
            from fmpy.fmi3 import FMU3Model

            with pytest.raises(Exception, match="instantiate"):
                other = FMU3Model(guid=fmu.description.guid, unzipDirectory=library_.unzipDirectory,
                                  modelIdentifier="daq", instanceName="x")  # fmt: skip
                other.instantiate(logMessage=fmu._log3)
            assert "offers co-simulation only" in fmu.log[-1][2]


@pytest.mark.parametrize("fmi", VERSIONS)
def test_the_token_of_another_fmu_is_refused(native_fmu: Built, fmi: int) -> None:
    with pytest.raises(Exception, match=r"[Ii]nstantiate"), opened(native_fmu("pendulum", fmi), guid="{other}"):
        pass


@pytest.mark.parametrize("fmi", VERSIONS)
def test_references_that_are_no_variable_of_the_type_are_refused(native_fmu: Built, fmi: int) -> None:
    with opened(native_fmu("daq", fmi)) as fmu:
        seed = fmu.variables["seed"].valueReference
        reals, wholes = ("getReal", "getInteger") if fmi == 2 else ("getFloat64", "getInt32")
        for name, reference in ((reals, seed), (reals, 9999), (reals, 2**32 - 1), (wholes, 0)):
            with pytest.raises(FMICallException):
                getattr(fmu.fmu, name)([reference])
            assert f"value reference {reference} is no variable of this type" in fmu.log[-1][2]
        assert getattr(fmu.fmu, wholes)([seed]) == [1]


@pytest.mark.parametrize("fmi", VERSIONS)
def test_events_are_logged_when_asked_for_and_errors_always(native_fmu: Built, fmi: int) -> None:
    path = native_fmu("pendulum", fmi)
    with opened(path, logging=True) as loud, opened(path) as quiet:
        for fmu in (loud, quiet):
            fmu.start()
            fmu.step(0.0, 0.1)
        assert [category for _, category, _ in loud.log] == ["logEvents", "logEvents"]
        assert "inner steps are at most 0.01 s long" in loud.log[-1][2]
        assert quiet.log == []


def altered(source: Path, target: Path, **contents: bytes | None) -> Path:
    """A copy of an FMU in which some resources are other, or missing."""
    names = {f"resources/{key.replace('__', '.')}": value for key, value in contents.items()}
    with zipfile.ZipFile(source) as good, zipfile.ZipFile(target, "w") as bad:
        for name in {*good.namelist(), *names}:
            text = names[name] if name in names else good.read(name)
            if text is not None:
                bad.writestr(name, text)
    return target


BROKEN = {
    "missing": (None, "defaults.txt cannot be read"),
    "no number": (b"inertia = heavy\n", "'heavy' is no value for inertia"),
    "two numbers": (b"inertia = 1 2\n", "'1 2' is no value for inertia"),
    "hexadecimal": (b"inertia = 0x1p3\n", "is no value for inertia"),
    "infinite": (b"inertia = 1e999\n", "is no value for inertia"),
    "unknown": (b"inertai = 1.0\n", "'inertai' is no input or parameter"),
    "output": (b"energy = 1.0\n", "'energy' is no input or parameter"),
    "no assignment": (b"inertia\n", "'inertia' is no assignment"),
    "long line": (b"inertia = " + b"1" * 5000, "a line is longer"),
    "many lines": (b"\n" * 200_000, "more than 100000 lines"),
    "binary": (bytes(range(256)) * 10, ""),
}


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("kind", BROKEN)
def test_broken_defaults_stop_the_instantiation_with_the_reason(
    native_fmu: Built, tmp_path: Path, fmi: int, kind: str, capfd: pytest.CaptureFixture[str]
) -> None:
    content, reason = BROKEN[kind]
    path = altered(native_fmu("pendulum", fmi), tmp_path / "broken.fmu", defaults__txt=content)
    log: list[str] = []
    with pytest.raises(Exception, match=r"[Ii]nstantiate"), listening(log), opened(path):
        pass
    assert reason in log[-1]
    assert log[-1].startswith("pendulum: ")


class listening:  # noqa: N801 - reads as a function
    """Collects the messages of instances that do not come to be."""

    def __init__(self, log: list[str]) -> None:
        self.log = log

    def __enter__(self) -> None:
        import either

        self._original = either.Either._callbacks, either.Either._log3
        log = self.log

        def hear(self: Any, environment: Any, status: int, category: bytes, message: bytes) -> None:
            log.append(message.decode(errors="replace"))

        def callbacks(self: Any) -> Any:
            made = listening_original(self)
            made.logger = type(made.logger)(lambda env, name, status, category, message, *_: log.append(
                message.decode(errors="replace").replace("%%", "%")))  # fmt: skip
            return made

        listening_original = self._original[0]
        either.Either._callbacks, either.Either._log3 = callbacks, hear  # type: ignore[method-assign]

    def __exit__(self, *_: object) -> None:
        import either

        either.Either._callbacks, either.Either._log3 = self._original  # type: ignore[method-assign]


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize(
    ("content", "reason"),
    [(b"time,value\n", "has no samples"), (b"", "has no samples"), (b"time,value\n0,1\n0,2\n", "increase strictly"),
     (b"time,value\n0;1\n", "no pair of numbers"), (b"time,value\n0,nan\n", "no pair of numbers")],
)  # fmt: skip
def test_broken_tables_stop_the_instantiation_with_the_reason(
    native_fmu: Built, tmp_path: Path, fmi: int, content: bytes, reason: str
) -> None:
    path = altered(native_fmu("excitation", fmi), tmp_path / "broken.fmu", playback__csv=content)
    log: list[str] = []
    with pytest.raises(Exception, match=r"[Ii]nstantiate"), listening(log), opened(path):
        pass
    assert reason in log[-1]


@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_table_that_is_not_there_plays_zeros_and_a_long_one_is_read_whole(
    native_fmu: Built, tmp_path: Path, fmi: int
) -> None:
    with opened(native_fmu("excitation", fmi)) as fmu:
        fmu.start(shape=8)
        assert fmu.get("signal") == [0.0]
    time = tuple(0.001 * k for k in range(5001))
    table = Table("playback", time, tuple(math.sin(t) for t in time))
    path = native.build(library.find("excitation"), tmp_path / "e.fmu", {"shape": 8}, {"playback": table}, fmi=fmi)
    with opened(path) as fmu:
        fmu.start()
        fmu.step(0.0, 4.9995)
        assert fmu.get("signal") == [table(4.9995)]


@pytest.mark.parametrize("fmi", VERSIONS)
def test_resources_are_found_below_a_path_with_blanks_percent_signs_and_umlauts(
    native_fmu: Built, tmp_path: Path, fmi: int
) -> None:
    from either import Either

    folder = tmp_path / "a b%20c" / "häß"
    folder.mkdir(parents=True)
    with zipfile.ZipFile(native_fmu("pendulum", fmi)) as archive:
        archive.extractall(folder)
    fmu = Either(native_fmu("pendulum", fmi), str(folder), logging=True)
    assert fmu.get("inertia") == [0.00325]
    assert "häß" in fmu.log[0][2]
    fmu.fmu.freeInstance()


def test_defaults_in_the_resources_are_the_start_values_of_the_description(native_fmu: Built) -> None:
    for name in NAMES:
        with zipfile.ZipFile(native_fmu(name, 3)) as archive:
            inside = defaults.load(archive.read(defaults.RESOURCE).decode())
        starts = {v.name: v.start for v in fmpy.read_model_description(str(native_fmu(name, 3))).modelVariables if v.start}
        assert {key: float(value) for key, value in starts.items()} == inside


# Models that cannot be built


def small(**changes: Any) -> Model:
    declared: dict[str, Any] = {
        "name": "small", "description": "d", "variables": (input_("a", "1", "A"), output("y", "1", "Y")),
        "outputs": lambda t, x, u, p: {"y": u.a},
    }  # fmt: skip
    return Model(**(declared | changes))


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"outputs": lambda t, x, u, p: {"y": u.a % 2}}, "model small, outputs: uses 'Mod'"),
        ({"outputs": lambda t, x, u, p: {"y": math.sin(u.a)}}, "cannot be traced"),
        ({"outputs": lambda t, x, u, p: {}}, r"missing \['y'\]"),
        ({"states": (State("s"),), "solver_step": lambda p: 1.0}, "nothing gives s; write derivatives"),
        ({"name": "größe"}, "'größe' is no name in C"),
        ({"name": "_small"}, "'_small' is no name in C"),
        ({"variables": (input_("β", "1", "B"), output("y", "1", "Y")), "outputs": lambda t, x, u, p: {"y": 1.0}},
         "'β' is no name in C"),
    ],
)  # fmt: skip
def test_a_model_that_cannot_become_c_is_refused_with_the_reason(
    tmp_path: Path, changes: dict[str, Any], problem: str
) -> None:
    with pytest.raises(ModelError, match=problem):
        native.build(small(**changes), tmp_path / "a.fmu")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("fmi", VERSIONS)
def test_names_that_mean_something_in_c_are_ordinary_names(tmp_path: Path, fmi: int) -> None:
    names = ("double", "int_", "NAN", "sin", "w0", "t", "v", "I", "signal", "time", "der", "main", "N_STATES")
    model = Model(
        name="double", description='Quotes " \\ ?? and ümlauts',
        variables=(*(input_(name, "1", f"{name} <&>") for name in names), output("y", "1", "Sum")),
        outputs=lambda t, x, u, p: {"y": sum(getattr(u, name) for name in names)},
    )  # fmt: skip
    path = native.build(model, tmp_path / "d.fmu", fmi=fmi)
    assert validate_fmu(str(path)) == []
    with opened(path) as fmu:
        fmu.start()
        for number, name in enumerate(names):
            fmu.set(name, float(2**number))
        assert fmu.get("y") == [2 ** len(names) - 1]


@pytest.mark.parametrize("fmi", VERSIONS)
def test_integers_booleans_and_choices_are_carried(tmp_path: Path, fmi: int) -> None:
    model = small(
        variables=(
            input_("a", "1", "A"), input_("on", "1", "On", start=True), output("y", "1", "Y"),  # type: ignore[arg-type]
            parameter("pumps", "1", -2, "Number"), parameter("kind", "1", 2, "Kind", minimum=1, maximum=3,
                                                             choices=("one", "two", "three")),
            parameter("off", "1", False, "Off"),
        ),
        outputs=lambda t, x, u, p: {"y": u.a * p.pumps + 100 * p.kind},
    )  # fmt: skip
    path = native.build(model, tmp_path / "a.fmu", fmi=fmi)
    assert validate_fmu(str(path)) == []
    with opened(path) as fmu:
        assert fmu.get("pumps", "kind", "on", "off") == [-2, 2, True, False]
        fmu.start(a=1.5, pumps=4, kind=3, off=True)
        assert fmu.get("pumps", "kind", "off", "y") == [4, 3, True, 306.0]
        fmu.set("on", False)
        assert fmu.get("on") == [False]


def test_a_model_of_one_output_and_nothing_else_is_built(tmp_path: Path) -> None:
    model = Model("one", "One", (output("y", "1", "Y"),), outputs=lambda t, x, u, p: {"y": 2.0 * t})
    with opened(native.build(model, tmp_path / "one.fmu", fmi=3)) as fmu:
        fmu.start()
        fmu.step(0.0, 3.0)
        assert fmu.get("y") == [6.0]


def test_replacing_a_function_gives_another_token(tmp_path: Path) -> None:
    double = replace(small(), outputs=lambda t, x, u, p: {"y": 2 * u.a})
    paths = [native.build(model, tmp_path / f"{i}.fmu") for i, model in enumerate((small(), double))]
    assert len({description(path).get("guid") for path in paths}) == 2
