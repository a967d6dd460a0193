"""The defaults file inside an FMU keeps every bit of every value."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.packaging import defaults

NAMES = st.from_regex(r"[a-z_][a-z0-9_]{0,10}", fullmatch=True)
VALUES = st.one_of(st.booleans(), st.integers(-(2**31), 2**31 - 1), st.floats(allow_nan=False))


def bits(value: float | int | bool) -> tuple[type, bytes | int]:
    """Type and exact representation of a value: tells -0.0 from 0.0 and True from 1."""
    return type(value), struct.pack("<d", value) if isinstance(value, float) else value


@pytest.mark.slow
@given(st.dictionaries(NAMES, VALUES, max_size=6))
def test_values_come_back_bit_by_bit_with_their_type_and_order(values: dict[str, float | int | bool]) -> None:
    found = defaults.load(defaults.dump(values))
    assert [(name, bits(value)) for name, value in found.items()] == [
        (name, bits(value)) for name, value in values.items()
    ]


def test_a_person_may_edit_the_file_freely() -> None:
    text = "\r\ninertia=2e-3\r\n  seed =  -4 \n\n on= True\nnothing here\n"
    assert defaults.load(text) == {"inertia": 0.002, "seed": -4, "on": True}


@pytest.mark.parametrize("text", ["inertia = heavy", "inertia = ", "seed = ²"])
def test_what_is_no_number_is_an_error(text: str) -> None:
    with pytest.raises(ValueError, match=r"could not convert|invalid literal"):
        defaults.load(text)
