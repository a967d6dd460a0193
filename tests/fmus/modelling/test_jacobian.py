"""Partial derivatives against SymPy's own, and at kinks against the side that the value belongs to."""

from __future__ import annotations

from typing import Any

import pytest
import sympy

from fmus.errors import ModelError
from fmus.modelling import ops
from fmus.modelling.jacobian import jacobian

a, b = sympy.symbols("a b", real=True)

SMOOTH = [
    lambda a, b: a * b + a / b - 3 * a**2 * b**-1,
    lambda a, b: ops.sin(a * b) * ops.exp(-(a**2)) + ops.tanh(b / a) ** 3,
    lambda a, b: ops.sqrt(1 + a**2) / ops.log(3 + b**2) - ops.tan(0.1 * a),
    lambda a, b: (1 + a**2) ** b + 2.0**a,
    lambda a, b: -(a - (b - a)) / (2 - ops.cos(b)),
]


@pytest.mark.parametrize("function", SMOOTH)
def test_smooth_functions_have_the_derivatives_that_sympy_finds(function: Any) -> None:
    with sympy.evaluate(False):
        written = sympy.sympify(function(a, b))
    found = jacobian("here", [written], [a, b])
    for column, symbol in enumerate((a, b)):
        exact = sympy.sympify(function(a, b)).diff(symbol)
        for point in ({a: 0.7, b: 1.9}, {a: 1.3, b: -0.4}):
            assert float(found[0, column].subs(point)) == pytest.approx(float(exact.subs(point)), rel=1e-12)


@pytest.mark.parametrize(
    ("function", "at", "slope"),
    [
        (lambda a, b: ops.clip(a, -1, 1), 0.5, 1),
        (lambda a, b: ops.clip(a, -1, 1), 3.0, 0),
        (lambda a, b: ops.clip(a, -1, 1), -3.0, 0),
        (lambda a, b: ops.absolute(a), -2.0, -1),
        (lambda a, b: ops.where(a > 1, a**2, 5 * a), 3.0, 6),
        (lambda a, b: ops.where(a > 1, a**2, 5 * a), 0.0, 5),
        (lambda a, b: ops.where(ops.where(a > 1, a, b) > 2, a**2, b), 3.0, 6),
        (lambda a, b: ops.floor(a) * a, 2.5, 2),
        (lambda a, b: ops.sign(a) * a**2, -2.0, 4),
        (lambda a, b: ops.uniform(3, a) * b, 2.5, 0),
    ],
)
def test_pieces_have_the_derivative_of_the_piece_they_are_on(function: Any, at: float, slope: float) -> None:
    with sympy.evaluate(False):
        written = sympy.sympify(function(a, b))
    found = jacobian("here", [written], [a]).get((0, 0), sympy.S.Zero)
    assert float(found.subs({a: at, b: 1.5})) == pytest.approx(slope)


def test_entries_that_are_zero_everywhere_are_left_out() -> None:
    assert set(jacobian("here", [a**2, b, sympy.Float(3)], [a, b])) == {(0, 0), (1, 1)}


def test_played_back_tables_have_the_slope_of_their_piece() -> None:
    [entry] = jacobian("here", [sympy.Function("playback_drive")(2 * a)], [a]).values()
    assert entry == 2 * sympy.Function("playback_slope_drive")(2 * a)


def test_a_sum_of_products_has_the_derivative_of_the_sum_written_out() -> None:
    with sympy.evaluate(False):
        written = ops.dot([a, a * b, sympy.Float(2.0)], [b, a, a**2])
    found = jacobian("here", [written], [a, b])
    point = {a: 0.7, b: 1.9}
    exact = [(a * b + a**2 * b + 2 * a**2).diff(symbol).subs(point) for symbol in (a, b)]
    assert [float(entry.subs(point)) for entry in found.values()] == pytest.approx([float(value) for value in exact])


def test_a_function_whose_derivative_is_not_known_is_named() -> None:
    with pytest.raises(ModelError, match="here: the derivative of 'asin' is not known"):
        jacobian("here", [sympy.asin(a)], [a])
