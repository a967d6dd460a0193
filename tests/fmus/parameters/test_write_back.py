"""A written-back FMU behaves calibrated wherever it is loaded; a foreign one stays as it is and gets its set beside."""

from __future__ import annotations

import json
import math
import re
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import fmpy.ssp
import numpy as np
import pytest
from fmpy import read_model_description, simulate_fmu
from fmpy.ssp.ssd import read_ssd, read_ssv
from lxml import etree

from fmus import library
from fmus.errors import FmuFileError
from fmus.modelling.model import Model
from fmus.packaging import archive, defaults, targets
from fmus.packaging.native import compiler
from fmus.parameters.ssv import Item
from fmus.parameters.write_back import PROVENANCE, REFERENCES, write_back
from tests.support.ssv import read_values
from tests.support.tools import third_party

Build = Callable[[str], Path]
CALIBRATED: dict[str, Any] = {
    "inertia": 0.1 + 0.2,
    "viscous_friction": 1.7e-4,
    "gravity_torque": 1 / 3,
    "coulomb_friction_negative": 4.7e-3,
    "angle_start": 0.7,
    "torque": 0.05,
}
PROVENANT = {"title": "A study", "method": "output-error"}
SSP_SCHEMAS = Path(str(fmpy.ssp.__file__)).parent / "schema"


def start_values(path: Path) -> dict[str, str]:
    """name -> start attribute in modelDescription.xml."""
    variables = read_model_description(str(path), validate=True).modelVariables
    return {variable.name: variable.start for variable in variables if variable.start is not None}


def by_defaults(path: Path) -> dict[str, Any]:
    return defaults.load(archive.read(path)[defaults.RESOURCE].decode())


def as_text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)


def swing(path: Path, **values: float) -> np.ndarray:
    """All outputs of a free run of 2 s in FMPy."""
    return simulate_fmu(str(path), stop_time=2, output_interval=0.01, start_values=values)


def foreign_copy(source: Path, target: Path) -> Path:
    """One of our FMUs as if another tool had made it."""
    files = archive.read(source)
    text = files["modelDescription.xml"].replace(b'generationTool="servotwin"', b'generationTool="Somebody"')
    archive.write(target, files | {"modelDescription.xml": text})
    return target


def nothing_written(folder: Path) -> bool:
    return not any(path.is_file() for path in folder.rglob("*")) if folder.exists() else True


def test_a_calibrated_fmu_behaves_calibrated_with_nothing_set(fmu: Build, tmp_path: Path) -> None:
    target = tmp_path / "calibrated.fmu"
    assert write_back(fmu("pendulum"), CALIBRATED, target, PROVENANT) == [target]
    ours, asked = swing(target), swing(fmu("pendulum"), **CALIBRATED)
    assert ours.dtype.names is not None and "angle" in ours.dtype.names
    for name in ours.dtype.names:
        assert np.max(np.abs(ours[name] - asked[name])) <= 1e-15, name
    assert np.max(np.abs(swing(fmu("pendulum"))["angle"] - ours["angle"])) > 0.1


def test_start_values_in_the_xml_and_in_the_resources_agree_for_every_variable(fmu: Build, tmp_path: Path) -> None:
    target = tmp_path / "calibrated.fmu"
    write_back(fmu("pendulum"), CALIBRATED, target, PROVENANT)
    told, used = start_values(target), by_defaults(target)
    assert told == {name: as_text(value) for name, value in used.items()}
    before = by_defaults(fmu("pendulum"))
    assert used == {**before, **CALIBRATED}


def test_the_guid_and_everything_but_the_start_values_stay(fmu: Build, tmp_path: Path) -> None:
    target = tmp_path / "calibrated.fmu"
    write_back(fmu("pendulum"), CALIBRATED, target, PROVENANT)
    old, new = archive.read(fmu("pendulum")), archive.read(target)
    changed = {"modelDescription.xml", defaults.RESOURCE}
    assert {name: new[name] for name in old if name not in changed} == {
        name: text for name, text in old.items() if name not in changed
    }
    assert set(new) - set(old) == {PROVENANCE, f"{REFERENCES}/fmi-ls-manifest.xml", f"{REFERENCES}/calibrated.ssv"}
    bare = [re.sub(rb'\s+start="[^"]*"', b"", files["modelDescription.xml"]) for files in (old, new)]
    first, second = (etree.canonicalize(etree.fromstring(text), strip_text=True) for text in bare)
    assert first == second and "guid=" in first


