"""Which way connections of an SSP run, whose value counts along them, and what is told of the others."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest

from fmus.errors import WiringError
from orchestrator.scenario import fusing
from orchestrator.scenario.exchange import export
from orchestrator.scenario.run import run_scenario
from orchestrator.ssp.checking import check
from orchestrator.ssp.document import imported
from orchestrator.ssp.names import Version
from tests.support.simulation.ssps import (
    archive,
    bindings,
    component,
    connection,
    connectors,
    gain,
    real,
    system,
    values,
)
from tests.support.tools.third_party import reference

LINEAR = '<ssc:LinearTransformation factor="3" offset="0.5"/>'


def led(inner: str = "", outer: str = "", outermost: str = "") -> str:
    """A wheel within a middle within the top: input, output and factor led outwards through both."""
    inside = system(
        [component("wheel", inner=inner)],
        [connection("in", "wheel.u"), connection("wheel.y", "out"), connection("factor", "wheel.k")],
        "middle",
        connectors(**{"in": "input", "out": "output", "factor": "parameter"}) + outer,
    )
    ends = [connection("u", "middle.in"), connection("middle.out", "y"), connection("F", "middle.factor")]
    return system([inside], ends, before=connectors(u="input", y="output", F="parameter") + outermost)


def parameters(path: Path) -> dict[str, Any]:
    """component.variable -> value of the system in an SSP."""
    components = imported(path).document["components"]
    return {f"{n}.{key}": value for n, one in components.items() for key, value in one.get("parameters", {}).items()}


@pytest.mark.parametrize(
    ("sets", "expected"),
    [
        ((bindings(values({"k": real(4)})),), 4.0),
        ((bindings(values({"k": real(4)})), bindings(values({"factor": real(5)}))), 5.0),
        (tuple(bindings(values({name: real(n)})) for n, name in enumerate(("k", "factor", "F"), 4)), 6.0),
    ],
    ids=["variable", "inner connector", "outer connector"],
)
def test_of_connectors_in_a_row_the_farthest_out_that_has_a_value_counts(
    tmp_path: Path, sets: tuple[str, ...], expected: float
) -> None:
    assert parameters(archive(tmp_path / "n.ssp", led(*sets))) == {"middle__wheel.k": expected}


def test_a_value_that_does_not_come_to_count_is_told(tmp_path: Path) -> None:
    more = bindings(values({"in": real(5), "out": real(6), "factor": real(7)}))
    outermost = connectors(spare="parameter") + bindings(values({"u": real(4), "spare": real(3)}))
    found = imported(archive(tmp_path / "n.ssp", led(outer=more, outermost=outermost)))
    said = " | ".join(found.notes)
    assert "in: middle.in takes its value from u" in said
    assert "out: middle.out takes its value from middle.wheel.y" in said
    assert "spare leads to no variable; it is not used" in said
    assert "factor" not in said and "u leads" not in said


@pytest.mark.parametrize("turned", [False, True])
def test_kinds_tell_where_a_value_goes_and_not_the_order_of_the_ends(tmp_path: Path, turned: bool) -> None:
    def link(start: str, end: str, inner: str = "") -> str:
        return connection(end, start, inner) if turned else connection(start, end, inner)

    inside = system(
        [component("wheel")],
        [link("in", "wheel.u", LINEAR), link("wheel.y", "out"), link("factor", "wheel.k")],
        "middle",
        connectors(**{"in": "input", "out": "output", "factor": "parameter"}),
    )
    ends = [link("u", "a.u"), link("a.y", "middle.in"), link("middle.out", "y")]
    given = connectors(u="input", y="output") + bindings(values({"u": real(4), "middle.factor": real(10)}))
    path = archive(tmp_path / "turned.ssp", system([component("a"), inside], ends, before=given))
    result = run_scenario(path).cases[0].result
    assert result is not None and result.trace["middle__wheel.y"][-1] == 10 * (3 * (2 * 4) + 0.5)


def test_connectors_that_both_take_or_both_give_values_are_refused(tmp_path: Path) -> None:
    inside = system([component("wheel")], [connection("out", "wheel.u")], "middle", connectors(out="output"))
    with pytest.raises(WiringError, match=r"middle: out -> wheel\.u: joins two connectors that take values there"):
        imported(archive(tmp_path / "x.ssp", system([inside])))


def test_what_comes_out_of_a_connector_that_nothing_sets_is_told(tmp_path: Path) -> None:
    inside = system([component("wheel")], name="middle", before=connectors(out="output"))
    found = imported(archive(tmp_path / "x.ssp", system([inside, component("b")], [connection("middle.out", "b.u")])))
    assert any("nothing sets middle.out; b.u keeps its own value" in note for note in found.notes)


def test_all_that_are_called_alike_take_a_value(tmp_path: Path) -> None:
    twins = system(
        [component("x.wheel"), system([component("wheel")], name="x")], before=bindings(values({"x.wheel.k": real(9)}))
    )
    assert parameters(archive(tmp_path / "twins.ssp", twins)) == {"x_wheel.k": 9.0, "x__wheel.k": 9.0}


def test_another_system_in_the_archive_is_told(tmp_path: Path) -> None:
    files = {"resources/gain.fmu": gain(), "Winter.ssd": system([component("a")])}
    found = imported(archive(tmp_path / "two.ssp", system([component("a")]), files))
    assert "Winter.ssd is another system, which is not used" in found.notes


def feedthrough(path: Path, kind: str, value: str) -> Path:
    """An SSP of the Reference FMU with a value for a connector of the system that leads to its input of a type."""
    typed = '<ssc:Enumeration name="e"/>' if kind == "Enumeration" else f"<ssc:{kind}/>"
    kinds = {"u": "input", "y": "output"}
    outer = "".join(f'<ssd:Connector name="{name}" kind="{of}">{typed}</ssd:Connector>' for name, of in kinds.items())
    part = '<ssd:Component name="a" source="resources/gain.fmu"/>'
    links = [connection("u", f"a.{kind}_input"), connection(f"a.{kind}_output", "y")]
    given = f"<ssd:Connectors>{outer}</ssd:Connectors>{bindings(values({'u': value}))}"
    return archive(path, system([part], links, before=given), {"resources/gain.fmu": reference(3, "Feedthrough")})


@pytest.mark.parametrize(
    ("kind", "value", "number"),
    [
        ("Enumeration", '<ssv:Enumeration value="Option 2"/>', 2.0),
        ("Boolean", '<ssv:Boolean value="true"/>', 1.0),
        ("Int32", '<ssv:Integer value="-3"/>', -3.0),
    ],
)
def test_what_comes_in_from_outside_may_be_of_any_type(tmp_path: Path, kind: str, value: str, number: float) -> None:
    path = feedthrough(tmp_path / "x.ssp", kind, value)
    assert imported(path).document["stimuli"] == {f"a.{kind}_input": {"constant": number}}
    result = run_scenario(path).cases[0].result
    assert result is not None and result.trace[f"a.{kind}_output"][-1] == number


def test_a_text_that_goes_out_is_recorded(tmp_path: Path) -> None:
    path = feedthrough(tmp_path / "x.ssp", "String", '<ssv:String value="gr\u00fcn"/>')
    result = run_scenario(path).cases[0].result
    assert result is not None and result.trace.texts["a.String_output"][0] == "gr\u00fcn"


def test_where_nothing_tells_a_step_it_is_one_that_the_fmus_can_take(tmp_path: Path) -> None:
    found = imported(feedthrough(tmp_path / "x.ssp", "Boolean", '<ssv:Boolean value="true"/>'))
    assert found.document["run"]["step"] == "0.1"
    assert "no communication step is said; 0.1 s is the least that its FMUs say" in found.notes


def test_an_output_of_the_system_that_no_fmu_computes_is_told(tmp_path: Path) -> None:
    given = connectors(u="input", y="output", z="output") + bindings(values({"u": real(3)}))
    path = archive(
        tmp_path / "x.ssp", system([component("a")], [connection("u", "y"), connection("u", "a.u")], before=given)
    )
    said = imported(path).notes
    assert "y has the value of u, which no FMU computes; it is not recorded" in said
    assert "z has no source; it is not recorded" in said


def test_connectors_of_the_system_have_names_of_their_own(tmp_path: Path) -> None:
    Path(tmp_path, "twin.py").write_text(
        "from . import Model, input_, output\n"
        'ends = (input_("u", "1", "In", start=1.0), input_("b_u", "1", "In", start=1.0))\n'
        'MODEL = Model(name="twin", description="Two", variables=(*ends, output("y", "1", "Out")),\n'
        '              outputs=lambda t, x, u, p: {"y": u.u + 10 * u.b_u})\n'
    )
    Path(tmp_path, "twins.yaml").write_text(
        "title: twins\ncomponents: {a: {model: twin.py}, a_b: {model: twin.py}}\n"
        "stimuli: {a.b_u: {constant: 2}, a_b.u: {constant: 5}}\nrun: {stop: 1, step: 0.1}\nrecord: [a.y, a_b.y]\n"
    )
    export(tmp_path / "twins.yaml", tmp_path / "twins.ssp")
    assert not check(tmp_path / "twins.ssp").problems
    result = run_scenario(tmp_path / "twins.ssp").cases[0].result
    assert result is not None and (result.trace["a.y"][-1], result.trace["a_b.y"][-1]) == (21.0, 15.0)


@pytest.mark.parametrize("version", Version)
def test_elements_of_arrays_go_in_and_out_by_connectors_of_their_own(tmp_path: Path, version: Version) -> None:
    shutil.copy(reference(3, "StateSpace"), tmp_path / "space.fmu")
    Path(tmp_path, "space.yaml").write_text(
        "title: arrays\ncomponents: {a: {fmu: space.fmu}, b: {fmu: space.fmu}}\nconnections: [a.y -> b.u]\n"
        'stimuli: {"a.u[1]": {constant: 2}, "a.u[3]": {constant: 4}}\nrun: {stop: 10, step: 1}\nrecord: [b.y]\n'
    )
    export(tmp_path / "space.yaml", tmp_path / "space.ssp", version=version)
    assert not check(tmp_path / "space.ssp").problems
    with ZipFile(tmp_path / "space.ssp") as full, ZipFile(tmp_path / "bare.ssp", "w") as bare:
        for name in full.namelist():  # without what only this project reads
            if not name.startswith("extra/"):
                bare.writestr(name, full.read(name))
    traces = []
    for name in ("space.yaml", "space.ssp", "bare.ssp"):
        result = run_scenario(tmp_path / name).cases[0].result
        assert result is not None
        traces.append({signal: result.trace[signal] for signal in result.trace.names})
    assert [*traces[0]] == ["b.y[1]", "b.y[2]", "b.y[3]"] and np.ptp(traces[0]["b.y[3]"]) > 0
    assert all(np.array_equal(traces[0][name], one[name]) for one in traces[1:] for name in traces[0])


def test_one_fmu_shows_the_elements_of_an_array_that_is_recorded(tmp_path: Path) -> None:
    shutil.copy(reference(3, "StateSpace"), tmp_path / "space.fmu")
    text = "title: arrays\ncomponents: {a: {fmu: space.fmu}}\nrun: {stop: 10, step: 1}\nrecord: [a.y]\n"
    Path(tmp_path, "space.yaml").write_text(text)
    assert fusing.fuse(tmp_path / "space.yaml").system.outputs == ("a.y[1]", "a.y[2]", "a.y[3]")
    Path(tmp_path, "other.yaml").write_text(text.replace("a.y", "a.q"))
    with pytest.raises(WiringError, match=r"other\.yaml: .*a\.q: no variable 'q' in 'a'"):
        fusing.fuse(tmp_path / "other.yaml")
