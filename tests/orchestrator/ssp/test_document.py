"""SSPs of other tools do what the standard says: names, values, units and connections of all levels."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest

from fmus.errors import InputError, ScenarioError, WiringError
from orchestrator.scenario.run import run_scenario
from orchestrator.ssp.document import imported
from tests.support.simulation.ssps import (
    NAMESPACES,
    XMLNS,
    archive,
    bindings,
    component,
    connection,
    connectors,
    described,
    gain,
    real,
    system,
    values,
)
from tests.support.tools.third_party import reference

HZ = '<ssc:Unit name="turns"><ssc:BaseUnit s="-1" rad="1" factor="6.283185307179586"/></ssc:Unit>'
INTEGER = '<ssv:Integer value="0"/>'
LINEAR = '<ssc:LinearTransformation factor="3" offset="0.5"/>'


def parameters(path: Path) -> dict[str, Any]:
    """component.variable -> value of the system in an SSP."""
    components = imported(path).document["components"]
    return {f"{n}.{key}": value for n, one in components.items() for key, value in one.get("parameters", {}).items()}


def last(path: Path) -> dict[str, float]:
    """What the run of an SSP ends with."""
    result = run_scenario(path).cases[0].result
    assert result is not None
    return {name: float(result.trace[name][-1]) for name in result.trace.names}


def test_a_chain_gives_the_product_of_its_gains(tmp_path: Path) -> None:
    chain = [connection("a.y", "b.u"), connection("b.y", "c.u")]
    path = archive(tmp_path / "chain.ssp", system(map(component, "abc"), chain))
    assert last(path) == {"a.y": 2.0, "b.y": 4.0, "c.y": 8.0}


@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("prefix", ["ssd", "", "other"])
def test_prefixes_and_versions_make_no_difference(tmp_path: Path, version: str, prefix: str) -> None:
    plain = archive(tmp_path / "one.ssp", system(map(component, "ab"), [connection("a.y", "b.u")]))
    text = ZipFile(plain).read("SystemStructure.ssd").decode()
    colon = f"{prefix}:" if prefix else ""
    text = text.replace("<ssd:", f"<{colon}").replace("</ssd:", f"</{colon}")
    uri = NAMESPACES["ssd"]
    text = text.replace(f'xmlns:ssd="{uri}"', f'xmlns{":" if prefix else ""}{prefix}="{uri}"')
    text = text.replace('version="1.0"', f'version="{version}"')
    assert last(archive(tmp_path / "other.ssp", text)) == {"a.y": 2.0, "b.y": 4.0}


def nested(inner: str = "", outer: str = "", outermost: str = "") -> str:
    """wheel within middle within top, its input and gain led outwards."""
    wheel = component("wheel", inner=inner)
    inside = system(
        [wheel],
        [connection("in", "wheel.u"), connection("wheel.y", "out"), connection("factor", "wheel.k")],
        "middle",
        connectors(**{"in": "input", "out": "output", "factor": "parameter"}) + outer,
    )
    ends = [connection("u", "middle.in"), connection("middle.out", "y")]
    return system([inside], ends, before=connectors(u="input", y="output") + outermost)


def test_names_of_nested_components_can_be_traced_back(tmp_path: Path) -> None:
    twins = system([component("x.y"), system([component("wheel")], name="x"), component("x__wheel")])
    found = imported(archive(tmp_path / "twins.ssp", twins))
    assert found.names == {"x_y": "x.y", "x__wheel": "x.wheel", "x__wheel_2": "x__wheel"}
    assert set(found.document["components"]) == set(found.names)


@pytest.mark.parametrize(
    ("sets", "expected"),
    [
        (("", "", ""), {}),
        ((bindings(values({"k": real(5)})), "", ""), {"middle__wheel.k": 5.0}),
        ((bindings(values({"k": real(5)})), bindings(values({"wheel.k": real(6)})), ""), {"middle__wheel.k": 6.0}),
        (
            (
                bindings(values({"k": real(5)})),
                bindings(values({"wheel.k": real(6)})),
                bindings(values({"middle.wheel.k": real(7)})),
            ),
            {"middle__wheel.k": 7.0},
        ),
        ((bindings(values({"k": real(5)})), bindings(values({"factor": real(8)})), ""), {"middle__wheel.k": 8.0}),
        (
            ("", bindings(values({"factor": real(8)})), bindings(values({"middle.factor": real(9)}))),
            {"middle__wheel.k": 9.0},
        ),
        (
            ("", "", bindings(values({"middle.factor": real(1)}), values({"middle.factor": real(2)}))),
            {"middle__wheel.k": 2.0},
        ),
    ],
    ids=["none", "component", "system over component", "outermost", "connector over value", "outer connector", "later"],
)
def test_what_stands_farther_out_counts(tmp_path: Path, sets: tuple[str, str, str], expected: dict[str, float]) -> None:
    assert parameters(archive(tmp_path / "n.ssp", nested(*sets))) == expected


def test_inputs_of_the_system_are_stimuli_and_its_outputs_are_recorded(tmp_path: Path) -> None:
    path = archive(tmp_path / "n.ssp", nested(outermost=bindings(values({"u": real(4)}))))
    document = imported(path).document
    assert document["stimuli"] == {"middle__wheel.u": {"constant": 4.0}}
    assert document["record"] == ["middle__wheel.y"]
    assert last(path) == {"middle__wheel.y": 8.0}


def test_values_of_all_types_arrive(tmp_path: Path) -> None:
    given = {
        "b": real(0.5),
        "n": '<ssv:Integer value="7"/>',
        "on": '<ssv:Boolean value="false"/>',
        "mode": '<ssv:Enumeration value="fast"/>',
    }
    path = archive(tmp_path / "v.ssp", system([component("a", inner=bindings(values(given)))]))
    assert parameters(path) == {"a.b": 0.5, "a.n": 7, "a.on": False, "a.mode": "fast"}
    assert last(path) == {"a.y": 2.5}


def test_sets_and_mappings_in_files_and_prefixes_are_taken(tmp_path: Path) -> None:
    mapping = f"""<ssm:ParameterMapping {XMLNS} version="1.0">
        <ssm:MappingEntry source="a.stiffness" target="a.k">{LINEAR}</ssm:MappingEntry>
        <ssm:MappingEntry source="a.more" target="a.b"/>
        <ssm:MappingEntry source="a.stiffness" target="a.b"/>
        <ssm:MappingEntry source="a.gone" target="a.n"/></ssm:ParameterMapping>"""
    bound = """<ssd:ParameterBindings><ssd:ParameterBinding source="resources/sets/p%20q.ssv" prefix="a.">
        <ssd:ParameterMapping source="resources/m.ssm"/></ssd:ParameterBinding></ssd:ParameterBindings>"""
    files = {
        "resources/gain.fmu": gain(),
        "resources/sets/p q.ssv": values({"stiffness": real(2), "more": real(9), "unused": real(1)}),
        "resources/m.ssm": mapping,
    }
    found = imported(archive(tmp_path / "m.ssp", system([component("a")], before=bound), files))
    assert found.document["components"]["a"]["parameters"] == {"k": 6.5, "b": 2.0}
    said = " ".join(found.notes)
    assert "'a.gone', which is not in the set" in said and "'a.unused' is not mapped" in said
    assert "'a.b' is mapped twice, 'a.stiffness' counts, not 'a.more'" in said


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("n", real(2.5), "n: is of type Integer, 2.5 is not whole; give a whole number"),
        ("n", '<ssv:Integer value="4294967296"/>', "n: 4294967296 does not fit into Integer"),
        ("mode", '<ssv:Enumeration value="quick"/>', r"mode: cannot be 'quick'; give slow \(1\), fast \(2\)"),
        ("on", '<ssv:Integer value="2"/>', "on: is a Boolean, not 2; give true or false"),
    ],
)
def test_a_value_of_a_set_that_does_not_fit_is_refused_at_import_by_the_file_of_the_set(
    tmp_path: Path, name: str, value: str, said: str
) -> None:
    bound = '<ssd:ParameterBindings><ssd:ParameterBinding source="resources/s.ssv"/></ssd:ParameterBindings>'
    files = {"resources/gain.fmu": gain(), "resources/s.ssv": values({name: value})}
    with pytest.raises(InputError, match=rf"m\.ssp: resources/s\.ssv: {said}"):
        imported(archive(tmp_path / "m.ssp", system([component("a", inner=bound)]), files))


def test_items_and_texts_of_an_array_are_elements_of_their_own(tmp_path: Path) -> None:
    def given(value: str) -> Path:
        two = f'{value}<ssc:Dimension size="2"/>'
        whole = system([component("a")], after=bindings(values({"a.mode": two})))
        return archive(tmp_path / "a.ssp", whole, version="2.0")

    for kind in ("Enumeration", "String"):
        said = rf"a\.mode: has 1 values for 2 elements; give each as a `Value` within `{kind}`"
        with pytest.raises(InputError, match=said):
            imported(given(f'<ssv:{kind} value="fast slow"/>'))
    each = '<ssv:Enumeration><ssv:Value value="fast"/><ssv:Value value="slow"/></ssv:Enumeration>'
    assert parameters(given(each)) == {"a.mode": ["fast", "slow"]}
    with pytest.raises(InputError, match=r"a\.mode: is a Binary, which cannot be set; remove it"):
        imported(given('<ssv:Binary value="00"/>'))


def test_a_name_that_matches_nothing_is_told(tmp_path: Path) -> None:
    bound = bindings(values({"a.kk": real(1), "c.k": real(1), "a.k": real(4)}))
    found = imported(archive(tmp_path / "m.ssp", system([component("a")], before=bound)))
    assert [note for note in found.notes if "'a.kk' matches nothing" in note]
    assert [note for note in found.notes if "'c.k' matches nothing" in note]
    assert found.document["components"]["a"]["parameters"] == {"k": 4.0}


def test_a_unit_that_is_not_known_is_told_where_it_is_taken_for_another(tmp_path: Path) -> None:
    bound = bindings(values({"a.b": real(7, "blubb")}))
    model = {"resources/gain.fmu": gain("V")}
    found = imported(archive(tmp_path / "m.ssp", system([component("a")], before=bound), model))
    assert found.document["components"]["a"]["parameters"] == {"b": 7.0}
    assert [note for note in found.notes if note.endswith("a.b: blubb is taken for V as it is, by factor 1")]


def test_a_unit_of_a_connector_that_is_not_known_is_told(tmp_path: Path) -> None:
    inside = system([component("w")], [connection("in", "w.u")], "m", connectors(**{"in": "input"}))
    inside = inside.replace('kind="input"><ssc:Real/>', 'kind="input"><ssc:Real unit="blubb"/>', 1)
    model = {"resources/gain.fmu": gain("V")}
    path = archive(tmp_path / "m.ssp", system([component("a"), inside], [connection("a.y", "m.in")]), model)
    notes = imported(path).notes
    assert [note for note in notes if "a.y -> m.in: V is taken for blubb as it is" in note]
    assert [note for note in notes if "in -> w.u: blubb is taken for V as it is" in note]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('name="y" kind="output"', 'name="y" kind="input"', "a.y: is said to be an input, and is an output of its FMU"),
        ('name="k" kind="parameter"', 'name="k" kind="input"', "a.k: is said to be an input, and is a parameter of"),
        ('name="k"', 'name="other"', "a.other: is no variable of its FMU"),
        ("<ssc:Real/>", "<ssc:Boolean/>", "a.u: is said to be a Boolean, and is a Real of its FMU"),
        (
            "<ssc:Real/>",
            '<ssc:Real/><ssc:Dimension size="3"/>',
            "a.u: is said to be of 3 elements, and is a scalar in its FMU",
        ),
    ],
)
def test_connectors_that_are_other_than_their_variables_are_told(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in component("a")
    notes = imported(archive(tmp_path / "c.ssp", system([component("a").replace(old, new, 1)]))).notes
    assert [note for note in notes if note.startswith(said)]
    assert not [note for note in imported(archive(tmp_path / "d.ssp", system([component("a")]))).notes if "a." in note]


def test_a_system_that_does_not_say_when_it_ends_needs_a_scenario(tmp_path: Path) -> None:
    path = archive(tmp_path / "c.ssp", system([component("a")]))
    text = ZipFile(path).read("SystemStructure.ssd").decode().replace(' stopTime="1"', "")
    archive(path, text)
    with pytest.raises(
        ScenarioError, match=r"c\.ssp: has no default experiment with a stop time; .*`include: \[c\.ssp\]`"
    ):
        run_scenario(path)
    (tmp_path / "c.yaml").write_text("title: c\ninclude: [c.ssp]\nrun: {stop: 1, step: 0.1}\n")
    assert run_scenario(tmp_path / "c.yaml").cases[0].trace["a.y"][-1] == 2.0


def test_values_are_converted_to_the_unit_of_their_variable(tmp_path: Path) -> None:
    units = f"<ssv:Units>{HZ}</ssv:Units>"
    inner = bindings(values({"b": real(0.5, "turns"), "u": real(30, "rpm")}, units))
    path = archive(tmp_path / "u.ssp", system([component("a", inner=inner)]), {"resources/gain.fmu": gain("rad/s")})
    found = parameters(path)
    assert found == {"a.b": pytest.approx(np.pi), "a.u": pytest.approx(np.pi)}


@pytest.mark.parametrize(
    ("inner", "more", "factor", "offset"),
    [
        ("", "", np.pi / 30, 0.0),
        (LINEAR, "", 3 * np.pi / 30, 0.5),
        ("", 'suppressUnitConversion="true"', 1.0, 0.0),
        (LINEAR, 'suppressUnitConversion="true"', 3.0, 0.5),
    ],
)
def test_a_transformation_comes_on_top_of_units_or_instead(
    tmp_path: Path, inner: str, more: str, factor: float, offset: float
) -> None:
    both = [component("a", "resources/rpm.fmu"), component("b", "resources/si.fmu")]
    files = {"resources/rpm.fmu": gain("1", "rpm"), "resources/si.fmu": gain("rad/s")}
    path = archive(tmp_path / "t.ssp", system(both, [connection("a.y", "b.u", inner, more)]), files)
    assert last(path)["b.y"] == pytest.approx(2 * (factor * 2.0 + offset))


def test_units_of_connectors_count_where_the_variables_have_none(tmp_path: Path) -> None:
    both = [component("a", units=' unit="rpm"'), component("b", units=' unit="rad/s"')]
    model = {"resources/gain.fmu": gain("")}
    path = archive(tmp_path / "t.ssp", system(both, [connection("a.y", "b.u")]), model)
    assert last(path)["b.y"] == pytest.approx(4 * np.pi / 30)


def test_a_transformation_on_each_of_two_levels_is_done_twice(tmp_path: Path) -> None:
    inside = system([component("w")], [connection("in", "w.u", LINEAR)], "m", connectors(**{"in": "input"}))
    path = archive(tmp_path / "t.ssp", system([component("a"), inside], [connection("a.y", "m.in", LINEAR)]))
    assert last(path)["m__w.y"] == 2 * (3 * (3 * 2 + 0.5) + 0.5)


def test_a_signal_dictionary_joins_what_refers_to_it(tmp_path: Path) -> None:
    entries = (
        f'<ssb:SignalDictionary {XMLNS} version="1.0"><ssb:DictionaryEntry name="s"><ssc:Real/></ssb:DictionaryEntry>'
    )
    dictionary = f"""<ssd:SignalDictionaries><ssd:SignalDictionary name="bus">{entries}</ssb:SignalDictionary>
        </ssd:SignalDictionary></ssd:SignalDictionaries>"""
    reference = '<ssd:SignalDictionaryReference name="{0}" dictionary="bus">{1}</ssd:SignalDictionaryReference>'
    inside = system([component("w"), reference.format("in", connectors(s="inout"))], [connection("in.s", "w.u")], "m")
    outside = [component("a"), inside, reference.format("out", connectors(s="inout"))]
    path = archive(tmp_path / "d.ssp", system(outside, [connection("a.y", "out.s")], after=dictionary))
    assert imported(path).document["connections"] == ["a.y -> m__w.u"]


def test_systems_in_files_of_their_own_are_taken_in(tmp_path: Path) -> None:
    inner = archive(
        tmp_path / "inner.ssp",
        system([component("w")], [connection("in", "w.u")], before=connectors(**{"in": "input"})),
    )
    ports = connectors(**{"in": "input"})
    outer = f"""<ssd:Component name="m" type="application/x-ssp-package" source="resources/inner.ssp">{ports}
        {bindings(values({"w.k": real(5)}))}</ssd:Component>"""
    files = {"resources/gain.fmu": gain(), "resources/inner.ssp": inner}
    path = archive(tmp_path / "o.ssp", system([component("a"), outer], [connection("a.y", "m.in")]), files)
    assert last(path) == {"a.y": 2.0, "m__w.y": 10.0}


def test_a_step_that_another_tool_has_noted_is_taken(tmp_path: Path) -> None:
    noted = """<ssd:Annotations><ssc:Annotation type="org.openmodelica"><oms:Annotations xmlns:oms="urn:oms">
        <oms:SimulationInformation><oms:FixedStepMaster description="oms-ma" stepSize="0.25"/>
        </oms:SimulationInformation></oms:Annotations></ssc:Annotation></ssd:Annotations>"""
    found = imported(archive(tmp_path / "s.ssp", system([component("a")], after=noted)))
    assert found.document["run"] == {"stop": "1", "step": "0.25"}
    assert not [note for note in found.notes if "step" in note]


def test_a_step_that_is_chosen_is_told(tmp_path: Path) -> None:
    found = imported(archive(tmp_path / "s.ssp", system([component("a")])))
    assert found.document["run"]["step"] == "0.01" and any("0.01 s is the least" in note for note in found.notes)


@pytest.mark.parametrize(
    ("links", "problem"),
    [
        ([connection("a.y", "b.uu")], "has no variable 'uu'.*did you mean 'u'"),
        ([connection("a.y", "c.u")], "no element 'c'"),
        ([connection("a.y", "b.u"), connection("b.y", "b.u")], "has a source already"),
        ([connection("a.y", "out")], "no connector 'out' of the system"),
        ([connection("a.u", "b.u")], "only an output can be a source"),
    ],
    ids=["variable", "element", "double", "connector", "input"],
)
def test_connections_that_lead_nowhere_are_refused(tmp_path: Path, links: list[str], problem: str) -> None:
    path = archive(tmp_path / "x.ssp", system(map(component, "ab"), links))
    with pytest.raises(WiringError, match=problem) as refused:
        run_scenario(path)
    assert str(path) in str(refused.value)


def test_connectors_that_run_in_a_circle_are_refused(tmp_path: Path) -> None:
    ports = connectors(p="inout", q="inout")
    looped = [connection("p", "q"), connection("p", "w.u")]
    rings = [system([component("w")], looped, name, ports) for name in "mn"]
    path = archive(tmp_path / "x.ssp", system(rings, [connection("m.q", "n.p"), connection("n.q", "m.p")]))
    with pytest.raises(WiringError, match="circle of connectors"):
        imported(path)


def test_units_in_contradiction_are_refused(tmp_path: Path) -> None:
    both = [component("a", "resources/m.fmu"), component("b", "resources/s.fmu")]
    files = {"resources/m.fmu": gain("m"), "resources/s.fmu": gain("s")}
    with pytest.raises(WiringError, match="m does not fit s"):
        imported(archive(tmp_path / "x.ssp", system(both, [connection("a.y", "b.u")]), files))


FLIPPED = [("true", "false"), ("false", "true")]


def table(kind: str, entries: list[tuple[str, str]]) -> str:
    rows = "".join(f'<ssc:MapEntry source="{one}" target="{other}"/>' for one, other in entries)
    return f"<ssc:{kind}MappingTransformation>{rows}</ssc:{kind}MappingTransformation>"


def fed(folder: Path, variable: str, inner: str, value: str) -> Path:
    """Two Reference FMUs, of the first the output to the second's input, and what the first is given."""
    files = {"resources/f.fmu": reference(2, "Feedthrough")}
    one, two = (
        f'<ssd:Component name="{name}" source="resources/f.fmu">{more}</ssd:Component>'
        for name, more in {"a": bindings(values({f"{variable}_input": value})), "b": ""}.items()
    )
    links = [connection(f"a.{variable}_output", f"b.{variable}_input", inner)]
    return archive(folder / "fed.ssp", system([one, two], links), files)


