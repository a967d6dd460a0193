"""FMUs of others inside of the FMU of a system: the wired trajectory to the last bit, and trouble told by name."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.fmi1 import FMICallException

from fmus import library
from fmus.errors import InputError, ModelError, ParametersRefused
from fmus.packaging import archive, targets
from fmus.packaging.native import compiler
from fmus.parameters.write_back import write_back
from orchestrator.assembly.assembly import open_system
from orchestrator.scenario.fusing import build, fuse
from orchestrator.ssp.tree import tree
from tests.support.commands import servotwin
from tests.support.fmus import arrays, moody, quirks
from tests.support.fmus.either import Either, opened
from tests.support.fmus.sanitized import harnessed
from tests.support.simulation import counter
from tests.support.simulation.fused import Wired, fused, many_rates, of_fmus, stepped, wired
from tests.support.simulation.fused_contract import FusedContract

pytestmark = [
    pytest.mark.slow,  # compilers
    pytest.mark.skipif(not compiler.available(), reason="no C compiler here"),
]
MODELS = ("servo_drive", "pendulum", "excitation")
COUNTERS = """
title: Counters
components:
  a: {fmu: counter.fmu, step: 0.01, parameters: {gain: 0.25, level: high, count: 7}}
  b: {fmu: counter.fmu, step: 0.02}
connections:
  - a.count -> b.by
  - a.odd -> b.on
stimuli: {a.on: {constant: true}, a.by: {constant: 3}}
run: {stop: 1, step: 0.01}
"""
MOODS = """
title: Moods
components:
  a: {fmu: moody.fmu}
  b: {fmu: moody.fmu}
