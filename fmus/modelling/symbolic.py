"""A model's functions traced with SymPy symbols: what depends on what, and the source of generated code."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import sympy

from fmus.errors import ModelError
from fmus.modelling.mistakes import at, in_function, likely
from fmus.modelling.model import Model, Table, namespace


@dataclass(frozen=True)
class Traced:
    """Expressions of a model over the symbols `t` and one a state, input and parameter.

    Attributes:
        symbols: kind ("x", "u", "p") -> name -> symbol.
        derivatives, update, outputs: name -> expression.
        solver_step: None for a model without continuous states.
        requirements: one condition each, in their order.
    """

    time: sympy.Symbol
    symbols: Mapping[str, Mapping[str, sympy.Symbol]]
    derivatives: Mapping[str, sympy.Expr]
    update: Mapping[str, sympy.Expr]
    outputs: Mapping[str, sympy.Expr]
    solver_step: sympy.Expr | None
    requirements: tuple[sympy.Basic, ...]


@lru_cache(maxsize=16)
def trace(model: Model, as_written: bool = False) -> Traced:
    """The model's functions as expressions.

    Args:
        as_written: keep every operation in the order in which the model has it, as floats would be computed; without,
            SymPy simplifies as it goes, where it can.

    Raises:
        ModelError: a function uses something beside `fmus.ops`, or a state or output is missing from its result.
    """
    if as_written:
        with sympy.evaluate(False):
            return _trace(model)
    try:
        return _trace(model)
    except ModelError:  # SymPy cannot simplify every choice; a mistake of the model comes again
        return trace(model, as_written=True)


def _trace(model: Model) -> Traced:
    time = sympy.Symbol(_free_name(model), real=True)
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
        _single(model.solver_step, (p,)) if model.continuous and model.solver_step else None,
        tuple(_single(requirement.holds, arguments) for requirement in model.requirements),
    )


def conflicts(model: Model) -> dict[int, tuple[str, ...]]:
    """Of requirements that depend on parameters alone, by their number, these: what they say is known before a run."""
    traced = trace(model)
    names = {symbol: name for name, symbol in traced.symbols["p"].items()}
    reached = [symbols_in(condition) for condition in traced.requirements]
    return {
        number: tuple(name for symbol, name in names.items() if symbol in symbols)
        for number, symbols in enumerate(reached)
        if symbols and symbols <= names.keys()
    }


def feed_through(model: Model) -> dict[str, tuple[str, ...]]:
    """For each output the inputs that act on it within the step they are set in.

    An output of a sampled controller reacts through `update`; the state of a plant does not react at once.
    """
    traced = trace(model)
    direct = {}
    for variable in model.of("output"):
        expression = traced.outputs.get(variable.name, traced.symbols["x"].get(variable.name))
        reached = symbols_in(expression)
        for name, new in traced.update.items() if not model.plant else ():
            if traced.symbols["x"][name] in reached:
                reached = reached | symbols_in(new)
        direct[variable.name] = tuple(name for name, symbol in traced.symbols["u"].items() if symbol in reached)
    return direct


def symbols_in(*expressions: sympy.Basic, but: Iterable[sympy.Basic] = ()) -> set[sympy.Basic]:
    """Symbols that occur; shared parts are looked through once, which SymPy's own `free_symbols` does not.

    Args:
        but: expressions that are not looked through.
    """
    beyond = set(but)
    waiting = [expression for expression in expressions if expression not in beyond]
    seen = {*waiting, *beyond}
    while waiting:
        for part in waiting.pop().args:
            if part not in seen:
                seen.add(part)
                waiting.append(part)
    return {part for part in seen - beyond if part.is_Symbol}


def _free_name(model: Model) -> str:
    """The time's symbol: t, unless something in the model has that name."""
    taken = {*model.by_name, *(state.name for state in model.states)}
    return next(name for name in ("t", "time", *(f"t{i}" for i in range(len(taken)))) if name not in taken)


def _real(names: Any) -> dict[str, sympy.Symbol]:
    return {name: sympy.Symbol(name, real=True) for name in names}


def _evaluate(
    model: Model,
    label: str,
    function: Callable[..., Mapping[str, Any]] | None,
    arguments: tuple[Any, SimpleNamespace, SimpleNamespace, SimpleNamespace],
    expected: set[str],
) -> dict[str, sympy.Expr]:
    if function is None:
        if expected:
            raise ModelError(f"model {model.name}", f"nothing gives {', '.join(sorted(expected))}", f"write {label}()")
        return {}
    with _traceable(function, "t, x, u, p"):
        result = _named(function, function(*arguments))
        result = {name: sympy.sympify(value) for name, value in result.items()}
    if set(result) != expected:
        raise ModelError(at(function), *_unlike(sorted(expected - set(result)), sorted(set(result) - expected)))
    return result


def _unlike(missing: Sequence[str], extra: Sequence[str]) -> tuple[str, str]:
    """What a result lacks and has too much, and the fix."""
    problems = [f"returns nothing for {', '.join(missing)}"] if missing else []
    problems += [f"'{name}', which it returns, is not declared" for name in extra]
    return " and ".join(problems), likely(extra[0], missing) if missing and extra else "return one value a name"


def _named(function: Callable[..., Any], result: Any) -> Mapping[str, object]:
    if not isinstance(result, Mapping):
        raise ModelError(at(function), f"returns {type(result).__name__}", 'return a dict, {"name": value, ...}')
    return result


def _single(function: Callable[..., Any], arguments: tuple[Any, ...]) -> sympy.Basic:
    """What a function of one result gives."""
    with _traceable(function, "t, x, u, p" if len(arguments) > 1 else "p"):
        return sympy.sympify(function(*arguments))


@contextmanager
def _traceable(function: Callable[..., Any], arguments: str) -> Iterator[None]:
    try:
        yield
    except ModelError:
        raise
    except Exception as error:
        raise in_function(function, arguments, error) from error
