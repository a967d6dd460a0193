"""Values between units: converted by what FMUs and names say, refused across quantities, and told."""

from __future__ import annotations

import itertools
import math

import pint
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus import units
from fmus.errors import WiringError
from fmus.units import BASES, Conversion, Unit
from orchestrator.crossing import Basis, GivenConversion, NamedUnit, crossing, documents_of, named, noted, quantity

ALIKE = [  # units of one quantity, as people write them and as pint does
    {"mNm": "mN*m", "N·m": "N*m", "kN m": "kN*m", "Ncm": "N*cm", "J": "J", "kWh": "kWh", "lbf-ft": "lbf*ft"},
    {"rpm": "rpm", "1/min": "rpm", "U/min": "rpm", "rad/s": "rad/s", "°/s": "deg/s", "rev/s": "revolution/s"},
    {"deg": "deg", "°": "deg", "rad": "rad", "mrad": "mrad", "rev": "revolution"},
    {"degC": "degC", "°C": "degC", "K": "K", "degF": "degF", "mK": "mK"},
    {"bar": "bar", "mbar": "mbar", "Pa": "Pa", "kPa": "kPa", "psi": "psi", "N/mm²": "N/mm**2"},
    {"km/h": "km/hour", "m/s": "m/s", "mph": "mph", "mm s⁻¹": "mm/s"},
    {"V/s": "V/s", "mV/ms": "mV/ms", "kV/min": "kV/min"},
    {"kgcm2": "kg*cm**2", "kg.m^2": "kg*m**2", "g·cm²": "g*cm**2"},
    {"%": "percent", "1": "dimensionless", "ppm": "ppm"},
]
PAIRS = [pair for group in ALIKE for pair in itertools.permutations(group.items(), 2)]
KNOWN = [name for group in ALIKE for name in group]
RPM = Unit(2 * math.pi / 60, (0, 0, -1, 0, 0, 0, 0, 1))
RAD_S = Unit(1.0, (0, 0, -1, 0, 0, 0, 0, 1))
TRUE = "(times 0.0174533)"
HZ = Unit(1.0, (0, 0, -1, 0, 0, 0, 0, 0))


def passed(source: str, target: str, value: float) -> float:
    return crossing("here", named(source), named(target)).conversion(value)


@given(st.sampled_from(PAIRS), st.floats(-1e4, 1e4))
def test_values_are_converted_as_pint_does(pair: tuple[tuple[str, str], tuple[str, str]], value: float) -> None:
    (ours, theirs), (other, others) = pair
    expected = PINT.Quantity(value, theirs).to(others).magnitude
    assert passed(ours, other, value) == pytest.approx(expected, rel=1e-12, abs=1e-9 * abs(passed(ours, other, 1e4)))


PINT = pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


@given(st.sampled_from(ALIKE), st.data(), st.floats(-1e6, 1e6))
def test_conversions_there_and_back_and_by_way_of_a_third_agree(
    group: dict[str, str], data: st.DataObject, value: float
) -> None:
    one, other, third = (data.draw(st.sampled_from(sorted(group))) for _ in range(3))
    slack = 1e-12 * (1e6 + 1e3) * abs(passed(one, other, 1e6) or 1.0) / 1e6
    assert passed(other, one, passed(one, other, value)) == pytest.approx(value, rel=1e-11, abs=1e-5)
    assert passed(third, other, passed(one, third, value)) == pytest.approx(
        passed(one, other, value), rel=1e-11, abs=max(slack, 1e-5)
    )


@given(st.sampled_from(KNOWN), st.sampled_from(KNOWN))
def test_units_of_other_quantities_are_refused_with_both_names(one: str, other: str) -> None:
    if any(one in group and other in group for group in ALIKE):
        return
    first, second = units.parse(one), units.parse(other)
    assert first is not None and second is not None
    if first.fits(second):  # an angle and a pure number
        return
    with pytest.raises(WiringError) as refused:
        crossing("a.x -> b.u", named(one), named(other))
    assert str(refused.value) == f"a.x -> b.u: {one} does not fit {other}; connect like quantities"


def test_what_an_fmu_defines_stands_over_names() -> None:
    twice = Unit(2.0, BASES_OF_METRE)
    own = NamedUnit("m", twice, declared=True)
    assert crossing("p", own, named("mm")).conversion(1.0) == pytest.approx(2000.0)
    assert crossing("p", own, NamedUnit("m", Unit(1.0, BASES_OF_METRE), True)).conversion(1.0) == 2.0


BASES_OF_METRE = tuple(int(base == "m") for base in BASES)


