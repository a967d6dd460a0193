"""The model functions: floats, arrays and symbols agree; random numbers have the distributions they claim."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import sympy
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from fmus.modelling import ops
from fmus.modelling.model import Table

NUMBERS = st.floats(-50, 50).filter(lambda x: x == 0 or abs(x) > 1e-6)
POSITIVE = st.floats(1e-6, 50)
SEEDS = st.integers(-(2**31), 2**31 - 1)
UNARY: dict[str, tuple[Callable[..., Any], Callable[..., Any], st.SearchStrategy[float]]] = {
    "sin": (ops.sin, math.sin, NUMBERS),
    "cos": (ops.cos, math.cos, NUMBERS),
    "tan": (ops.tan, math.tan, st.floats(-1.5, 1.5)),
    "tanh": (ops.tanh, math.tanh, NUMBERS),
    "exp": (ops.exp, math.exp, NUMBERS),
    "log": (ops.log, math.log, POSITIVE),
    "sqrt": (ops.sqrt, math.sqrt, POSITIVE),
    "floor": (ops.floor, math.floor, NUMBERS),
    "absolute": (ops.absolute, abs, NUMBERS),
    "sign": (ops.sign, np.sign, NUMBERS),
}
SYMBOLS = sympy.symbols("a b c", real=True)


def traced(function: Callable[..., Any], *values: float) -> float:
    """What the function's expression over symbols evaluates to at these values."""
    symbols = SYMBOLS[: len(values)]
    return float(sympy.lambdify(symbols, function(*symbols), modules=["math"])(*values))


@pytest.mark.parametrize("name", UNARY)
@given(data=st.data())
def test_floats_arrays_and_symbols_agree_with_the_mathematical_function(name: str, data: st.DataObject) -> None:
    function, reference, domain = UNARY[name]
    x = data.draw(domain)
    expected = pytest.approx(float(reference(x)), rel=1e-14, abs=1e-300)
    assert function(x) == expected
    assert type(function(x)) is float
    assert function(np.array([x, x])).tolist() == [expected, expected]
    assert traced(function, x) == expected


@given(NUMBERS, NUMBERS)
def test_minimum_and_maximum_are_those_of_python_for_floats_arrays_and_symbols(a: float, b: float) -> None:
    for function, reference in ((ops.minimum, min), (ops.maximum, max)):
        assert function(a, b) == reference(a, b)
        assert function(np.array([a]), b).tolist() == [reference(a, b)]
        assert traced(function, a, b) == reference(a, b)


@given(NUMBERS, st.tuples(NUMBERS, NUMBERS).map(sorted))
def test_clip_is_that_of_numpy_for_floats_arrays_and_symbols(x: float, limits: list[float]) -> None:
    low, high = limits
    expected = float(np.clip(x, low, high))
    assert ops.clip(x, low, high) == expected
    assert ops.clip(np.array([x]), low, high).tolist() == [expected]
    assert traced(ops.clip, x, low, high) == expected


@given(NUMBERS, NUMBERS, NUMBERS)
def test_where_takes_the_branch_of_the_condition_for_floats_arrays_and_symbols(a: float, b: float, c: float) -> None:
    def choose(a: Any, b: Any, c: Any) -> Any:
        return ops.where(ops.both(a > b, a < c), a, b)

    expected = a if b < a < c else b
    assert choose(a, b, c) == expected
    assert choose(np.array([a]), b, c).tolist() == [expected]
    assert traced(choose, a, b, c) == expected


@given(NUMBERS, NUMBERS, NUMBERS)
def test_where_chooses_between_conditions_for_floats_arrays_and_symbols(a: float, b: float, c: float) -> None:
    def choose(a: Any, b: Any, c: Any) -> Any:
        return ops.where(ops.both(ops.where(a > b, b > c, a > c), ops.where(a > c, True, b > 0)), a, b)

    expected = a if (b > c if a > b else a > c) and (a > c or b > 0) else b
    assert choose(a, b, c) == expected
    assert choose(np.array([a]), b, c).tolist() == [expected]
    assert traced(choose, a, b, c) == expected


@pytest.mark.parametrize("name", UNARY)
def test_a_function_of_symbols_stays_as_it_is_written(name: str) -> None:
    """Rewriting looks through all that it is a function of, for seconds in a model with many choices."""
    a, b, c = SYMBOLS
    inside = ops.where(ops.where(a > b, b, c) > 0, a, -a - b)
    assert inside in UNARY[name][0](inside).args


