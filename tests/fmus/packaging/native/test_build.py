"""Native FMUs as files: valid, complete, reproducible, and only from models that C can hold."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import pytest
from fmpy.validation import validate_fmu
from lxml import etree

from fmus import library
from fmus.errors import ModelError
from fmus.modelling import ops
from fmus.modelling.model import Model, State, input_, output, parameter
from fmus.packaging import archive, targets
from fmus.packaging.native import build as native
from fmus.packaging.native import compiler
from tests.support.fmus.either import opened, schema
from tests.support.fmus.natives import NAMES, PENDULUM, RICH, VERSIONS

Built = Callable[[str, int], Path]

pytestmark = [
    pytest.mark.slow,  # processes, compilers or minutes of work
    pytest.mark.skipif(not compiler.available(), reason="no C compiler here"),
]


def description(path: Path) -> ET.Element:
    return ET.fromstring(archive.read(path)["modelDescription.xml"])


@pytest.mark.parametrize("name", NAMES)
def test_build_description_fits_the_schema_of_the_standard(native_fmu: Built, name: str) -> None:
    files = archive.read(native_fmu(name, 3))
    document = etree.fromstring(files["sources/buildDescription.xml"])
    listed = {file.get("name") for file in document.iter("SourceFile")}
    units = {n.removeprefix("sources/") for n in files if n.startswith("sources/") and n.endswith(".c")}
    etree.XMLSchema(file=str(schema(3).with_name("fmi3BuildDescription.xsd"))).assertValid(document)
    assert listed == units


@pytest.mark.parametrize("fmi", VERSIONS)
def test_an_fmu_for_no_platform_lacks_its_library_and_nothing_else(
    native_fmu: Built, source_fmu: Built, fmi: int
) -> None:
    whole = archive.read(native_fmu("pendulum", fmi))
    libraries = {name for name in whole if name.startswith("binaries/")}
    assert len(libraries) == 1
    assert archive.read(source_fmu("pendulum", fmi)) == {name: whole[name] for name in whole.keys() - libraries}


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
        "angle": {"angle"},
        "speed": {"speed"},
        "acceleration": {"angle", "speed", "torque"},
        "energy": {"angle", "speed"},
    }
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
            known = variable.name if fmi == 2 else variable.name.partition("[")[0]
            assert all(known in declared[key] for key in moved), variable.name


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", NAMES)
def test_model_exchange_is_offered_for_continuous_models_only(native_fmu: Built, name: str, fmi: int) -> None:
    described = fmpy.read_model_description(str(native_fmu(name, fmi)))
    assert described.coSimulation is not None
    assert (described.modelExchange is not None) == (
        name in ("pendulum", "geared_pendulum", "linear_axis", "dc_motor", "flexible_arm", "flexible_link")
    )


@pytest.mark.shipped
@pytest.mark.parametrize("fmi", VERSIONS)
def test_sources_in_the_fmu_build_it_again_without_a_warning(source_fmu: Built, fmi: int) -> None:
    for name in NAMES:
        sources = {
            n.removeprefix("sources/"): text.decode()
            for n, text in archive.read(source_fmu(name, fmi)).items()
            if n.startswith("sources/") and n.endswith((".c", ".h"))
        }
        strict = ("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Wno-sign-conversion", "-Werror")
        assert compiler.compile_library(sources, name, compiler.host(), strict)


def test_the_page_of_documentation_shows_equations_variables_and_references(native_fmu: Built) -> None:
    text = archive.read(native_fmu("pendulum", 3))["documentation/index.html"].decode()
    assert "<math" in text
    assert all(variable.description in text for variable in PENDULUM.variables)
    assert all(reference in text for reference in PENDULUM.references)
    assert "http" not in text.replace("http://www.w3.org/1998/Math/MathML", "")


def test_another_version_of_fmi_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="FMI 1 is not offered"):
        targets.build(PENDULUM, tmp_path / "a.fmu", target="native", fmi=1)


SELECTING = (input_("a", "1", "A"), parameter("kind", "1", 1, "Kind", minimum=1, maximum=3))


def small(**changes: Any) -> Model:
    declared: dict[str, Any] = {
        "name": "small",
        "description": "d",
        "variables": (input_("a", "1", "A"), output("y", "1", "Y")),
        "outputs": lambda t, x, u, p: {"y": u.a},
    }
    return Model(**(declared | changes))


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"outputs": lambda t, x, u, p: {"y": u.a % 2}}, "model small, outputs: uses 'Mod'"),
        ({"outputs": lambda t, x, u, p: {"y": math.sin(u.a)}}, "takes numbers only; write"),
        ({"outputs": lambda t, x, u, p: {}}, "returns nothing for y"),
        ({"states": (State("s"),), "solver_step": lambda p: 1.0}, "nothing gives s; write derivatives"),
        (
            {
                "variables": (*SELECTING, output("y", "1", "Y")),
                "outputs": lambda t, x, u, p: {"y": ops.where(p.kind == 2, u.a, -u.a)},
            },
            "compare with < and > instead",
        ),
        ({"name": "größe"}, "'größe' is no name in C"),
        ({"name": "_small"}, "'_small' is no name in C"),
        (
            {"variables": (input_("β", "1", "B"), output("y", "1", "Y")), "outputs": lambda t, x, u, p: {"y": 1.0}},
            "'β' is no name in C",
        ),
    ],
)
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
        name="double",
        description='Quotes " \\ ?? and ümlauts',
        variables=(*(input_(name, "1", f"{name} <&>") for name in names), output("y", "1", "Sum")),
        outputs=lambda t, x, u, p: {"y": sum(getattr(u, name) for name in names)},
    )
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
            input_("a", "1", "A"),
            input_("on", "1", "On", start=True),
            output("y", "1", "Y"),  # type: ignore[arg-type]
            parameter("pumps", "1", -2, "Number"),
            parameter("kind", "1", 2, "Kind", minimum=1, maximum=3, choices=("one", "two", "three")),
            parameter("off", "1", False, "Off"),
        ),
        outputs=lambda t, x, u, p: {"y": u.a * p.pumps + 100 * p.kind},
    )
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
