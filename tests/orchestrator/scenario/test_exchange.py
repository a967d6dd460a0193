"""A scenario goes out as an SSP and comes back: the same trajectories, the same expectations, all that it reads."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from fmus.errors import InputError, WiringError
from orchestrator.fmi.file import FmuDescription
from orchestrator.scenario.exchange import export, unpack
from orchestrator.scenario.run import ScenarioResult, run_scenario
from orchestrator.ssp.checking import check
from orchestrator.ssp.document import imported
from orchestrator.ssp.names import Version
from orchestrator.ssp.outline import Tool
from tests.support.fmus import arrays, clocks
from tests.support.simulation import ssps
from tests.support.simulation.ssps import NAMESPACES, archive, component, system
from tests.support.tools.third_party import reference

STAIR = "time,torque\n0,0\n0.1,0.01\n0.3,-0.01\n0.5,0\n"
COMPONENTS: dict[str, Any] = {
    "push": {"model": "excitation", "parameters": {"shape": "sine sweep", "amplitude": 0.3, "frequency": 2}},
    "motor": {"model": "dc_motor", "parameters": {"inductance": 0.02}},
    "hand": {"model": "pendulum", "parameters": {"angle_start": 0.4}},
}
WIRES = ["0.5 * push.signal + 0.1 -> motor.voltage", "hand.speed -> motor.speed", "motor.torque -> hand.torque"]
PLAYED = {
    "stimuli": {"hand.torque": {"file": "stair.csv", "signal": "torque", "ends": "hold"}},
    "components": {"hand": {"model": "pendulum"}},
    "connections": [],
}
CONSTANT = {**PLAYED, "stimuli": {"hand.torque": {"constant": 0.01}}}
LOW, HIGH = {"name": "low", "set": {"hand.angle_start": 0.1}}, {"name": "high", "set": {"motor.inductance": 0.1}}


def scenario(folder: Path, **more: Any) -> Path:
    document = {
        "title": "A motor turns a hand",
        "components": COMPONENTS,
        "connections": WIRES,
        "run": {"stop": 0.5, "step": 0.01},
        "expect": [{"signal": "hand.angle", "below": 3}],
    } | more
    folder.mkdir(exist_ok=True)
    (folder / "turn.yaml").write_text(json.dumps(document))
    (folder / "stair.csv").write_text(STAIR)
    return folder / "turn.yaml"


def same(one: ScenarioResult, other: ScenarioResult) -> None:
    assert [case.name for case in one.cases] == [case.name for case in other.cases]
    for case, again in zip(one.cases, other.cases, strict=True):
        assert case.result is not None and again.result is not None
        assert case.result.trace == again.result.trace
        assert [check.text for check in case.checks] == [check.text for check in again.checks]


@pytest.mark.slow
@pytest.mark.parametrize(
    "more",
    [
        {},
        PLAYED,
        CONSTANT,
        {"record": ["hand.angle", "motor.current"]},
        {"cases": [LOW, HIGH]},
        {"run": {"stop": "10/3", "step": "1/300", "order": "jacobi"}},
        {"connections": [*WIRES[:1], *WIRES[2:]], "stimuli": {"motor.speed": {"constant": "60 rpm"}}},
        {"recorder": {"signals": {"angle": "hand.angle"}, "every": 0.05}},
    ],
    ids=["plain", "recording", "constant", "record", "cases", "exact times", "unit", "recorder"],
)
def test_an_ssp_and_the_folder_that_it_is_unpacked_to_run_as_the_scenario_does(
    tmp_path: Path, more: dict[str, Any]
) -> None:
    file = scenario(tmp_path / "own", **more)
    export(file, tmp_path / "turn.ssp")
    expected = run_scenario(file)
    assert check(tmp_path / "turn.ssp").problems == ()
    same(run_scenario(tmp_path / "turn.ssp"), expected)
    same(run_scenario(unpack(tmp_path / "turn.ssp", tmp_path / "again")), expected)


def test_what_went_out_and_in_goes_out_as_it_did_before(tmp_path: Path) -> None:
    file = scenario(tmp_path / "own", **PLAYED)
    export(file, tmp_path / "turn.ssp")
    again = unpack(tmp_path / "turn.ssp", tmp_path / "again")
    export(again, tmp_path / "turn2.ssp")
    export(tmp_path / "turn.ssp", tmp_path / "turn3.ssp")
    with zipfile.ZipFile(tmp_path / "turn.ssp") as first:
        for name in ("turn2.ssp", "turn3.ssp"):
            with zipfile.ZipFile(tmp_path / name) as second:
                assert {one: first.read(one) for one in first.namelist() if "scenario" not in one} == {
                    one: second.read(one).replace(name[:5].encode(), b"turn")
                    for one in second.namelist()
                    if "scenario" not in one
                }


@pytest.mark.slow
def test_an_ssp_can_be_included_and_its_values_changed(tmp_path: Path) -> None:
    file = scenario(tmp_path / "own")
    export(file, tmp_path / "own" / "turn.ssp")
    changed = scenario(tmp_path / "other", components=COMPONENTS | {"hand": {"model": "pendulum"}})
    document = {
        "title": "included",
        "include": ["turn.ssp"],
        "components": {"hand": {"parameters": {"angle_start": 0.0}}},
        "run": {"stop": 0.5, "step": 0.01},
    }
    (tmp_path / "own" / "with.yaml").write_text(json.dumps(document))
    found, expected = (run_scenario(one).cases[0].result for one in (tmp_path / "own" / "with.yaml", changed))
    assert found is not None and expected is not None
    assert found.trace == expected.trace


def test_what_another_tool_changes_in_the_description_counts(tmp_path: Path) -> None:
    export(scenario(tmp_path / "own", **CONSTANT), tmp_path / "turn.ssp")
    with zipfile.ZipFile(tmp_path / "turn.ssp") as read, zipfile.ZipFile(tmp_path / "new.ssp", "w") as made:
        for name in read.namelist():
            content = read.read(name).replace(b'stopTime="0.5"', b'stopTime="0.25"')
            made.writestr(name, content.replace(b'<ssv:Real value="0.01"', b'<ssv:Real value="0.02"'))
    other = {"stimuli": {"hand.torque": {"constant": 0.02}}, "run": {"stop": 0.25, "step": 0.01}}
    changed = scenario(tmp_path / "own", **CONSTANT | other)
    same(run_scenario(tmp_path / "new.ssp"), run_scenario(changed))


@pytest.mark.slow
def test_nothing_is_written_where_the_scenario_does_not_fit(tmp_path: Path) -> None:
    file = scenario(tmp_path / "own", connections=["hand.sped -> motor.speed"])
    with pytest.raises(WiringError, match="did you mean 'speed'"):
        export(file, tmp_path / "turn.ssp")
    assert not (tmp_path / "turn.ssp").exists()


@pytest.mark.slow
def test_a_file_that_is_there_is_not_written_over(tmp_path: Path) -> None:
    export(scenario(tmp_path / "own"), tmp_path / "turn.ssp")
    unpack(tmp_path / "turn.ssp", tmp_path / "again")
    with pytest.raises(InputError, match="is there already"):
        unpack(tmp_path / "turn.ssp", tmp_path / "again")


def test_annotations_of_other_tools_go_along_both_ways(tmp_path: Path) -> None:
    def noted(what: str) -> str:
        inside = f'<v:Color xmlns:v="urn:vendor" of="{what}"><v:Deep/></v:Color>'
        return f'<ssd:Annotations><ssc:Annotation type="com.vendor">{inside}</ssc:Annotation></ssd:Annotations>'

    inner = system([component("w", inner=noted("w"))], name="m")
    described = ssps.described(system([component("a", inner=noted("a")), inner], after=noted("top")))
    described = described.replace("</ssd:SystemStr", f"{noted('all')}</ssd:SystemStr")
    foreign = archive(tmp_path / "foreign.ssp", described)
    export(foreign, tmp_path / "direct.ssp")
    export(unpack(foreign, tmp_path / "out"), tmp_path / "by_folder.ssp")
    for name in ("direct.ssp", "by_folder.ssp"):
        assert check(tmp_path / name).problems == ()
        with zipfile.ZipFile(tmp_path / name) as made:
            text = made.read("SystemStructure.ssd").decode()
        root = ElementTree.fromstring(text)
        owners = {
            child.get("of"): owner.get("name")
            for owner in root.iter()
            for child in owner.findall("{*}Annotations/{*}Annotation/{urn:vendor}Color")
        }
        assert owners == {"all": root.get("name"), "top": root.get("name"), "a": "a", "w": "m__w"}
        assert text.count("Deep") == 4


def test_annotations_of_what_has_no_place_of_its_own_go_to_its_component_or_the_system(tmp_path: Path) -> None:
    def noted(what: str, prefix: str = "ssd") -> str:
        inside = f'<ssc:Annotation type="com.vendor"><v:Color xmlns:v="urn:vendor" of="{what}"/></ssc:Annotation>'
        return f"<{prefix}:Annotations>{inside}</{prefix}:Annotations>"

    def bound(source: str) -> str:
        mapped = f'<ssd:ParameterMapping source="{source}.ssm"/>'
        binding = f'<ssd:ParameterBinding source="{source}.ssv">{mapped}</ssd:ParameterBinding>'
        return f"<ssd:ParameterBindings>{binding}</ssd:ParameterBindings>"

    one = component("a", inner=bound("own")).replace("<ssc:Real/></ssd:C", f"<ssc:Real/>{noted('u')}</ssd:C", 1)
    outer = '<ssd:Component name="{}" type="application/x-ssp-{}" source="{}"/>'
    elements = [
        one,
        component("b"),
        outer.format("m", "definition", "more/m.ssd"),
        outer.format("p", "package", "p.ssp"),
    ]
    link = ssps.connection("a.y", "b.u").replace("</ssd:", f"{noted('link')}</ssd:")
    mapping = '<ssm:MappingEntry source="x" target="k"/>' + noted("mapping", "ssm")
    archive(tmp_path / "p.ssp", system([component("g", inner=noted("packed"))], name="q", after=noted("inner")))
    files: dict[str, Path | str] = {
        "resources/gain.fmu": ssps.gain(),
        "p.ssp": tmp_path / "p.ssp",
        "more/m.ssd": ssps.described(system([component("g", "../resources/gain.fmu", noted("included"))], name="n")),
        "own.ssv": ssps.values({"x": ssps.real(3)}, noted("set", "ssv")),
        "own.ssm": f'<ssm:ParameterMapping {ssps.XMLNS} version="1.0">{mapping}</ssm:ParameterMapping>',
    }
    foreign = archive(tmp_path / "foreign.ssp", system(elements, [link], name="top"), files)
    export(foreign, tmp_path / "direct.ssp")
    export(unpack(foreign, tmp_path / "out"), tmp_path / "by_folder.ssp")
    for name in ("direct.ssp", "by_folder.ssp"):
        assert check(tmp_path / name).problems == ()
        with zipfile.ZipFile(tmp_path / name) as made:
            root = ElementTree.fromstring(made.read("SystemStructure.ssd"))
        owners: dict[str | None, set[str | None]] = {}
        for owner in root.iter():
            for child in owner.findall("{*}Annotations/{*}Annotation/{urn:vendor}Color"):
                owners.setdefault(owner.get("name"), set()).add(child.get("of"))
        whole = {root.get("name"): {"link", "inner"}}
        assert owners == whole | {"a": {"u", "set", "mapping"}, "m__g": {"included"}, "p__g": {"packed"}}


def fmi3(folder: Path, fmu: Path, connections: list[str], **components: dict[str, Any]) -> Path:
    """A scenario of instances of an FMU, with these values."""
    document = {
        "title": "FMI 3.0",
        "components": {name: {"fmu": str(fmu), "parameters": values} for name, values in components.items()},
        "connections": connections,
        "run": {"stop": 4, "step": 1},
    }
    (folder / "fmi3.yaml").write_text(json.dumps(document))
    return folder / "fmi3.yaml"


def described(ssp: Path) -> ElementTree.Element:
    return ElementTree.fromstring(zipfile.ZipFile(ssp).read("SystemStructure.ssd"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "more", [{}, PLAYED, CONSTANT, {"record": ["hand.angle"]}], ids=["plain", "file", "set", "one"]
)
def test_an_ssp_of_version_2_runs_as_the_scenario_does(tmp_path: Path, more: dict[str, Any]) -> None:
    file = scenario(tmp_path / "own", **more)
    export(file, tmp_path / "turn.ssp", version=Version.TWO)
    found = check(tmp_path / "turn.ssp")
    assert (found.version, found.problems) == ("2.0", ())
    same(run_scenario(tmp_path / "turn.ssp"), run_scenario(file))
    same(run_scenario(unpack(tmp_path / "turn.ssp", tmp_path / "again")), run_scenario(file))


def test_version_2_has_the_types_and_arrays_of_fmi_3(tmp_path: Path) -> None:
    whole = fmi3(
        tmp_path,
        reference(3, "StateSpace"),
        ["a.y -> b.u"],
        a={"A": [[-1, 0, 1], [2, -3, 0], [0, 0, -1]], "u[2]": 0.5},
        b={"A": [[-1, 0, 0], [0, -1, 0], [0, 0, -1]]},
    )
    export(whole, tmp_path / "s.ssp", version=Version.TWO)
    assert check(tmp_path / "s.ssp").problems == ()
    same(run_scenario(tmp_path / "s.ssp"), run_scenario(whole))
    root = described(tmp_path / "s.ssp")
    (link,) = root.iter(f"{{{NAMESPACES['ssd']}}}Connection")
    ends = {"startElement": "a", "startConnector": "y", "endElement": "b", "endConnector": "u"}
    assert link.attrib == ends
    kinds = {one.get("name"): one for one in root.iter(f"{{{NAMESPACES['ssd']}}}Connector")}
    sizes = [size.get("size") for size in kinds["A"].iter(f"{{{NAMESPACES['ssc']}}}Dimension")]
    assert sizes == ["3", "3"] and kinds["A"].find(f"{{{NAMESPACES['ssc']}}}Float64") is not None
    assert kinds["m"].get("kind") == "structuralParameter"
    assert imported(tmp_path / "s.ssp").document["components"]["a"]["parameters"] == {
        "A": [[-1.0, 0.0, 1.0], [2.0, -3.0, 0.0], [0.0, 0.0, -1.0]],
        "u": [1.0, 0.5, 3.0],
    }


@pytest.mark.parametrize("version", list(Version))
def test_arrays_of_other_sizes_than_the_fmu_has_go_both_ways(tmp_path: Path, version: Version) -> None:
    sized = {"m": 3, "gain": [[1, 0, 0], [0, 2, 0], [0, 0, 3]], "u": [1, 1, 5]}
    file = fmi3(tmp_path, arrays.build(tmp_path), ["a.y[3] -> b.u[2]"], a=sized, b={})
    document = json.loads(file.read_text()) | {"record": ["a.y", "a.y[3]", "b.y[2]"]}
    file.write_text(json.dumps(document))
    export(file, tmp_path / "s.ssp", version=version)
    assert check(tmp_path / "s.ssp").problems == ()
    for one in (file, tmp_path / "s.ssp", unpack(tmp_path / "s.ssp", tmp_path / "again")):
        trace = run_scenario(one).cases[0].trace
        assert [trace[name][-1] for name in ("a.y[1]", "a.y[2]", "a.y[3]", "b.y[2]")] == [1, 2, 15, 15]


def test_version_2_connects_elements_of_arrays_by_their_indices(tmp_path: Path) -> None:
    crossed = ["a.y[1] -> b.u[3]", "2 * a.y[2] -> b.u[2]", "a.y[3] -> b.u[1]"]
    file = fmi3(tmp_path, reference(3, "StateSpace"), crossed, a={}, b={})
    export(file, tmp_path / "s.ssp", version=Version.TWO)
    assert check(tmp_path / "s.ssp").problems == ()
    links = [*described(tmp_path / "s.ssp").iter(f"{{{NAMESPACES['ssd']}}}Connection")]
    assert [(link.get("startIndices"), link.get("endIndices")) for link in links] == [
        ("1", "3"),
        ("2", "2"),
        ("3", "1"),
    ]
    same(run_scenario(tmp_path / "s.ssp"), run_scenario(file))


def test_version_2_keeps_every_scalar_type(tmp_path: Path) -> None:
    values = {"Int8_input": -8, "UInt64_input": 2**60, "Float32_continuous_input": 0.5, "Boolean_input": True}
    values |= {"String_input": "Set me!", "Enumeration_input": 2}
    chained = ["a.Int32_output -> b.Int32_input", "a.Float64_continuous_output -> b.Float64_continuous_input"]
    file = fmi3(tmp_path, reference(3, "Feedthrough"), chained, a=values, b={})
    export(file, tmp_path / "f.ssp", version=Version.TWO)
    assert check(tmp_path / "f.ssp").problems == ()
    root = described(tmp_path / "f.ssp")
    written = {
        one.get("name"): str(one[0].tag).rpartition("}")[2]
        for one in root.iter(f"{{{NAMESPACES['ssd']}}}Connector")
        if len(one)
    }
    ports = FmuDescription(reference(3, "Feedthrough")).interface.ports
    assert {"Int8", "UInt64", "Float32", "Boolean", "Float64", "String", "Enumeration"} <= set(written.values())
    assert all(kind in (ports[name].type, "Enumeration") for name, kind in written.items() if name in ports)
    same(run_scenario(tmp_path / "f.ssp"), run_scenario(file))
    assert FmuDescription(reference(3, "Feedthrough")).interface.ports["UInt64_input"].type == "UInt64"
    found = imported(tmp_path / "f.ssp").document["components"]["a"]["parameters"]
    assert found["UInt64_input"] == 2**60 and found["String_input"] == "Set me!"


def test_a_tool_that_is_known_with_version_1_gets_no_other(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--ssp-version 2\.0.*ecos.*1\.0 only.*leave out --for"):
        export(scenario(tmp_path / "own"), tmp_path / "t.ssp", Tool.ECOS, Version.TWO)
    assert not (tmp_path / "t.ssp").exists()


@pytest.mark.slow
@pytest.mark.parametrize("version", list(Version))
def test_what_is_not_as_its_version_has_it_is_told(tmp_path: Path, version: Version) -> None:
    export(scenario(tmp_path / "own"), tmp_path / "turn.ssp", version=version)
    with zipfile.ZipFile(tmp_path / "turn.ssp") as read, zipfile.ZipFile(tmp_path / "bad.ssp", "w") as made:
        for name in read.namelist():
            made.writestr(name, read.read(name).replace(b'kind="output"', b'kind="outlet"', 1))
    (problem,) = check(tmp_path / "bad.ssp").problems[:1]
    assert "outlet" in problem.problem


@pytest.mark.parametrize("version", list(Version))
def test_clocks_go_out_and_come_back(tmp_path: Path, version: Version) -> None:
    kinds = {"tick": 'intervalVariability="constant" resolution="3" intervalCounter="1" shiftCounter="2"'}
    kinds |= {name: clocks.CLOCKS[name] for name in ("out", "trigger", "countdown")}
    file = fmi3(tmp_path, clocks.build(tmp_path, kinds), ["a.out -> b.trigger", "a.last_time -> b.w"], a={}, b={})
    done = export(file, tmp_path / "c.ssp", version=version)
    assert done.connections == 2
    assert check(tmp_path / "c.ssp").problems == ()
    assert any("SSP 1.0 knows no clocks" in note for note in done.notes) == (version is Version.ONE)
    assert "a.out -> b.trigger" in imported(tmp_path / "c.ssp").document["connections"]
    same(run_scenario(tmp_path / "c.ssp"), run_scenario(file))
    result = run_scenario(tmp_path / "c.ssp").cases[0].result
    assert result is not None and result.trace["b.n_trigger"][-1] > 0
    if version is Version.TWO:
        found = {one.get("name"): one[0].attrib for one in described(tmp_path / "c.ssp").iter() if len(one)}
        assert found["tick"] == {
            "intervalVariability": "constant", "resolution": "3", "intervalCounter": "1", "shiftCounter": "2"
        }  # fmt: skip
