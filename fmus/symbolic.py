"""A model's functions traced with SymPy symbols: what depends on what, and the source of generated code."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import sympy

from fmus.errors import ModelError
from fmus.model import Model, Table, namespace


@dataclass(frozen=True)
class Traced:
    """Expressions of a model over the symbols `t` and one a state, input and parameter.

    Attributes:
        symbols: kind ("x", "u", "p") -> name -> symbol.
        derivatives, update, outputs: name -> expression.
    """

    time: sympy.Symbol
    symbols: Mapping[str, Mapping[str, sympy.Symbol]]
    derivatives: Mapping[str, sympy.Expr]
    update: Mapping[str, sympy.Expr]
    outputs: Mapping[str, sympy.Expr]


def trace(model: Model) -> Traced:
    """The model's functions as expressions.

    Raises:
        ModelError: a function uses something beside `fmus.ops`, or a state or output is missing from its result.
    """
    time = sympy.Symbol("t", real=True)
    symbols = {
        "x": _real(state.name for state in model.states),
        "u": _real(variable.name for variable in model.of("input")),
        "p": _real(variable.name for variable in model.of("parameter")),
    }
    p = namespace({**symbols["p"], **{name: Table(name) for name in model.tables}})
    arguments = (time, namespace(symbols["x"]), namespace(symbols["u"]), p)
    states = {state.name for state in model.states}
    results = {variable.name for variable in model.of("output")} - states
    return Traced(
        time,
        symbols,
        _evaluate(model, "derivatives", model.derivatives, arguments, {s.name for s in model.continuous}),
        _evaluate(model, "update", model.update, arguments, {s.name for s in model.sampled}),
        _evaluate(model, "outputs", model.outputs, arguments, results),
    )


def feed_through(model: Model) -> dict[str, tuple[str, ...]]:
    """For each output the inputs that act on it within the step they are set in.

    An output of a sampled model reacts through `update`; the state of a continuous one does not react at once.
    """
    traced = trace(model)
    direct = {}
    for variable in model.of("output"):
        expression = traced.outputs.get(variable.name, traced.symbols["x"].get(variable.name))
        reached = expression.free_symbols
        for name, new in traced.update.items():
            if traced.symbols["x"][name] in reached:
                reached = reached | new.free_symbols
        direct[variable.name] = tuple(name for name, symbol in traced.symbols["u"].items() if symbol in reached)
    return direct


def _real(names: Any) -> dict[str, sympy.Symbol]:
    return {name: sympy.Symbol(name, real=True) for name in names}


def _evaluate(
    model: Model,
    label: str,
    function: Callable[..., Mapping[str, Any]] | None,
    arguments: tuple[Any, SimpleNamespace, SimpleNamespace, SimpleNamespace],
    expected: set[str],
) -> dict[str, sympy.Expr]:
    place = f"model {model.name}, {label}"
    if function is None:
        if expected:
            raise ModelError(place, f"nothing gives {', '.join(sorted(expected))}", f"write {label}()")
        return {}
    try:
        result = {name: sympy.sympify(value) for name, value in function(*arguments).items()}
    except Exception as error:
        raise ModelError(place, f"cannot be traced ({error})", "use only fmus.ops and arithmetic") from error
    if set(result) != expected:
        missing, extra = sorted(expected - set(result)), sorted(set(result) - expected)
        raise ModelError(place, f"missing {missing}, unexpected {extra}", "return one value for each declared name")
    return result