@given(st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=8))
def test_dot_is_the_product_of_two_vectors_for_floats_arrays_and_symbols(pairs: list[tuple[float, float]]) -> None:
    one, other = ([pair[i] for pair in pairs] for i in (0, 1))
    expected = pytest.approx(float(np.dot(one, other)), rel=1e-12, abs=1e-9)
    assert ops.dot(one, other) == expected
    assert ops.dot([np.array([x, 0.0]) for x in one], other)[0] == expected
    node = ops.dot(sympy.symbols(f"a:{len(one)}"), other)
    assert (type(node).__name__, len(node.args)) == ("dot", 2 * len(one))


def test_where_with_a_condition_known_while_tracing_leaves_no_trace_of_the_other_branch() -> None:
    a, b, _ = SYMBOLS
    assert ops.where(True, a, b) is a
    assert ops.where(False, a, b) is b


@given(SEEDS, st.integers(0, 2**40))
def test_random_numbers_depend_on_seed_and_index_only_and_arrays_give_the_same(seed: int, index: int) -> None:
    for function in (ops.uniform, ops.normal):
        alone = function(seed, index)
        assert function(seed, float(index)) == alone
        near = pytest.approx(alone, rel=1e-12, abs=1e-14)
        assert function(np.full(2, seed), np.array([index + 1, index])).tolist()[1] == near
        symbolic = sympy.lambdify(SYMBOLS[:2], function(*SYMBOLS[:2]), modules=[{"uniform": ops.uniform}, "math"])
        assert symbolic(seed, index) == near


def test_uniform_is_splitmix64_of_its_published_reference_values() -> None:
    assert ops._mix(0) == 0xE220A8397B1DCDAF
    assert ops._mix(0x9E3779B97F4A7C15) == 0x6E789E6AA1B965F4


@pytest.mark.parametrize("bits", [0, 2**64 - 1])
def test_uniform_never_reaches_zero_or_one(bits: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ops, "_mix", lambda z: bits)
    assert 0.0 < ops.uniform(1, 1) < 1.0


@pytest.mark.parametrize("seed", [0, 1, 2, -7, 123456789])
def test_uniform_numbers_are_uniform_and_independent_of_their_neighbours(seed: int) -> None:
    values = ops.uniform(np.full(20_000, seed), np.arange(20_000))
    assert stats.chisquare(np.histogram(values, bins=50, range=(0, 1))[0]).pvalue > 1e-4
    pairs = np.histogram2d(values[:-1], values[1:], bins=10, range=((0, 1), (0, 1)))[0]
    assert stats.chisquare(pairs.ravel()).pvalue > 1e-4


def test_neighbouring_seeds_give_uncorrelated_numbers() -> None:
    rows = np.array([ops.uniform(np.full(10_000, seed), np.arange(10_000)) for seed in range(6)])
    correlation = np.corrcoef(rows)[np.triu_indices(6, 1)]
    assert np.max(np.abs(correlation)) < 4.5 / math.sqrt(10_000)


def test_normal_numbers_have_the_moments_and_the_shape_of_the_standard_normal() -> None:
    values = ops.normal(np.full(20_000, 5), np.arange(20_000))
    assert abs(values.mean()) < 4 / math.sqrt(20_000)
    assert abs(values.var() - 1) < 4 * math.sqrt(2 / 20_000)
    assert abs(stats.skew(values)) < 4 * math.sqrt(6 / 20_000)
    assert abs(stats.kurtosis(values)) < 4 * math.sqrt(24 / 20_000)
    assert stats.kstest(values, "norm").pvalue > 1e-4


@given(st.lists(st.tuples(st.floats(0.01, 5), NUMBERS), min_size=1, max_size=8), st.floats(-5, 45))
def test_playback_interpolates_as_numpy_does(samples: list[tuple[float, float]], time: float) -> None:
    instants = np.cumsum([gap for gap, _ in samples])
    table = Table("speed", tuple(instants.tolist()), tuple(value for _, value in samples))
    expected = pytest.approx(float(np.interp(time, table.time, table.values)), rel=1e-9, abs=1e-9)
    assert ops.playback(table, time) == expected
    assert ops.playback(table, np.array([time])).tolist() == [expected]


def test_playback_of_a_symbolic_time_is_a_function_named_after_its_table() -> None:
    assert str(ops.playback(Table("speed"), SYMBOLS[0])) == "playback_speed(a)"