def test_provenance_and_the_set_of_values_travel_inside(fmu: Build, tmp_path: Path) -> None:
    target = tmp_path / "calibrated.fmu"
    write_back(fmu("pendulum"), CALIBRATED, target, PROVENANT)
    files = archive.read(target)
    assert json.loads(files[PROVENANCE]) == PROVENANT
    (tmp_path / "set.ssv").write_bytes(files[f"{REFERENCES}/calibrated.ssv"])
    assert read_values(tmp_path / "set.ssv") == CALIBRATED
    foreign = read_ssv(str(tmp_path / "set.ssv"), validate=True)
    assert {p.name: float(p.value) for p in foreign.parameters} == CALIBRATED
    assert {p.name: p.unit for p in foreign.parameters}["inertia"] == "kg.m2"


def test_the_manifest_names_the_set_and_its_role(fmu: Build, tmp_path: Path) -> None:
    target = tmp_path / "calibrated.fmu"
    write_back(fmu("pendulum"), CALIBRATED, target, PROVENANT)
    files = archive.read(target)
    manifest = etree.fromstring(files[f"{REFERENCES}/fmi-ls-manifest.xml"])
    (related,) = manifest.findall("Related")
    assert related.get("role") == "parameter"
    assert f"{REFERENCES}/{related.get('source')}" in files
    assert manifest.get("{http://fmi-standard.org/fmi-ls-manifest}fmi-ls-name") == "org.fmi-standard.fmi-ls-ref"


def test_writing_back_twice_keeps_what_the_second_does_not_name(fmu: Build, tmp_path: Path) -> None:
    once, twice = tmp_path / "once.fmu", tmp_path / "twice.fmu"
    write_back(fmu("pendulum"), {"inertia": 0.005, "gravity_torque": 0.02}, once, {"title": "first"})
    write_back(once, {"inertia": 0.007}, twice, {"title": "second"})
    used = by_defaults(twice)
    assert (used["inertia"], used["gravity_torque"]) == (0.007, 0.02)
    assert start_values(twice) == {name: as_text(value) for name, value in used.items()}
    assert json.loads(archive.read(twice)[PROVENANCE]) == {"title": "second"}


@pytest.mark.parametrize("step", [None, 0.0025])
def test_importers_are_told_the_step_that_is_given_and_without_one_what_they_were_told(
    fmu: Build, tmp_path: Path, step: float | None
) -> None:
    write_back(fmu("pendulum"), CALIBRATED, tmp_path / "calibrated.fmu", PROVENANT, step)
    before, now = (
        read_model_description(str(path)).defaultExperiment.stepSize
        for path in (fmu("pendulum"), tmp_path / "calibrated.fmu")
    )
    assert now == (before if step is None else repr(step))


def test_an_fmu_can_be_written_back_onto_itself_and_equal_inputs_give_equal_bytes(fmu: Build, tmp_path: Path) -> None:
    one, other = tmp_path / "a.fmu", tmp_path / "b.fmu"
    for target in (one, other):
        target.write_bytes(fmu("pendulum").read_bytes())
        write_back(target, CALIBRATED, target, PROVENANT)
    assert one.read_bytes() == other.read_bytes()
    assert by_defaults(one)["inertia"] == CALIBRATED["inertia"]


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"inertai": 1.0}, "inertai: no such variable; did you mean 'inertia'?"),
        ({"inertia": -1.0}, "inertia: -1.0 lies outside its bounds [0.0, inf); bound the parameter in the study"),
        ({"angle": 1.0}, "angle: is a variable of causality output; calibrate a parameter"),
        ({"inertia": math.nan}, "inertia: cannot be nan; give a finite number"),
        ({"gravity_torque": math.inf}, "gravity_torque: cannot be inf; give a finite number"),
        ({"inertia": "heavy"}, "inertia: cannot be 'heavy'; give a number"),
    ],
)
@pytest.mark.parametrize("ours", [True, False])
def test_what_cannot_be_written_is_refused_in_one_line_and_nothing_is_written(
    fmu: Build, tmp_path: Path, values: Mapping[str, Any], line: str, ours: bool
) -> None:
    source = fmu("pendulum") if ours else foreign_copy(fmu("pendulum"), tmp_path / "foreign.fmu")
    with pytest.raises(FmuFileError) as refused:
        write_back(source, {"viscous_friction": 0.002, **values}, tmp_path / "out" / "calibrated.fmu", PROVENANT)
    assert str(refused.value) == f"{source}: {line}"
    assert nothing_written(tmp_path / "out")


