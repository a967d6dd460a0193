"""The interface of an FMU made from its model: the variables in order, and the structure that tracing shows."""

from __future__ import annotations

from collections.abc import Mapping

import sympy

from fmus import units
from fmus.modelling import symbolic
from fmus.modelling.model import Model, Number, State, Variable, start_values
from fmus.packaging.description.interface import Exposed, ModelInterface, exchangeable, hidden_states, rate_name


def plain(model: Model, defaults: Mapping[str, Number]) -> ModelInterface:
    """The variables that the model declares, for co-simulation."""
    starts = start_values(model) | dict(defaults)
    return ModelInterface(model, _declared(model, starts), symbolic.feed_through(model), {}, _initial(model, False))


def complete(model: Model, defaults: Mapping[str, Number]) -> ModelInterface:
    """As `plain`, then the states that are no outputs, and the rates of a model that can be exchanged."""
    variables = _declared(model, start_values(model) | dict(defaults))
    variables += tuple(
        _hidden(model, state, reference) for reference, state in enumerate(hidden_states(model), len(variables))
    )
    if not exchangeable(model):
        return ModelInterface(model, variables, symbolic.feed_through(model), {}, _initial(model, False))
    variables += tuple(_rate(model, state, i) for i, state in enumerate(model.continuous, len(variables)))
    outputs, rates = _structure(model)
    return ModelInterface(model, variables, outputs, rates, _initial(model, True))


def _declared(model: Model, starts: Mapping[str, Number]) -> tuple[Exposed, ...]:
    return tuple(_variable(model, variable, i, starts) for i, variable in enumerate(model.variables))


def _variable(model: Model, variable: Variable, reference: int, starts: Mapping[str, Number]) -> Exposed:
    kinds: dict[str, tuple[str, str | None]] = {
        "parameter": ("tunable" if variable.tunable else "fixed", "exact"),
        "input": ("continuous" if variable.type == "Real" else "discrete", None),
        "output": ("discrete" if model.sampled and not model.plant else "continuous", "calculated"),
    }
    variability, initial = kinds[variable.causality]
    return Exposed(
        variable.name,
        reference,
        variable.causality,
        variability,
        initial,
        "Enumeration" if variable.choices else variable.type,
        variable.unit,
        variable.description,
        starts.get(variable.name),
        variable.minimum,
        variable.maximum,
        variable.nominal,
        variable.choices,
    )


def _hidden(model: Model, state: State, reference: int) -> Exposed:
    variability = "discrete" if state.sampled else "continuous"
    text = state.description or "State"
    return Exposed(state.name, reference, "local", variability, "calculated", "Real", state.unit, text)


def _rate(model: Model, state: State, reference: int) -> Exposed:
    unit = _rate_unit(_state_unit(model, state), {variable.unit for variable in model.variables})
    name, text = rate_name(state.name), f"Time derivative of {state.name}"
    return Exposed(name, reference, "local", "continuous", "calculated", "Real", unit, text, derivative_of=state.name)


def _state_unit(model: Model, state: State) -> str:
    """A state's unit; that of the output which it is."""
    return model.by_name[state.name].unit if state.name in model.by_name else state.unit


def _rate_unit(unit: str, known: set[str]) -> str:
    """The unit over a second: by a name that is known already where there is one."""
    plain_name = f"{unit}.s" if "/" in unit else f"{unit}/s"
    wanted = units.parse(plain_name)
    same = [name for name in sorted(known) if wanted is not None and units.parse(name) == wanted]
    return same[0] if same else plain_name


def _structure(model: Model) -> tuple[dict[str, tuple[str, ...]], dict[str, tuple[str, ...]]]:
    """Outputs, and rates, with the states and inputs in their expressions."""
    traced = symbolic.trace(model)
    known = {**traced.symbols["x"], **traced.symbols["u"]}
    expressions = {**traced.symbols["x"], **traced.outputs}
    outputs = {v.name: _occurring(expressions[v.name], known) for v in model.of("output")}
    rates = {rate_name(name): _occurring(traced.derivatives[name], known) for name in traced.derivatives}
    return outputs, {rate_name(state.name): rates[rate_name(state.name)] for state in model.continuous}


def _initial(model: Model, exchange: bool) -> dict[str, tuple[str, ...]]:
    """What has to be computed at the start, with the inputs and parameters that it is computed from."""
    traced = symbolic.trace(model)
    known = {**traced.symbols["u"], **traced.symbols["p"]}
    starts = {
        traced.symbols["x"][s.name]: traced.symbols["p"][s.start] if isinstance(s.start, str) else sympy.Float(s.start)
        for s in model.states
    }
    unknowns = {v.name: traced.outputs.get(v.name, traced.symbols["x"].get(v.name)) for v in model.of("output")}
    if exchange:
        unknowns |= {state.name: traced.symbols["x"][state.name] for state in hidden_states(model)}
        unknowns |= {rate_name(state.name): traced.derivatives[state.name] for state in model.continuous}
    reached = {name: symbolic.symbols_in(expression) for name, expression in unknowns.items()}
    at_start = {name: symbolic.symbols_in(*(starts.get(x, x) for x in found)) for name, found in reached.items()}
    late = {known[one.input]: {known[key] for key in (one.seconds, one.before, one.shape)} for one in model.delays}
    for found in at_start.values():
        found.update(*(late[symbol] for symbol in found & late.keys()))
    return {name: tuple(k for k, symbol in known.items() if symbol in at_start[name]) for name in unknowns}


def _occurring(expression: sympy.Expr, known: Mapping[str, sympy.Symbol]) -> tuple[str, ...]:
    reached = symbolic.symbols_in(expression)
    return tuple(name for name, symbol in known.items() if symbol in reached)