@pytest.mark.parametrize("on", ["true", "false"])
def test_a_table_of_truths_flips_a_signal(tmp_path: Path, on: str) -> None:
    path = fed(tmp_path, "Boolean", table("Boolean", FLIPPED), f'<ssv:Boolean value="{on}"/>')
    assert last(path)["b.Boolean_output"] == (on == "false")


def test_a_table_of_whole_numbers_is_a_line_through_them_and_that_is_told(tmp_path: Path) -> None:
    path = fed(tmp_path, "Int32", table("Integer", [("0", "10"), ("1", "20"), ("3", "40")]), '<ssv:Integer value="3"/>')
    assert last(path)["b.Int32_output"] == 40
    assert any("values without an entry" in note for note in imported(path).notes)


@pytest.mark.parametrize(
    ("variable", "inner", "problem"),
    [
        ("Int32", table("Integer", [("0", "1"), ("1", "4"), ("2", "9")]), "no factor and offset do"),
        ("Int32", table("Integer", [("0", "one")]), "'one', which is no value there"),
    ],
)
def test_a_table_that_no_line_follows_is_refused(tmp_path: Path, variable: str, inner: str, problem: str) -> None:
    with pytest.raises(WiringError, match=problem):
        imported(fed(tmp_path, variable, inner, "<ssv:Boolean value='true'/>" if variable == "Boolean" else INTEGER))