connections: [a.output -> b.input]
stimuli: {a.input: {constant: 3}}
run: {stop: 10, step: 1}
"""


def assert_equal(path: Path, expected: Wired) -> None:
    found = stepped(path, expected)
    for number, (name, values) in enumerate(expected.outputs.items()):
        assert np.array_equal(found[:, number], values), name


def mixed_rates(folder: Path, fmi: int = 2, *changes: tuple[str, str]) -> Path:
    """The scenario of many rates with its drive, pendulums and source as FMUs, and its sampled parts as models."""
    return many_rates(folder, *of_fmus(folder, fmi, *MODELS), *changes)


def counters(folder: Path, fmi: int = 2, **how: bool) -> Path:
    counter.build(folder / "counter.fmu", fmi, **how)
    (folder / "counters.yaml").write_text(COUNTERS)
    return folder / "counters.yaml"


def moods(folder: Path) -> Path:
    moody.build(folder)
    (folder / "moods.yaml").write_text(MOODS)
    return folder / "moods.yaml"


@pytest.mark.parametrize("outer", [2, 3])
@pytest.mark.parametrize("inner", [2, 3])
def test_fmus_and_models_move_inside_as_they_do_wired(tmp_path: Path, inner: int, outer: int) -> None:
    file = mixed_rates(tmp_path, inner)
    expected = wired(file, 1.2)
    assert np.ptp(expected.outputs["hand.angle"]) > 1
    assert_equal(fused(file, tmp_path, outer), expected)


def test_all_at_once_and_from_a_later_start_they_do_too(tmp_path: Path) -> None:
    change = ("{stop: 1.2, step: 0.002}", "{start: 1/3, stop: 1, step: 0.002, order: jacobi}")
    file = mixed_rates(tmp_path, 2, change)
    assert_equal(fused(file, tmp_path), wired(file, 0.5))


@pytest.mark.parametrize("outer", [2, 3])
@pytest.mark.parametrize("inner", [2, 3])
def test_whole_numbers_truths_and_items_pass_and_names_may_be_anything(tmp_path: Path, inner: int, outer: int) -> None:
    """gain h (sum of 7 + 15 k) by hand; the start of a count is set in it, as is an item by its name."""
    file = counters(tmp_path, inner)
    expected = wired(file, 1.0)
    total = expected.outputs['a.total <*/"']
    assert total[-1] == pytest.approx(0.25 * 0.01 * sum(7 + 15 * k for k in range(1, 101)))
    assert {*expected.outputs["a.odd"]} == {0.0, 1.0}
    assert_equal(fused(file, tmp_path, outer), expected)


@pytest.mark.parametrize("fmi", [2, 3])
def test_elements_of_arrays_of_fmi_3_pass_and_the_others_keep_what_they_have(tmp_path: Path, fmi: int) -> None:
    """y = gain u by hand: one element of each is set, one is connected."""
    arrays.build(tmp_path)
    file = tmp_path / "products.yaml"
    file.write_text(
        "title: Products\n"
        "components:\n  a: {fmu: arrays.fmu, parameters: {'gain[1,2]': 0.5}}\n  b: {fmu: arrays.fmu}\n"
        "connections: ['3 * a.y[1] -> b.u[2]']\nstimuli: {'a.u[1]': {constant: 4}}\nrun: {stop: 1, step: 0.1}\n"
        "record: ['a.y[1]', 'a.y[2]', 'b.y[1]', 'b.y[2]']\n"
    )
    expected = wired(file, 1.0)
    assert [expected.outputs[name][-1] for name in ("a.y[1]", "a.y[2]", "b.y[1]", "b.y[2]")] == [5.0, 2.0, 1.0, 15.0]
    path = fused(file, tmp_path, fmi)
    assert_equal(path, expected)
    write_back(path, {"b.gain[2,1]": 7.0}, tmp_path / "new.fmu")
    with opened(tmp_path / "new.fmu") as fmu:
        fmu.start(**{"a.u[1]": 4.0})
        fmu.step(0.0, 0.1)
        fmu.step(0.1, 0.1)
        assert fmu.get("a.y[1]", "b.y[2]") == [5.0, 22.0]


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_model_with_matrices_as_an_fmu_inside_moves_as_it_does_wired(tmp_path: Path, fmi: int) -> None:
    sizes = {"A": (2, 2), "B": (2, 1), "C": (1, 2), "x_start": (2,)}
    targets.build(library.of_size(library.find("state_space"), sizes), tmp_path / "filter.fmu", target="native", fmi=3)
    file = many_rates(tmp_path, ("    model: state_space\n", "    fmu: filter.fmu\n"))
    expected = wired(file, 0.6)
    assert np.ptp(expected.outputs["filter.y"]) > 0.5
    assert_equal(fused(file, tmp_path, fmi), expected)


def test_a_system_inside_of_a_system_moves_as_its_parts_do_and_is_shown(tmp_path: Path) -> None:
    inner = counters(tmp_path)
    expected = wired(inner, 1.0)
    path = fused(inner, tmp_path)
    (tmp_path / "outer.yaml").write_text(
        f"title: Outer\ncomponents: {{box: {{fmu: {path}}}}}\n"
        "stimuli: {box.a.on: {constant: true}, box.a.by: {constant: 3}}\nrun: {stop: 1, step: 0.02}\n"
    )
    whole = fused(tmp_path / "outer.yaml", tmp_path, 3)
    with opened(whole) as fmu:
        fmu.start()
        for k in range(50):
            fmu.step(k * 0.02, 0.02)
        assert fmu.get("box.b.count") == [expected.outputs["b.count"][-1]]
    assert list(tree(whole).lines())[1:] == [
        "  box: counters, FMI 2.0, every 0.02 s, outputs hold from the end of its step, base step 0.01 s",
        "    a: counter, FMI 2.0, every 0.01 s, outputs hold from the end of its step",
        "    b: counter, FMI 2.0, every 0.02 s, outputs hold from the end of its step",
        "    a.count -> b.by",
        "    a.odd -> b.on",
    ]
    shown = servotwin("info", whole, "--tree")
    assert shown.exit_code == 0 and "    a: counter, FMI 2.0" in shown.stdout


def test_equal_fmus_lie_in_one_folder_with_their_licences_and_only_libraries_of_the_platforms(tmp_path: Path) -> None:
    counter.build(tmp_path / "counter.fmu", 2)
    with zipfile.ZipFile(tmp_path / "counter.fmu", "a") as added:
        added.writestr("binaries/win32/counter.dll", b"of another platform")
    (tmp_path / "counters.yaml").write_text(COUNTERS)
    files = archive.read(fused(tmp_path / "counters.yaml", tmp_path))
    assert files["resources/a/documentation/licenses/license.txt"] == b"Only for tests"
    assert not any(name.startswith("resources/b/") or "win32" in name for name in files)
    libraries = [name for name in files if name.startswith("resources/a/binaries/")]
    assert len(libraries) == 1


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_that_is_made_once_a_process_stays_so_with_a_folder_for_each(tmp_path: Path, fmi: int) -> None:
    path = fused(counters(tmp_path, fmi, once=True), tmp_path, fmi)
    folders = {name.split("/")[1] for name in archive.read(path) if name.endswith("/modelDescription.xml")}
    assert folders == {"a", "b"}
    described = read_model_description(str(path)).coSimulation
    assert described.canBeInstantiatedOnlyOncePerProcess


def test_what_is_exposed_is_given_to_the_fmus_and_written_back_into_them(tmp_path: Path) -> None:
    path = fused(counters(tmp_path), tmp_path, expose=["*.gain", "b.level"])
    with opened(path) as fmu:
        shown = {name for name, variable in fmu.variables.items() if variable.causality == "parameter"}
    assert shown == {"a.gain", "b.gain", "b.level"}
    values = {"b.gain": -2.0, "b.level": 5}
    write_back(path, values, tmp_path / "new.fmu")

    def ends(fmu: Either) -> list[float]:
        fmu.step(0.0, 0.5)
        return fmu.get('a.total <*/"', 'b.total <*/"', "b.count")

    with opened(path) as old, opened(tmp_path / "new.fmu") as new, opened(path) as plain:
        old.start(**values)
        new.start()
        plain.start()
        assert old.get(*values) == new.get(*values) == [*values.values()]
        found = ends(new)
        assert found == ends(old) and found[1:] != ends(plain)[1:]


class TestSystemWithFmusInside(FusedContract):
    convention = "flat"

    @staticmethod
    def built(folder: Path, fmi: int) -> Path:
        return fused(mixed_rates(folder, 5 - fmi), folder, fmi)


@pytest.mark.parametrize("fmi", [2, 3])
def test_what_the_fmus_inside_cannot_is_not_offered(tmp_path: Path, fmi: int) -> None:
    (tmp_path / "with").mkdir()
    (tmp_path / "without").mkdir()
    path = fused(mixed_rates(tmp_path / "with", fmi), tmp_path, fmi)
    able = read_model_description(str(path)).coSimulation
    assert able.canGetAndSetFMUstate and not able.canSerializeFMUstate and not able.needsExecutionTool
    with opened(path) as fmu:
        fmu.start()
        state = fmu.save()
        with pytest.raises(FMICallException):
            fmu.serialize(state)
        fmu.drop(state)
    path = fused(counters(tmp_path / "without", fmi), tmp_path, fmi)
    unable = read_model_description(str(path)).coSimulation
    assert not unable.canGetAndSetFMUstate
    log = list[tuple[int, str, str]]()
    with opened(path, log=log) as fmu:
        fmu.start()
        with pytest.raises(FMICallException):
            fmu.save()
        assert log[-1][2] == "counters: a: cannot save its state"


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("mood", "action"),
    [
        ("setup", "enter the initialisation"),
        ("enter", "enter the initialisation"),
        ("exit", "leave the initialisation"),
        ("get", "get outputs"),
        ("set", "set inputs"),
        ("step", "step"),
    ],
)
def test_trouble_inside_is_told_with_the_component_and_what_it_said(
    tmp_path: Path, fmi: int, mood: str, action: str
) -> None:
    path = fused(moods(tmp_path), tmp_path, fmi)
    for status, name in ((2, "discard"), (3, "error"), (4, "fatal")):
        log = list[tuple[int, str, str]]()
        with opened(path, log=log) as fmu:
            with pytest.raises(FMICallException):
                fmu.start(**{f"b.{mood}": status})
                fmu.step(0.0, 1.0)
            assert log[-2][2].startswith(f"moods: b: {mood} said {status},"), log
            assert log[-1][1:] == ("logStatusError", f"moods: b: {action}: returned {name}")
    log = []
    with opened(path, log=log) as fmu:  # a warning passes
        fmu.start(**{f"b.{mood}": 1})
        fmu.step(0.0, 1.0)
        assert {status for status, *_ in log} == {1}


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_that_asks_to_stop_ends_the_run_of_the_whole(tmp_path: Path, fmi: int) -> None:
    with open_system({"whole": fused(moods(tmp_path), tmp_path, fmi)}) as system:
        result = system.run(10, 1)
    assert result.ended == "whole: asked to stop at t = 5 s"
    assert result.trace.time[-1] == 5.0


@pytest.mark.parametrize("fmi", [2, 3])
def test_parameters_that_do_not_fit_together_are_refused_through_both_fmus(tmp_path: Path, fmi: int) -> None:
    targets.build("notch", tmp_path / "notch.fmu", target="native", fmi=fmi)
    (tmp_path / "filters.yaml").write_text(
        "title: t\ncomponents: {filter: {fmu: notch.fmu}}\nrun: {stop: 0.1, step: 1/300}\n"
    )
    path = fused(tmp_path / "filters.yaml", tmp_path, 5 - fmi)
    with open_system({"whole": path}) as system, pytest.raises(ParametersRefused, match=r"filter: .*frequency is not"):
        system.run("0.1", "1/300", {"whole.filter.frequency": 160.0})


def test_a_value_that_an_fmu_does_not_take_is_an_error(tmp_path: Path) -> None:
    log = list[tuple[int, str, str]]()
    with opened(fused(moods(tmp_path), tmp_path), log=log) as fmu:
        with pytest.raises(FMICallException):
            fmu.start(**{"a.stubborn": 2.0})
        assert log[-1][2] == "moods: a: a.stubborn was set to 2 but is 1: it does not take it"


def test_functions_that_a_library_lacks_matter_where_they_are_needed(tmp_path: Path) -> None:
    quirks.build(tmp_path / "lag.fmu")
    file = tmp_path / "lags.yaml"
    file.write_text("title: Lag\ncomponents: {lag: {fmu: lag.fmu, parameters: {u: 2}}}\nrun: {stop: 1, step: 0.1}\n")
    assert_equal(fused(file, tmp_path), wired(file, 1.0))


def test_the_tolerance_of_the_scenario_is_told_inside_unless_the_importer_tells_one(tmp_path: Path) -> None:
    quirks.build(tmp_path / "lag.fmu", ON_SETUP="m->number[K] = hasTolerance ? tolerance : 0.5;")
    file = tmp_path / "lags.yaml"
    file.write_text("title: Lag\ncomponents: {lag: {fmu: lag.fmu}}\nrun: {stop: 1, step: 1, tolerance: 0.25}\n")
    path = fused(file, tmp_path)
    assert_equal(path, wired(file, 1.0))
    with opened(path) as fmu:
        fmu.fmu.setupExperiment(tolerance=0.125, startTime=0.0)
        fmu.fmu.enterInitializationMode()
        fmu.fmu.exitInitializationMode()
        fmu.step(0.0, 1.0)
        assert fmu.get("lag.x") == [1 - 0.125]


def test_a_unit_that_an_fmu_defines_in_its_own_way_is_told(tmp_path: Path) -> None:
    file = counters(tmp_path)
    files = archive.read(tmp_path / "counter.fmu")
    defined = b'<UnitDefinitions><Unit name="m"><BaseUnit m="1" factor="2"/></Unit></UnitDefinitions><TypeDefinitions>'
    files["modelDescription.xml"] = files["modelDescription.xml"].replace(b"<TypeDefinitions>", defined)
    archive.write(tmp_path / "counter.fmu", files)
    assert "a: its unit 'm' is shown by its name alone, not as it defines it" in fuse(file).notes


def test_an_fmu_that_is_a_part_is_not_written_over(tmp_path: Path) -> None:
    file = counters(tmp_path)
    file = file.rename(tmp_path / "counter.yaml")
    before = (tmp_path / "counter.fmu").read_bytes()
    with pytest.raises(InputError, match=r"counter\.fmu: would be replaced, and is a part of the system"):
        fused(file, tmp_path)
    assert (tmp_path / "counter.fmu").read_bytes() == before


def test_a_system_of_an_ssp_is_packed_as_the_scenario_is(tmp_path: Path) -> None:
    file = counters(tmp_path)
    done = servotwin("ssp", "export", file, "--out", tmp_path / "counters.ssp")
    assert done.exit_code == 0, done.output
    done = servotwin("build", "--system", tmp_path / "counters.ssp", "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    expected, of_ssp = wired(file, 0.5), tmp_path / "out" / "counters.fmu"
    with opened(of_ssp) as fmu:
        fmu.start(**{"a.on": True, "a.by": 3})
        for k in range(50):
            fmu.step(k * 0.01, 0.01)
        assert fmu.get("b.count") == [expected.outputs["b.count"][-1]]


def test_a_library_for_every_platform_is_asked_of_the_fmus_inside(tmp_path: Path) -> None:
    made = fuse(counters(tmp_path))
    other = next(name for name in ("aarch64-linux", "x86_64-linux") if name != compiler.host().name)
    with pytest.raises(ModelError, match=rf"counter\.fmu: 'a' has no library for {other} \(it has: \w+\)"):
        build(made, tmp_path / "out", 2, ["host", other])
    assert not (tmp_path / "out").exists()


def refused(folder: Path, components: str, rest: str = "") -> str:
    (folder / "system.yaml").write_text(f"title: t\ncomponents: {components}\n{rest}\nrun: {{stop: 1, step: 0.1}}\n")
    with pytest.raises(InputError) as error:
        fuse(folder / "system.yaml")
    assert str(error.value).startswith(str(folder / "system.yaml"))
    return str(error.value)


def test_what_cannot_be_inside_is_refused_by_its_place(tmp_path: Path) -> None:
    counter.build(tmp_path / "counter.fmu", 2)
    arrays.build(tmp_path)
    said = refused(tmp_path, "{a: {fmu: counter.fmu, parameters: {text: b}}}")
    assert "components.a: text: is of type String, which is not passed on inside" in said
    said = refused(tmp_path, "{a: {fmu: arrays.fmu, parameters: {m: 3}}}")
    assert "components.a: m: sizes of arrays cannot be set inside" in said
    said = refused(tmp_path, "{a: {fmu: arrays.fmu, parameters: {'p_Float32[1]': 3}}}")
    assert "components.a: p_Float32[1]: is of type Float32, which is not passed on inside" in said


def test_a_python_fmu_inside_moves_where_there_is_python(tmp_path: Path) -> None:
    targets.build("pendulum", tmp_path / "hand.fmu", target="python")
    file, hand = tmp_path / "swing.yaml", "{fmu: hand.fmu, parameters: {angle_start: 0.3}}"
    file.write_text(f"title: Hand\ncomponents: {{hand: {hand}}}\nrun: {{stop: 1, step: 0.01}}\n")
    assert_equal(fused(file, tmp_path), wired(file, 0.2))


@pytest.mark.parametrize("fmi", [2, 3])
def test_no_call_leaves_memory_behind_or_its_bounds(tmp_path: Path, fmi: int) -> None:
    path = fused(mixed_rates(tmp_path, fmi), tmp_path, fmi)
    assert harnessed(path, tmp_path / "unpacked", fmi) == (0, "")


def test_one_system_gives_the_same_bytes_and_another_library_inside_another_fmu(tmp_path: Path) -> None:
    file = counters(tmp_path)
    first = fused(file, tmp_path / "1").read_bytes()
    assert fused(file, tmp_path / "2").read_bytes() == first
    with zipfile.ZipFile(tmp_path / "counter.fmu", "a") as added:
        added.writestr("resources/more.txt", b"more")
    again = fused(file, tmp_path / "3")
    assert read_model_description(str(again)).guid != read_model_description(str(tmp_path / "1/counters.fmu")).guid


def test_the_command_says_what_is_inside(tmp_path: Path) -> None:
    done = servotwin("build", "--system", counters(tmp_path), "--out", tmp_path / "out", "--json")
    document = json.loads(done.stdout)
    assert [part["model"] for part in document["parts"]] == ["counter", "counter"]
    assert "a: cannot go back to a state, and so neither can the FMU" in document["notes"]