MIXED = '''"""A model with a parameter of every type."""
from .model import Model, output, parameter

def outputs(t, x, u, p):
    return {"y": (10.0 * p.count + p.gain) * (1.0 if p.enabled else -1.0) + 100.0 * p.kind}

MODEL = Model("mixed", "Types", (
    output("y", "1", "Of everything"),
    parameter("gain", "1", 0.5, "Real"),
    parameter("count", "1", 3, "Whole", minimum=0, maximum=9),
    parameter("enabled", "1", True, "Truth"),
    parameter("kind", "1", 1, "Choice", minimum=1, maximum=3, choices=("slow", "medium", "fast")),
), outputs=outputs)
'''


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    (tmp_path / "mixed.py").write_text(MIXED)
    model: Model = library.find(str(tmp_path / "mixed.py"))
    return targets.build(model, tmp_path / "mixed.fmu", target="python")


@pytest.mark.parametrize("kind", ["fast", 3])
def test_whole_numbers_truths_and_choices_are_written_back_in_their_type(
    mixed: Path, tmp_path: Path, kind: Any
) -> None:
    target = tmp_path / "calibrated.fmu"
    write_back(mixed, {"gain": 2, "count": 7.0, "enabled": False, "kind": kind}, target, PROVENANT)
    assert by_defaults(target) == {"gain": 2.0, "count": 7, "enabled": False, "kind": 3}
    assert {name: type(value) for name, value in by_defaults(target).items()}["enabled"] is bool
    assert start_values(target) == {"gain": "2.0", "count": "7", "enabled": "false", "kind": "3"}
    run = simulate_fmu(str(target), stop_time=0.1, output_interval=0.1)
    assert run["y"][-1] == (10 * 7 + 2) * -1 + 300
    (tmp_path / "set.ssv").write_bytes(archive.read(target)[f"{REFERENCES}/calibrated.ssv"])
    values = read_values(tmp_path / "set.ssv")
    assert values == {"gain": 2.0, "count": 7, "enabled": False, "kind": "fast"}
    assert type(values["kind"]) is Item
    kinds = {p.name: p.type for p in read_ssv(str(tmp_path / "set.ssv"), validate=True).parameters}
    assert kinds == {"gain": "Real", "count": "Integer", "enabled": "Boolean", "kind": "Enumeration"}


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"count": 2.5}, "count: is of type Integer, not 2.5; give a whole number"),
        ({"count": 10}, "count: 10 lies outside its bounds [0, 9]; bound the parameter in the study"),
        ({"enabled": 2}, "enabled: is of type Boolean, not 2; give true or false"),
        ({"kind": "rapid"}, "kind: cannot be 'rapid'; give slow, medium, fast"),
        ({"kind": 4}, "kind: 4 lies outside its bounds [1, 3]; bound the parameter in the study"),
    ],
)
def test_a_value_of_another_type_is_refused(mixed: Path, tmp_path: Path, values: dict[str, Any], line: str) -> None:
    with pytest.raises(FmuFileError) as refused:
        write_back(mixed, values, tmp_path / "out" / "calibrated.fmu", PROVENANT)
    assert str(refused.value) == f"{mixed}: {line}"
    assert nothing_written(tmp_path / "out")


def check_beside(source: Path, before: bytes, written: list[Path], values: Mapping[str, Any]) -> None:
    """A foreign FMU is untouched; its set and its SSP are valid, hold the values, and the SSP the very FMU."""
    ssp, ssv, provenance = written
    assert source.read_bytes() == before
    assert not ssp.with_suffix(".fmu").exists() or ssp.with_suffix(".fmu") == source
    assert read_values(ssv) == dict(values)
    read_ssv(str(ssv), validate=True)
    assert json.loads(provenance.read_text()) == PROVENANT
    with zipfile.ZipFile(ssp) as package:
        structure = etree.fromstring(package.read("SystemStructure.ssd"))
        assert package.read(f"resources/{source.name}") == before
    schema = etree.XMLSchema(file=str(SSP_SCHEMAS / "SystemStructureDescription.xsd"))
    assert schema.validate(structure), schema.error_log
    (component,) = read_ssd(str(ssp), validate=True).system.elements
    assert component.source == f"resources/{source.name}"
    real = {
        variable.name: variable.causality
        for variable in read_model_description(str(source)).modelVariables
        if variable.causality in ("input", "output") and variable.type in ("Real", "Float32", "Float64")
    }
    assert {connector.name: connector.kind for connector in component.connectors} == real
    (binding,) = component.parameterBindings
    assert {p.name for p in binding.parameterValues[0].parameters} == set(values)


