"""SSV files come back as they were written, whatever the values, and are valid for other tools."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from fmpy.ssp.ssd import read_ssv
from hypothesis import given
from hypothesis import strategies as st

from fmus.parameters.ssv import MIME, Item, SetValue, parameter_set
from tests.support.ssv import read_values

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
