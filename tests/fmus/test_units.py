"""Unit names as powers of SI base units, against hand-made conversions."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus import library, units

ATOMS = st.sampled_from(["kg", "m", "s", "A", "rad", "N", "V", "Ohm", "H", "J", "W", "deg", "mm", "g", "rpm"])
TERMS = st.builds(lambda symbol, power: f"{symbol}{power}", ATOMS, st.sampled_from(["", "2", "3", "-1", "-2"]))


def si(name: str) -> tuple[float, dict[str, int]]:
    unit = units.parse(name)
    assert unit is not None
    return unit.factor, {base: power for base, power in zip(units.BASES, unit.exponents, strict=True) if power}


@pytest.mark.parametrize(
    ("name", "factor", "powers"),
    [
        ("1", 1.0, {}),
        ("N.m", 1.0, {"kg": 1, "m": 2, "s": -2}),
        ("N.m.s/rad", 1.0, {"kg": 1, "m": 2, "s": -1, "rad": -1}),
        ("V.s/rad", 1.0, {"kg": 1, "m": 2, "s": -2, "A": -1, "rad": -1}),
        ("V.s/(rad.J)", 1.0, {"A": -1, "rad": -1}),
        ("Ohm", 1.0, {"kg": 1, "m": 2, "s": -3, "A": -2}),
        ("H", 1.0, {"kg": 1, "m": 2, "s": -2, "A": -2}),
        ("F", 1.0, {"kg": -1, "m": -2, "s": 4, "A": 2}),
        ("rpm", 2 * math.pi / 60, {"rad": 1, "s": -1}),
        ("deg/s", math.pi / 180, {"rad": 1, "s": -1}),
        ("g.cm2", 1e-7, {"kg": 1, "m": 2}),
        ("1/min", 2 * math.pi / 60, {"rad": 1, "s": -1}),
        ("mm/s2", 1e-3, {"m": 1, "s": -2}),
        ("m^2*kg / s", 1.0, {"kg": 1, "m": 2, "s": -1}),
        ("N m", 1.0, {"kg": 1, "m": 2, "s": -2}),
        ("m s", 1.0, {"m": 1, "s": 1}),
        ("m/s/s", 1.0, {"m": 1, "s": -2}),
        ("N.m/(rad/s)", 1.0, {"kg": 1, "m": 2, "s": -1, "rad": -1}),
        ("kg/(m/s)2", 1.0, {"kg": 1, "m": -2, "s": 2}),
        ("((m/s)/(V/A))", 1.0, {"kg": -1, "m": -1, "s": 2, "A": 2}),
        ("V/(1/min)", 60 / (2 * math.pi), {"kg": 1, "m": 2, "s": -2, "A": -1, "rad": -1}),
        ("lb.in", 0.45359237 * 9.80665 * 0.0254, {"kg": 1, "m": 2, "s": -2}),
        ("tr/min", 2 * math.pi / 60, {"rad": 1, "s": -1}),
        ("msec", 1e-3, {"s": 1}),
    ],
)
def test_known_units_convert_to_si(name: str, factor: float, powers: dict[str, int]) -> None:
    found, exponents = si(name)
    assert found == pytest.approx(factor, rel=1e-14)
    assert exponents == powers


@pytest.mark.parametrize("name", ["", "furlong", "m/", "/s", "m//s", "m..s", "2m", "m2.5", "A_rms", "Grad"])
@pytest.mark.parametrize("form", ["{}", "({})", "m/({})", "{})(s", "({}"])
def test_a_name_we_do_not_know_is_no_unit(name: str, form: str) -> None:
    assert units.parse(form.format(name)) is None


@given(st.lists(TERMS, min_size=1, max_size=4), st.lists(TERMS, min_size=1, max_size=3))
def test_a_quotient_is_the_product_with_inverted_powers(above: list[str], below: list[str]) -> None:
    quotient = units.parse(f"{'.'.join(above)}/{'.'.join(below)}")
    numerator, denominator = units.parse(".".join(above)), units.parse(".".join(below))
    assert quotient is not None
    assert numerator is not None
    assert denominator is not None
    assert quotient.factor == pytest.approx(numerator.factor / denominator.factor, rel=1e-12)
    assert quotient.exponents == tuple(a - b for a, b in zip(numerator.exponents, denominator.exponents, strict=True))


@given(st.text("kmsN1.-/()^* 2€", max_size=20))
def test_any_text_is_a_unit_or_none_but_never_an_error(text: str) -> None:
    unit = units.parse(text)
    assert unit is None or len(unit.exponents) == len(units.BASES)


def test_units_fit_when_their_quantity_is_the_same_and_radians_count_as_numbers() -> None:
    def fits(one: str, other: str) -> bool:
        a, b = units.parse(one), units.parse(other)
        assert a is not None
        assert b is not None
        return a.fits(b)

    assert fits("N.m", "J")
    assert fits("N.m/rad", "N.m")
    assert fits("V.A", "W")
    assert fits("deg", "rad")
    assert not fits("rad", "rad/s")
    assert not fits("N.m", "N")
    assert not fits("V", "A")


def test_spellings_that_other_tools_do_not_read_are_told_from_those_of_fmi() -> None:
    assert all(map(units.spelt_as_in_fmi, ["N.m.s/rad", "kg.m2/s2", "1/min", "mm", "V.s/(rad.J)"]))
    assert not any(map(units.spelt_as_in_fmi, ["Nms/rad", "volts/s", "furlong/s", "m/"]))


@pytest.mark.parametrize("name", library.names())
def test_every_unit_of_the_library_is_known(name: str) -> None:
    for variable in library.find(name).variables:
        assert units.parse(variable.unit) is not None, variable.unit