def test_a_foreign_fmu_is_untouched_and_gets_a_valid_set_and_ssp_beside_it(fmu: Build, tmp_path: Path) -> None:
    source = foreign_copy(fmu("pendulum"), tmp_path / "foreign.fmu")
    before = source.read_bytes()
    written = write_back(source, CALIBRATED, tmp_path / "out" / "hand.fmu", PROVENANT)
    assert [path.name for path in written] == ["hand.ssp", "hand.ssv", "hand.provenance.json"]
    check_beside(source, before, written, CALIBRATED)


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
def test_reference_fmus_get_a_set_and_an_ssp(version: int, tmp_path: Path) -> None:
    source = third_party.reference(version, "Feedthrough")
    values = {
        "Float64_fixed_parameter": 0.1,
        "Float64_tunable_parameter": -2.5e-7,
        "Int32_input": 4,
        "Boolean_input": True,
        "Enumeration_input": "Option 2",
        "String_input": "<&>",
    }
    check_beside(source, source.read_bytes(), write_back(source, values, tmp_path / "f.fmu", PROVENANT), values)


def test_a_state_that_may_be_set_before_the_start_counts_as_a_start_value(tmp_path: Path) -> None:
    source = third_party.reference(2, "VanDerPol")
    write_back(source, {"x0": 1.5, "mu": 2.0}, tmp_path / "v.fmu", PROVENANT)
    assert read_values(tmp_path / "v.ssv") == {"x0": 1.5, "mu": 2.0}
    with pytest.raises(FmuFileError, match=r"der\(x0\): is a variable of causality local"):
        write_back(source, {"der(x0)": 1.0}, tmp_path / "w.fmu", PROVENANT)


@pytest.mark.parametrize("initial", [b"exact", b"approx"])
def test_a_start_value_that_is_only_about_right_can_be_set_too(initial: bytes, tmp_path: Path) -> None:
    files = archive.read(third_party.reference(2, "VanDerPol"))
    text = files["modelDescription.xml"].replace(b'initial="exact"', b'initial="' + initial + b'"')
    archive.write(tmp_path / "source.fmu", files | {"modelDescription.xml": text})
    write_back(tmp_path / "source.fmu", {"x0": 1.5}, tmp_path / "v.fmu", PROVENANT)
    assert read_values(tmp_path / "v.ssv") == {"x0": 1.5}


@pytest.mark.slow
@pytest.mark.skipif(not compiler.available(), reason="no C compiler here")
def test_an_element_of_an_array_is_written_in_its_place(tmp_path: Path) -> None:
    source = targets.build("state_space", tmp_path / "source.fmu", target="native", fmi=3)
    before = start_values(source)["A"].split()
    write_back(source, {"A[2,1]": 0.25}, tmp_path / "out.fmu", PROVENANT)
    size = math.isqrt(len(before))
    assert start_values(tmp_path / "out.fmu")["A"].split() == [*before[:size], "0.25", *before[size + 1 :]]


def test_an_item_that_an_enumeration_does_not_have_is_refused_by_name_and_number(tmp_path: Path) -> None:
    source = third_party.reference(3, "Feedthrough")
    for value in ("Option 3", 3):
        with pytest.raises(FmuFileError, match=r"Enumeration_input: .*Option 1, Option 2"):
            write_back(source, {"Enumeration_input": value}, tmp_path / "out" / "f.fmu", PROVENANT)
    assert nothing_written(tmp_path / "out")


@pytest.mark.parametrize(
    ("files", "problem"),
    [
        ({"a.txt": b""}, "holds no modelDescription.xml"),
        ({"modelDescription.xml": b"<broken"}, "is not XML"),
        ({"modelDescription.xml": b"<fmiModelDescription/>"}, "declares no variables"),
        (
            {
                "modelDescription.xml": b'<fmiModelDescription generationTool="servotwin"><ModelVariables/>'
                b"</fmiModelDescription>",
                defaults.RESOURCE: b"inertia = heavy\n",
            },
            "is damaged",
        ),
    ],
)
def test_what_is_no_fmu_is_refused(tmp_path: Path, files: dict[str, bytes], problem: str) -> None:
    source = tmp_path / "odd.fmu"
    archive.write(source, files)
    with pytest.raises(FmuFileError, match=problem):
        write_back(source, {}, tmp_path / "out" / "x.fmu", PROVENANT)
    assert nothing_written(tmp_path / "out")
