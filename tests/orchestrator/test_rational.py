"""Times are exact fractions: read from text without loss, counted without drift."""

from __future__ import annotations

import math
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import WiringError
from orchestrator.rational import clock, common_divisor, multiples, seconds, written

FRACTIONS = st.builds(Fraction, st.integers(1, 10**6), st.integers(1, 10**6))


@pytest.mark.parametrize(
    ("given_as", "exact"),
    [
        (0.1, Fraction(1, 10)),
        ("0.1", Fraction(1, 10)),
        (2, Fraction(2)),
        ("1/300", Fraction(1, 300)),
        (" 1 / 300 ", Fraction(1, 300)),
        ("2e-3", Fraction(1, 500)),
        (".5", Fraction(1, 2)),
        (np.float64(0.005), Fraction(1, 200)),
        (Fraction(7, 3), Fraction(7, 3)),
        ("-0.25", Fraction(-1, 4)),
        (0, Fraction(0)),
        (1e-15, Fraction(1, 10**15)),
        ("10 ms", Fraction(1, 100)),
        ("1/3 ms", Fraction(1, 3000)),
        ("1/300 s", Fraction(1, 300)),
        ("2.5e1us", Fraction(1, 40_000)),
        ("5 µs", Fraction(1, 200_000)),
        ("2 min", Fraction(120)),
    ],
)
def test_seconds_are_the_decimal_that_was_written_not_its_float(given_as: object, exact: Fraction) -> None:
    assert seconds(given_as) == exact  # type: ignore[arg-type]


@given(st.floats(1e-14, 1e14))
def test_seconds_of_a_float_round_back_to_it(value: float) -> None:
    assert float(seconds(value)) == value
    assert seconds(value) == Fraction(Decimal(repr(value)))


HOSTILE = [
    "",
    ".",
    "e5",
    "nan",
    "inf",
    "-inf",
    "1/0",
    "0x10",
    "1_000",
    "1 0",
    "1/2/3",
    "0.1/3",
    "ten",
    None,
    True,
    "1e999999999",
    "1" * 100_000,
    10**5000,
    "1e400",
    "1e-400",
    "1e16",
    "1e-16",
    "१",
    "1e\n3",
    "10\nms",
    "10 m",
    "1 kHz",
    "3 s2",
]


@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_what_is_no_time_is_refused_in_one_short_line(text: object) -> None:
    with pytest.raises(WiringError) as refused:
        seconds(text, "run.step")  # type: ignore[arg-type]
    assert str(refused.value).startswith("run.step: ")
    assert len(str(refused.value)) < 160
    assert "\n" not in str(refused.value)


@given(st.text(max_size=40))
def test_any_text_is_a_time_or_a_wiring_error(text: str) -> None:
    try:
        value = seconds(text)
    except WiringError:
        return
    assert isinstance(value, Fraction)


@given(FRACTIONS)
def test_written_times_read_back_exactly(value: Fraction) -> None:
    assert seconds(written(value)) == value


@pytest.mark.parametrize(
    ("value", "text"), [(Fraction(1, 200), "0.005"), (Fraction(1, 300), "1/300"), (Fraction(3), "3")]
)
def test_times_are_written_as_decimals_where_those_are_exact(value: Fraction, text: str) -> None:
    assert written(value) == text


@given(st.lists(FRACTIONS, min_size=1, max_size=5))
def test_common_divisor_divides_all_and_nothing_longer_does(values: list[Fraction]) -> None:
    tick = common_divisor(values)
    counts = [value / tick for value in values]
    assert all(count.denominator == 1 for count in counts)
    assert math.gcd(*(int(count) for count in counts)) == 1


@given(st.integers(1, 10**9), FRACTIONS)
def test_multiples_are_counted_exactly(count: int, step: Fraction) -> None:
    assert multiples(count * step, step, "stop") == count


@pytest.mark.parametrize(
    ("value", "of", "line"),
    [
        (Fraction("0.0123"), Fraction("0.005"), "stop: 0.0123 s is not a multiple of 0.005 s; use 0.01 s"),
        (Fraction("0.001"), Fraction("0.005"), "stop: 0.001 s is not a multiple of 0.005 s; use 0.005 s"),
        (Fraction(1, 3), Fraction(1, 300) * 7, "stop: 1/3 s is not a multiple of 7/300 s; use 49/150 s"),
    ],
)
def test_what_does_not_divide_is_refused_with_the_nearest_that_does(value: Fraction, of: Fraction, line: str) -> None:
    with pytest.raises(WiringError) as refused:
        multiples(value, of, "stop")
    assert str(refused.value) == line


def test_a_million_ticks_of_a_third_of_a_hundredth_end_where_they_should() -> None:
    tick = seconds("1/300")
    assert 10**6 * tick == Fraction(10**4, 3)
    accumulated = float(np.add.accumulate(np.full(10**6, float(tick)))[-1])
    assert accumulated != float(10**6 * tick)  # what adding up steps would give


@given(FRACTIONS, FRACTIONS, st.integers(0, 10**9))
def test_the_clock_gives_the_float_nearest_to_the_exact_time(start: Fraction, tick: Fraction, number: int) -> None:
    assert clock(start, tick)(number) == float(start + number * tick)
