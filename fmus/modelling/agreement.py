"""Whether a model's traced expressions compute what its functions compute.

SymPy answers `p.shape == 1` with False while it traces: a model that compares like this would run differently in C and
in Python. Trying both at some points, with every value that its integers may take, shows it.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import sympy

from fmus.errors import ModelError
from fmus.modelling import ops
from fmus.modelling.model import Model, Table, Variable, namespace, start_values
from fmus.modelling.symbolic import Traced, trace

_MOST_VALUES = 12  # tried of one integer
_TOLERANCE = 1e-6
_OPERATIONS: dict[str, Callable[..., Any]] = {
    "Add": lambda *terms: sum(terms),
    "Mul": lambda *factors: math.prod(factors),
    "Pow": pow,
    "Min": min,
    "Max": max,
    "StrictLessThan": operator.lt,
    "LessThan": operator.le,
    "StrictGreaterThan": operator.gt,
    "GreaterThan": operator.ge,
    "Equality": operator.eq,
    "Unequality": operator.ne,
    "And": lambda *conditions: all(conditions),
    "Or": lambda *conditions: any(conditions),
    "Not": operator.not_,
    "dot": lambda *v: ops.dot(v[: len(v) // 2], v[len(v) // 2 :]),
    "Abs": abs,
    "floor": math.floor,
    "ceiling": math.ceil,
    "sign": ops.sign,
    "uniform": ops.uniform,
    "ExprCondPair": lambda value, condition: (value, condition),
    "Piecewise": lambda *cases: next(value for value, condition in cases if condition),
}

TrialPoint = tuple[float, dict[str, float], dict[str, float], dict[str, Any]]


def require_agreement(model: Model) -> None:
    """Refuse a model whose expressions are not its functions.

    Operations that are not known here are left to the C generator, which names them.

    Raises:
        ModelError: a result differs at one of the points, or the model cannot be traced.
    """
    traced = trace(model, as_written=True)
    tables = {name: Table(name) for name in model.tables}
    for label in ("derivatives", "update", "outputs"):
        if getattr(model, label) is None:
            continue
        for t, x, u, p in _points(model):
            try:
                expected = getattr(model, label)(t, namespace(x), namespace(u), namespace(p | tables))
                found = values_of(getattr(traced, label), model, traced, (t, x, u, p))
            except (ArithmeticError, ValueError, KeyError):
                continue
            _compare(f"model {model.name}, {label}", found, expected)


def values_of(
    expressions: Mapping[str, sympy.Expr], model: Model, traced: Traced, point: TrialPoint
) -> dict[str, float]:
    """What expressions of a model give at a point."""
    evaluate = _Evaluation(model, traced, point)
    return {name: float(evaluate(expression)) for name, expression in expressions.items()}


def _compare(place: str, found: Mapping[str, float], expected: Mapping[str, float]) -> None:
    for name, value in found.items():
        wanted = float(expected[name])
        if math.isfinite(wanted) and not math.isclose(value, wanted, rel_tol=_TOLERANCE, abs_tol=_TOLERANCE):
            raise ModelError(
                f"{place}, {name}",
                "is something else as an expression than as a number",
                "compare with < and > instead of ==, and choose with ops.where",
            )


class _Evaluation:
    """Expressions as numbers at one point; shared parts are computed once."""

    def __init__(self, model: Model, traced: Traced, point: TrialPoint) -> None:
        t, *values = point
        self._known: dict[sympy.Basic, Any] = {traced.time: t}
        for kind, given in zip("xup", values, strict=True):
            self._known |= {symbol: given[name] for name, symbol in traced.symbols[kind].items()}
        self._operations = _OPERATIONS | {f"playback_{name}": Table(name) for name in model.tables}

    def __call__(self, node: sympy.Basic) -> Any:
        if node not in self._known:
            self._known[node] = self._constant(node) if node.is_Atom else self._apply(node)
        return self._known[node]

    @staticmethod
    def _constant(node: sympy.Basic) -> Any:
        return bool(node) if node in (sympy.true, sympy.false) else float(node)

    def _apply(self, node: sympy.Basic) -> Any:
        name = type(node).__name__
        operation = self._operations[name] if name in self._operations else vars(math)[name]
        return operation(*map(self, node.args))


def _points(model: Model) -> Iterator[TrialPoint]:
    """Points at which states and inputs are not 0: one at the defaults, one for each value of each integer."""
    x = {state.name: 0.37 + 0.11 * i for i, state in enumerate(model.states)}
    u = {variable.name: 0.23 + 0.13 * i for i, variable in enumerate(model.of("input"))}
    starts = start_values(model)
    p = {variable.name: starts[variable.name] for variable in model.of("parameter")}
    yield 0.3, x, u, p
    for variable in model.of("parameter"):
        for value in _choices(variable):
            yield 0.3, x, u, p | {variable.name: value}


def _choices(variable: Variable) -> Iterator[float]:
    if variable.type == "Boolean":
        yield from (False, True)
    if variable.type == "Integer":
        start = int(variable.start or 0)
        low = start - 3 if variable.minimum is None else max(int(variable.minimum), start - _MOST_VALUES)
        high = low + _MOST_VALUES if variable.maximum is None else min(int(variable.maximum), low + _MOST_VALUES)
        yield from range(low, high + 1)
