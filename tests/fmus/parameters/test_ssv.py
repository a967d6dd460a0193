"""SSV files come back as they were written, whatever the values, and are valid for other tools."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from fmpy.ssp.ssd import read_ssv
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import FmuFileError
from fmus.parameters.ssv import MIME, Item, SetValue, parameter_set, read_values

TEXT = st.text(st.characters(codec="utf-8", exclude_categories=("Cc", "Cs")), min_size=1, max_size=20)
NAMES = TEXT.filter(lambda text: text == text.strip() and "  " not in text)
VALUES = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.integers(-(2**31), 2**31 - 1),
    st.booleans(),
    TEXT,
    NAMES.map(Item),
)


def write(path: Path, text: str | bytes) -> Path:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@given(values=st.dictionaries(NAMES, VALUES, max_size=6))
def test_values_come_back_bit_for_bit_and_in_their_type(
    tmp_path_factory: pytest.TempPathFactory, values: dict[str, SetValue]
) -> None:
    path = write(tmp_path_factory.getbasetemp() / "set.ssv", parameter_set("any", values))
    back = read_values(path)
    assert back == values
    assert {name: type(value) for name, value in back.items()} == {name: type(value) for name, value in values.items()}
    signs = {name: math.copysign(1, value) for name, value in values.items() if isinstance(value, float)}
    assert {name: math.copysign(1, float(back[name])) for name in signs} == signs


def test_other_tools_find_the_document_valid_and_its_units_defined(tmp_path: Path) -> None:
    values: dict[str, SetValue] = {"a": 0.1, "n": 3, "on": True, "mode": Item("fast"), "text": "x < y"}
    document = parameter_set("calibrated", values, {"a": "N.m.s/rad", "n": "1"})
    foreign = read_ssv(str(write(tmp_path / "set.ssv", document)), validate=True)
    assert {p.name: (p.type, p.value) for p in foreign.parameters} == {
        "a": ("Real", "0.1"),
        "n": ("Integer", "3"),
        "on": ("Boolean", "true"),
        "mode": ("Enumeration", "fast"),
        "text": ("String", "x < y"),
    }
    assert foreign.parameters[0].unit == "N.m.s/rad"
    assert b'name="N.m.s/rad"' in document
    assert MIME == "application/x-ssp-parameter-set"


def test_a_unit_nobody_knows_does_not_make_the_document_invalid(tmp_path: Path) -> None:
    path = write(tmp_path / "set.ssv", parameter_set("odd", {"a": 1.0}, {"a": "furlong/fortnight"}))
    assert read_ssv(str(path), validate=True).parameters[0].unit == "furlong/fortnight"


def test_an_empty_set_is_valid(tmp_path: Path) -> None:
    path = write(tmp_path / "set.ssv", parameter_set("empty", {}))
    assert read_values(path) == {}
    assert read_ssv(str(path), validate=True).parameters == []


def parameter(inner: str, name: str = ' name="a"') -> str:
    space = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
    inside = f"<p:Parameters><p:Parameter{name}>{inner}</p:Parameter></p:Parameters>"
    return f'<p:ParameterSet xmlns:p="{space}">{inside}</p:ParameterSet>'


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("no xml", "is not XML"),
        ("<ParameterSet/>", "is not an SSV parameter set"),
        (parameter('<p:Real value="heavy"/>'), "a: 'heavy' is no Real"),
        (parameter('<p:Integer value="1.5"/>'), "a: '1.5' is no Integer"),
        (parameter('<p:Boolean value="yes"/>'), "a: 'yes' is no Boolean"),
        (parameter("<p:Real/>"), "a: '' is no Real"),
        (parameter(""), "a parameter without name or value"),
        (parameter('<p:Real value="1"/>', ""), "a parameter without name or value"),
        ('<!DOCTYPE x [<!ENTITY e "1">]>' + parameter('<p:Real value="1"/>'), "document type"),
    ],
)
def test_what_is_no_parameter_set_is_refused_with_its_place(tmp_path: Path, text: str, problem: str) -> None:
    path = write(tmp_path / "set.ssv", text)
    with pytest.raises(FmuFileError) as refused:
        read_values(path)
    assert str(refused.value).startswith(str(path)) and problem in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(("text", "value"), [("true", True), ("1", True), ("false", False), ("0", False)])
def test_both_ways_of_writing_a_truth_are_read(tmp_path: Path, text: str, value: bool) -> None:
    assert read_values(write(tmp_path / "set.ssv", parameter(f'<p:Boolean value="{text}"/>'))) == {"a": value}


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FmuFileError, match="no such file"):
        read_values(tmp_path / "set.ssv")