@pytest.mark.parametrize("on", ["true", "false"])
def test_values_without_an_entry_in_a_table_stay_as_they_are(tmp_path: Path, on: str) -> None:
    path = fed(tmp_path, "Boolean", table("Boolean", FLIPPED[:1]), f'<ssv:Boolean value="{on}"/>')
    assert last(path)["b.Boolean_output"] == 0
    mapping = f"""<ssm:ParameterMapping {XMLNS} version="1.0"><ssm:MappingEntry source="gear" target="a.n">
        {table("Integer", [("1", "5")])}</ssm:MappingEntry></ssm:ParameterMapping>"""
    bound = f"""<ssd:ParameterBindings><ssd:ParameterBinding>
        <ssd:ParameterValues>{values({"gear": '<ssv:Integer value="2"/>'})}</ssd:ParameterValues>
        <ssd:ParameterMapping>{mapping}</ssd:ParameterMapping></ssd:ParameterBinding></ssd:ParameterBindings>"""
    assert parameters(archive(tmp_path / "m.ssp", system([component("a")], before=bound))) == {"a.n": 2}


def test_a_mapped_value_goes_through_its_table(tmp_path: Path) -> None:
    mapping = f"""<ssm:ParameterMapping {XMLNS} version="1.0"><ssm:MappingEntry source="gear" target="a.n">
        {table("Integer", [("1", "5"), ("2", "25"), ("3", "-1")])}</ssm:MappingEntry>
        <ssm:MappingEntry source="how" target="a.mode">{table("Enumeration", [("quick", "fast")])}</ssm:MappingEntry>
        <ssm:MappingEntry source="off" target="a.on">{table("Boolean", FLIPPED)}</ssm:MappingEntry>
        </ssm:ParameterMapping>"""
    given = {
        "gear": '<ssv:Integer value="2"/>',
        "how": '<ssv:Enumeration value="quick"/>',
        "off": '<ssv:Boolean value="1"/>',
    }
    bound = f"""<ssd:ParameterBindings><ssd:ParameterBinding><ssd:ParameterValues>{values(given)}</ssd:ParameterValues>
        <ssd:ParameterMapping>{mapping}</ssd:ParameterMapping></ssd:ParameterBinding></ssd:ParameterBindings>"""
    path = archive(tmp_path / "m.ssp", system([component("a")], before=bound))
    assert parameters(path) == {"a.n": 25, "a.mode": "fast", "a.on": False}
    assert last(path) == {"a.y": 2.0}
    wrong = archive(tmp_path / "w.ssp", system([component("a")], before=bound.replace('"25"', '"many"')))
    with pytest.raises(WiringError, match="maps 2 to 'many', no number; correct the mapping"):
        imported(wrong)