def test_radians_and_periods_differ_by_two_pi_where_fmus_define_both_and_are_refused_else() -> None:
    rpm, hertz, omega = NamedUnit("rpm", RPM, True), NamedUnit("Hz", HZ, True), NamedUnit("rad/s", RAD_S, True)
    assert crossing("p", rpm, hertz).conversion(60.0) == pytest.approx(1.0, rel=1e-12)
    assert crossing("p", hertz, omega).conversion(1.0) == pytest.approx(2 * math.pi, rel=1e-12)
    with_radians = NamedUnit("Hz", Unit(2 * math.pi, RAD_S.exponents), True)  # as the standard defines it
    assert crossing("p", with_radians, omega).conversion(1.0) == pytest.approx(2 * math.pi, rel=1e-12)
    per_minute = NamedUnit("1/min", Unit(1 / 60, HZ.exponents), True)  # of turns or of radians?
    unsaid = [(rpm, named("Hz")), (named("1/s"), named("rpm")), (per_minute, omega), (named("rpm/s"), named("1/s2"))]
    for one, other in [(named("Hz"), named("rad/s")), *unsaid]:
        with pytest.raises(WiringError, match="differ by 2 pi, or do not"):
            crossing("p", one, other)
    assert passed("1/s", "Hz", 3.0) == 3.0


def test_radians_may_be_left_out_where_they_are_not_taken_for_turns() -> None:
    assert not noted([crossing("p", named("N.m/rad"), named("N.m"))])
    assert not noted([crossing("p", named("rad"), named("1"))])
    bare = NamedUnit("rpm", Unit(RPM.factor, HZ.exponents), True)  # of a tool that leaves them out
    omega = NamedUnit("rad/s", RAD_S, True)
    assert crossing("p", bare, omega).basis is Basis.UNITS
    assert crossing("p", NamedUnit("1/s", HZ, True), omega).doubtful
    angle = crossing("p", named("1"), named("deg"))
    assert str(angle) == "p: 1 is taken for deg times 57.2958, radians left out" and angle.doubtful


def test_a_unit_that_is_not_known_is_taken_for_the_other_and_said() -> None:
    assumed = crossing("a.x -> b.u", named("A_rms"), named("A"))
    assert (assumed.basis, assumed.conversion, assumed.doubtful) == (Basis.ASSUMED, Conversion(), True)
    assert str(assumed) == "a.x -> b.u: A_rms is taken for A as it is, by factor 1"
    assert all(crossing("p", named(one), named(other)).doubtful for one, other in [("1", "lx"), ("lx", "1")])
    for one, other in [("", "A"), ("1", ""), ("A_rms", "A_rms"), ("N.m", "J"), ("Nm", "N·m")]:
        assert not noted([crossing("p", named(one), named(other))]), (one, other)


@pytest.mark.parametrize(
    ("given_", "conversion", "doubtful", "words"),
    [
        (
            GivenConversion(0.01745),
            Conversion(0.01745),
            False,
            "p: times 0.01745 as given, which is deg to rad " + TRUE,
        ),
        (GivenConversion(2.0, 1.0), Conversion(2.0, 1.0), True, "p: times 2 + 1 as given, not deg to rad " + TRUE),
        (
            GivenConversion(offset=-1.0),
            Conversion(math.pi / 180, -1.0),
            True,
            "p: times 0.0174533 - 1 as given, not deg to rad " + TRUE,
        ),
    ],
)
def test_a_factor_or_offset_by_hand_stands_over_the_units(
    given_: GivenConversion, conversion: Conversion, doubtful: bool, words: str
) -> None:
    found = crossing("p", named("deg"), named("rad"), given_)
    assert (found.conversion, found.doubtful, str(found)) == (conversion, doubtful, words)
    assert crossing("p", named("V"), named("rad"), GivenConversion(3.0)).conversion == Conversion(3.0)


def test_a_derivative_has_no_offset() -> None:
    assert crossing("p", named("degC").rate(1), named("K/s")).conversion == Conversion(1.0, 0.0)
    assert crossing("p", named("deg").rate(2), named("rad/s2")).conversion.factor == pytest.approx(math.pi / 180)


def test_what_is_told_is_told_once_and_in_plain_values() -> None:
    once = crossing("c.u", named("degC"), named("K"))
    assert noted([once, once]) == (once,)
    assert documents_of([once]) == [
        {
            "place": "c.u",
            "source": "degC",
            "target": "K",
            "factor": 1.0,
            "offset": 273.15,
            "basis": "units",
            "doubtful": False,
            "text": "c.u: degC to K, times 1 + 273.15",
        }
    ]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("3000 rpm", (3000.0, "rpm")),
        ("-1.5e-3m", (-1.5e-3, "m")),
        ("5.0 1/s", (5.0, "1/s")),
        ("60 1 / min", (60.0, "1 / min")),
        (".5 %", (0.5, "%")),
        ("5", None),
        ("5 6", None),
        ("rpm", None),
    ],
)
def test_a_quantity_is_a_number_and_its_unit_also_where_that_begins_with_a_one(
    text: str, found: tuple[float, str] | None
) -> None:
    assert quantity(text) == found
