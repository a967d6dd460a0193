"""Wiring is checked before anything runs: names, directions, units, types, sources, bounds."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import WiringError
from orchestrator.assembly.wiring import wire
from orchestrator.fmi.interface import Interface, Port, Value
from orchestrator.settable import check_values
from orchestrator.system import Connection, Endpoint, Part, System


def part(*ports: Port) -> Part:
    direct = {port.name: frozenset[str]() for port in ports if port.causality == "output"}
    return Part(Interface("m", "3.0", {port.name: port for port in ports}, direct))


def out(name: str, unit: str | None = None, type_: str = "Real") -> Port:
    return Port(name, 0, type_, "output", unit)


def in_(name: str, unit: str | None = None, type_: str = "Real", start: str | None = "0") -> Port:
    return Port(name, 0, type_, "input", unit, start)


def pair(source: Port, target: Port) -> System:
    return wire({"a": part(source), "b": part(target)}, [(f"a.{source.name}", f"b.{target.name}")])


@pytest.mark.parametrize(
    ("source", "target", "factor"),
    [
        ("deg", "rad", math.pi / 180),
        ("rad", "deg", 180 / math.pi),
        ("rpm", "rad/s", 2 * math.pi / 60),
        ("mV", "V", 1e-3),
        ("N.m", "J", 1.0),
        ("N.m.s/rad", "kg.m2/s", 1.0),
        ("1/s", "Hz", 1.0),
        (None, "rad", 1.0),
        ("rad", None, 1.0),
        ("V", "V", 1.0),
    ],
)
def test_units_of_one_quantity_are_converted(source: str | None, target: str | None, factor: float) -> None:
    (link,) = pair(out("y", source), in_("u", target)).connections
    assert (link.factor, link.offset) == (pytest.approx(factor, rel=1e-15), 0.0)


@pytest.mark.parametrize(("source", "target"), [("V", "N.m"), ("rad", "m"), ("N", "N.m"), ("rad/s", "rad"), ("A", "V")])
def test_units_of_different_quantities_are_refused(source: str, target: str) -> None:
    with pytest.raises(WiringError) as refused:
        pair(out("y", source), in_("u", target))
    assert str(refused.value) == f"a.y -> b.u: {source} does not fit {target}; connect like quantities"


@given(st.sampled_from(["deg", "rad", "rev"]), st.sampled_from(["deg", "rad", "rev"]))
def test_conversion_there_and_back_is_the_identity(one: str, other: str) -> None:
    (there,) = pair(out("y", one), in_("u", other)).connections
    (back,) = pair(out("y", other), in_("u", one)).connections
    assert there.factor * back.factor == pytest.approx(1.0, rel=1e-15)


REFUSED = [
    ("c.y", "b.u", "c.y -> b.u: no component 'c'; there are a, b"),
    ("a.angle", "bb.u", "a.angle -> bb.u: no component 'bb'; did you mean 'b'?"),
    ("a.angel", "b.u", "a.angel -> b.u: no variable 'angel' in 'a'; did you mean 'angle'?"),
    ("a.angle", "b.zzz", "a.angle -> b.zzz: no variable 'zzz' in 'b'; there are u, y, n, s"),
    ("a.k", "b.u", "a.k -> b.u: 'a.k' is a parameter; only an output can be a source; outputs there: angle, text"),
    ("a.angle", "b.y", "a.angle -> b.y: 'b.y' is an output; only an input can be a target; inputs there: u, n, s"),
    ("a.text", "b.u", "a.text -> b.u: a String cannot be connected; connect a text to a text"),
    ("2 * a.text", "b.s", "a.text -> b.s: gives a String a factor or an offset; remove it"),
    ("a.angle", "b.n", "a.angle -> b.n: a Real cannot drive an Integer; round it in a component between"),
    ("angle", "b.u", "name: 'angle' does not name a variable; write component.variable"),
    ("a.", "b.u", "name: 'a.' does not name a variable; write component.variable"),
]


@pytest.mark.parametrize(("source", "target", "line"), REFUSED)
def test_a_connection_that_does_not_fit_is_refused_with_place_and_fix(source: str, target: str, line: str) -> None:
    parts = {
        "a": part(out("angle"), out("text", type_="String"), Port("k", 0, "Real", "parameter", start="1")),
        "b": part(in_("u"), out("y"), in_("n", type_="Integer"), in_("s", type_="String")),
    }
    with pytest.raises(WiringError) as refused:
        wire(parts, [(source, target)])
    assert str(refused.value) == line


@pytest.mark.parametrize("type_", ["Binary", "Clock", "String"])
def test_a_number_can_be_connected_to_numbers_only(type_: str) -> None:
    with pytest.raises(WiringError, match=f"a {type_} cannot be connected"):
        pair(out("y"), in_("u", type_=type_))


@pytest.mark.parametrize(("source", "target"), [("Integer", "Real"), ("Boolean", "Float64"), ("Int8", "UInt64")])
def test_whole_numbers_may_drive_reals_and_each_other(source: str, target: str) -> None:
    assert pair(out("y", type_=source), in_("u", type_=target)).connections == (
        Connection(Endpoint("a", "y"), Endpoint("b", "u")),
    )


def test_variable_names_may_hold_dots_and_brackets() -> None:
    system = wire({"a": part(out("der(x)[1].y")), "b": part(in_("axis.u"))}, [("a.der(x)[1].y", "b.axis.u")])
    assert str(system.connections[0].source) == "a.der(x)[1].y"


def test_an_input_with_two_sources_is_refused_naming_both() -> None:
    parts = {"a": part(out("y"), out("z")), "b": part(in_("u"))}
    with pytest.raises(WiringError) as refused:
        wire(parts, [("a.y", "b.u"), ("a.z", "b.u")])
    assert str(refused.value) == "b.u: has two sources, a.y and a.z; remove one"


def test_a_stimulus_is_a_source_too() -> None:
    parts = {"a": part(out("y")), "b": part(in_("u"))}
    with pytest.raises(WiringError, match=r"b\.u: has two sources, a\.y and a stimulus"):
        wire(parts, [("a.y", "b.u")], ["b.u"])
    assert wire(parts, [], ["b.u"]).stimulated == {Endpoint("b", "u")}


def test_only_inputs_can_be_stimulated() -> None:
    with pytest.raises(WiringError, match="only an input can be stimulated"):
        wire({"a": part(out("y"))}, [], ["a.y"])


def test_an_unconnected_input_without_start_value_is_refused() -> None:
    with pytest.raises(WiringError) as refused:
        wire({"b": part(in_("u", start=None))}, [])
    assert str(refused.value) == "b.u: is not connected and has no start value; connect it"


def test_a_tunable_parameter_can_be_stimulated_and_a_fixed_one_not() -> None:
    tunable, fixed = (
        Port("gain", 0, "Real", "parameter", start="1", variability=kind) for kind in ("tunable", "fixed")
    )
    assert wire({"b": part(tunable)}, [], ["b.gain"]).stimulated == {Endpoint("b", "gain")}
    with pytest.raises(WiringError, match="is a fixed parameter; only an input or a tunable one can be stimulated"):
        wire({"b": part(fixed)}, [], ["b.gain"])


def test_an_input_without_start_value_may_be_connected_or_stimulated() -> None:
    assert pair(out("y"), in_("u", start=None)).connections
    assert wire({"b": part(in_("u", start=None))}, [], ["b.u"]).stimulated


def settable() -> System:
    ports = [
        Port("k", 0, "Real", "parameter", start="1", minimum=0.0, maximum=2.0),
        Port("n", 0, "Integer", "parameter", start="1", minimum=1.0),
        Port("name", 0, "String", "parameter", start="x"),
        Port("x0", 0, "Real", "output", start="2"),
        Port("z", 0, "Real", "local", start="0"),
        Port("pi", 0, "Real", "local", start="3.14", variability="constant"),
        Port("derived", 0, "Real", "calculatedParameter", start=None),
        Port("size", 0, "UInt64", "structuralParameter", start="3"),
        out("y"),
        in_("u"),
        in_("w"),
        in_("free"),
    ]
    return wire({"a": part(*ports), "b": part(out("y"))}, [("b.y", "a.u")], ["a.w"])


@pytest.mark.parametrize(
    "values",
    [{"a.k": 0.0}, {"a.k": 2}, {"a.n": 10**9}, {"a.name": "left"}, {"a.x0": 1.0}, {"a.z": -1.0}, {"a.free": 3.0}, {}],
)
def test_parameters_start_values_and_free_inputs_can_be_set(values: dict[str, Value]) -> None:
    check_values(settable(), values)


@pytest.mark.parametrize(
    ("name", "value", "line"),
    [
        ("a.k", 2.5, "a.k: is 2.5, outside its bounds [0, 2]; choose a value inside"),
        ("a.k", -1, "a.k: is -1, outside its bounds [0, 2]; choose a value inside"),
        ("a.n", 0, "a.n: is 0, outside its bounds [1, inf); choose a value inside"),
        ("a.k", math.nan, "a.k: is nan; give a finite number"),
        ("a.z", math.inf, "a.z: is inf; give a finite number"),
        ("a.y", 1.0, "a.y: is an output and cannot be set; set a parameter or a start value"),
        ("a.pi", 3.0, "a.pi: is a constant and cannot be set; set a parameter or a start value"),
        ("a.derived", 3.0, "a.derived: is a calculatedParameter and cannot be set; set a parameter or a start value"),
        (
            "a.size",
            4,
            "a.size: is 3 and cannot be 4 in one run only; "
            "sizes hold for all runs: give it among the `parameters`, or with --set",
        ),
        ("a.u", 1.0, "a.u: takes its value from b.y; do not set it"),
        ("a.w", 1.0, "a.w: takes its value from a stimulus; do not set it"),
        ("a.kk", 1.0, "a.kk: no variable 'kk' in 'a'; did you mean 'k'?"),
        ("c.k", 1.0, "c.k: no component 'c'; there are a, b"),
        ("k", 1.0, "name: 'k' does not name a variable; write component.variable"),
    ],
)
def test_a_value_that_cannot_be_set_is_refused(name: str, value: Value, line: str) -> None:
    with pytest.raises(WiringError) as refused:
        check_values(settable(), {name: value})
    assert str(refused.value) == line


def test_long_lists_of_names_are_cut() -> None:
    ports = [out(f"output_{i}") for i in range(100)]
    with pytest.raises(WiringError) as refused:
        wire({"a": part(*ports)}, [("a.zzz", "a.zzz")])
    assert len(str(refused.value)) < 300
    assert str(refused.value).endswith(", ...")