@pytest.mark.parametrize(("outer", "expected"), [("deg", math.pi / 2), ("rad", 90.0), ("", 90.0)])
def test_values_for_a_system_in_a_file_are_in_the_units_of_the_component_that_it_is_for(
    tmp_path: Path, outer: str, expected: float
) -> None:
    def connector(unit: str) -> str:
        typed = f'<ssc:Real unit="{unit}"/>' if unit else "<ssc:Real/>"
        return f'<ssd:Connectors><ssd:Connector name="u" kind="input">{typed}</ssd:Connector></ssd:Connectors>'

    def part(name: str, more: str) -> str:
        head = f'<ssd:Component name="{name}" type="application/x-ssp-definition" source="inner.ssd">'
        return f"{head}{connector(outer)}{more}</ssd:Component>"

    own = bindings(values({"u": real(2)}))
    inner = system([component("g")], [connection("u", "g.u")], name="inner", before=connector("rad") + own)
    files = {"resources/gain.fmu": gain("rad"), "inner.ssd": described(inner)}
    elements = [part("s", ""), part("t", bindings(values({"u": real(90)}))), part("left", "")]
    path = archive(tmp_path / "m.ssp", system(elements, before=bindings(values({"s.u": real(90)}))), files)
    assert parameters(path) == {"s__g.u": expected, "t__g.u": expected, "left__g.u": 2.0}
