"""Exact partial derivatives of traced expressions, term by term.

SymPy's own differentiation rewrites nested cases into pages of conditions; here the derivative of a choice is a choice
between derivatives, so that the result stays as short as the model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

import sympy
from sympy.functions.elementary.piecewise import ExprCondPair
from sympy.logic.boolalg import Boolean

from fmus.errors import ModelError
from fmus.modelling import ops
from fmus.modelling.symbolic import symbols_in

Expr = Any  # a SymPy expression
_ZERO, _ONE = sympy.S.Zero, sympy.S.One
_OUTER: dict[str, Callable[[Expr], Expr]] = {
    "sin": sympy.cos,
    "cos": lambda x: -sympy.sin(x),
    "tan": lambda x: 1 + sympy.tan(x) ** 2,
    "tanh": lambda x: 1 - sympy.tanh(x) ** 2,
    "exp": sympy.exp,
    "log": lambda x: 1 / x,
    "Abs": sympy.sign,
}
_STEPS = ("floor", "sign", "uniform")


def jacobian(place: str, expressions: Sequence[Expr], symbols: Sequence[sympy.Symbol]) -> dict[tuple[int, int], Expr]:
    """(row, column) -> partial derivative of an expression by a symbol, where it is not 0 everywhere.

    At a kink or jump (limits, `where`, floor, sign) it is the derivative of the side that the value belongs to.

    Args:
        place: where the expressions come from, for errors.

    Raises:
        ModelError: a function whose derivative is not known.
    """
    entries, occurring = {}, [symbols_in(expression) for expression in expressions]
    with sympy.evaluate(False):
        for column, symbol in enumerate(symbols):
            differentiate = _Differentiation(place, symbol)
            for row, expression in enumerate(expressions):
                derivative = differentiate(expression) if symbol in occurring[row] else _ZERO
                if derivative != 0:
                    entries[row, column] = derivative
    return entries


class _Differentiation:
    """Partial derivatives by one symbol; sub-expressions are differentiated once."""

    def __init__(self, place: str, symbol: sympy.Symbol) -> None:
        self._place = place
        self._known: dict[Expr, Expr] = {symbol: _ONE}

    def __call__(self, node: Expr) -> Expr:
        if node not in self._known:
            self._known[node] = _ZERO if node.is_Atom or isinstance(node, Boolean) else self._derive(node)
        return self._known[node]

    def _derive(self, node: Expr) -> Expr:
        if node.is_Add:
            return reduce(_plus, map(self, node.args), _ZERO)
        if node.is_Mul:
            return self._product(node.args)
        if node.is_Pow:
            return self._power(node.base, node.exp)
        if node.is_Piecewise:
            return self._choice(node.args)
        if isinstance(node, sympy.Min | sympy.Max):
            return self._extremum(node)
        return self._function(node)

    def _product(self, factors: Sequence[Expr]) -> Expr:
        total = _ZERO
        for i, factor in enumerate(factors):
            others = [*factors[:i], *factors[i + 1 :]]
            total = _plus(total, reduce(_times, others, self(factor)))
        return total

    def _power(self, base: Expr, power: Expr) -> Expr:
        inner = self(base)
        if power == sympy.Rational(1, 2):
            return _times(inner, sympy.Float(0.5) / sympy.sqrt(base))
        by_base = _times(inner, _times(power, base if power == 2 else base ** _less_one(power)))
        exponential = self(power)
        if exponential == 0:
            return by_base
        return _plus(by_base, _times(exponential, base**power * sympy.log(base)))

    def _choice(self, cases: Sequence[ExprCondPair]) -> Expr:
        *others, last = cases
        return reduce(lambda rest, case: _where(case.cond, self(case.expr), rest), reversed(others), self(last.expr))

    def _extremum(self, node: Expr) -> Expr:
        better = sympy.StrictLessThan if isinstance(node, sympy.Min) else sympy.StrictGreaterThan
        value, derivative = node.args[0], self(node.args[0])
        for other in node.args[1:]:
            derivative = _where(better(value, other), derivative, self(other))
            value = node.func(value, other, evaluate=False)
        return derivative

    def _function(self, node: Expr) -> Expr:
        name = type(node).__name__
        if name == "dot":
            half = len(node.args) // 2
            products = zip(node.args[:half], node.args[half:], strict=True)
            return reduce(_plus, (self._product(factors) for factors in products), _ZERO)
        inner = [self(argument) for argument in node.args]
        if name in _STEPS or all(derivative == 0 for derivative in inner):
            return _ZERO
        if name.startswith("playback_"):
            slope = sympy.Function(name.replace("playback_", "playback_slope_", 1))
            return _times(inner[0], slope(node.args[0]))
        if name not in _OUTER:
            raise ModelError(self._place, f"the derivative of '{name}' is not known", "use only fmus.ops")
        return _times(inner[0], _OUTER[name](node.args[0]))


def _less_one(power: Expr) -> Expr:
    return sympy.Integer(int(power) - 1) if power.is_Integer else power - 1


def _plus(a: Expr, b: Expr) -> Expr:
    return b if a == 0 else a if b == 0 else a + b


def _times(a: Expr, b: Expr) -> Expr:
    if a == 0 or b == 0:
        return _ZERO
    for one, other in ((a, b), (b, a)):
        if one in (1, -1):
            return other if one == 1 else -other
    return a * b


def _where(condition: sympy.Basic, if_true: Expr, if_false: Expr) -> Expr:
    return if_true if if_true == if_false else ops.where(condition, if_true, if_false)
