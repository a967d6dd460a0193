"""Every model of the library can be traced, and its expressions are its functions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import sympy
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from sympy.logic.boolalg import Boolean

from fmus import library
from fmus.errors import ModelError
from fmus.modelling import agreement, ops, symbolic
from fmus.modelling.instance import Instance
from fmus.modelling.model import Model, Table, Variable, namespace

PLAYED = Table("playback", (0.0, 1.0, 2.5), (0.0, 2.0, -1.0))
OURS = [
    {
        "uniform": ops.uniform,
        "playback_playback": PLAYED,
        "dot": lambda *v: ops.dot(v[: len(v) // 2], v[len(v) // 2 :]),
    },
    "math",
]
FUNCTIONS = ("derivatives", "update", "outputs")


@cache
def compiled(name: str, label: str) -> tuple[tuple[str, ...], Any]:
    """Names of a function's results, and the function made from its expressions, of the symbols by name."""
    traced = symbolic.trace(library.find(name))
    expressions = getattr(traced, label)
    symbols = [traced.time, *(symbol for kind in "xup" for symbol in traced.symbols[kind].values())]
    return tuple(expressions), sympy.lambdify(symbols, list(expressions.values()), modules=OURS)


def parameter_values(variable: Variable, near: bool) -> st.SearchStrategy[Any]:
    """Values within the bounds, no wider than five around the default, or than a fifth of it."""
    start = float(variable.start or 0)
    span = 0.15 * abs(start) if near else 5
    low = max(start - span, -math.inf if variable.minimum is None or near else max(variable.minimum, 1e-3))
    high = min(start + span, math.inf if variable.maximum is None else variable.maximum)
    return (
        st.integers(math.ceil(low), math.floor(high))
        if variable.type == "Integer"
        else st.floats(low, high, allow_subnormal=False)
    )


def points(model: Model) -> st.SearchStrategy[tuple[float, dict[str, float], dict[str, float], dict[str, Any]]]:
    """(t, x, u, p) at random; of an arm near its defaults: elsewhere rounding of its stiffness swamps the rest."""
    near = model.name.startswith("flexible")
    numbers = st.floats(-5, 5, allow_subnormal=False)  # those have no reciprocal
    states = {s.name: st.integers(0, 1000).map(float) if s.name == "count" else numbers for s in model.states}
    inputs = {variable.name: numbers for variable in model.of("input")}
    parameters = {variable.name: parameter_values(variable, near) for variable in model.of("parameter")}
    fixed = st.fixed_dictionaries
    return st.tuples(st.floats(0, 20), fixed(states), fixed(inputs), fixed(parameters))


def in_order(model: Model, *values: dict[str, Any]) -> list[Any]:
    """Values of states, inputs and parameters in the order of the symbols of `compiled`."""
    symbols = symbolic.trace(model).symbols
    return [given[name] for kind, given in zip("xup", values, strict=True) for name in symbols[kind]]


@pytest.mark.slow
@pytest.mark.parametrize("name", library.names())
@settings(deadline=None)
@given(data=st.data())
def test_expressions_give_what_the_functions_give(name: str, data: st.DataObject) -> None:
    model = library.find(name)
    t, x, u, p = data.draw(points(model))
    tables = dict.fromkeys(model.tables, PLAYED)
    for label in FUNCTIONS:
        function = getattr(model, label)
        if function is None:
            continue
        try:
            expected = function(t, namespace(x), namespace(u), namespace(p | tables))
        except ZeroDivisionError:  # where the model says that it does not hold
            assert not all(r.holds(t, namespace(x), namespace(u), namespace(p | tables)) for r in model.requirements)
            reject()
        if model.arrays:  # names such as kp[1] would be replaced, and all that holds them simplified for minutes
            traced = symbolic.trace(model, as_written=True)
            found = agreement.values_of(getattr(traced, label), model, traced, (t, x, u, p))
        else:
            results, run = compiled(name, label)
            found = dict(zip(results, run(t, *in_order(model, x, u, p)), strict=True))
        assert found == pytest.approx(dict(expected), rel=1e-9, abs=1e-12), label


@pytest.mark.slow
@pytest.mark.parametrize("name", library.names())
def test_solver_step_and_requirements_can_be_traced_too(name: str) -> None:
    model = library.find(name)
    traced = symbolic.trace(model)
    x, u, p = (namespace(traced.symbols[kind]) for kind in "xup")
    if model.solver_step:
        instance = Instance(model)
        step = sympy.sympify(model.solver_step(p)).subs(
            {symbol: getattr(instance.p, name) for name, symbol in traced.symbols["p"].items()}
        )
        assert float(step) == pytest.approx(model.solver_step(instance.p), rel=1e-12)
    for requirement in model.requirements:
        assert isinstance(sympy.sympify(requirement.holds(traced.time, x, u, p)), Boolean)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("pendulum", {"angle": (), "speed": (), "acceleration": ("torque",), "energy": ()}),
        ("dc_motor", {"torque": ("voltage", "speed"), "current": ("voltage", "speed")}),
        ("energy_controller", dict.fromkeys(("voltage", "saturated", "energy", "unreached"), ("angle", "speed"))),
        ("excitation", {"signal": ()}),
        ("daq", {"measured": ("signal",)}),
    ],
)
def test_feed_through_names_the_inputs_that_act_at_once(name: str, expected: Mapping[str, tuple[str, ...]]) -> None:
    assert symbolic.feed_through(library.find(name)) == expected


@pytest.mark.slow
@pytest.mark.parametrize("name", library.names())
@given(data=st.data())
def test_an_input_outside_the_feed_through_has_no_effect_on_the_output(name: str, data: st.DataObject) -> None:
    model = library.find(name)
    if model.outputs is None:
        return
    t, x, u, p = data.draw(points(model))
    tables = dict.fromkeys(model.tables, PLAYED)
    before = model.outputs(t, namespace(x), namespace(u), namespace(p | tables))
    for output, reached in symbolic.feed_through(model).items():
        if output in x:
            continue
        changed = u | {name: value + 1.0 for name, value in u.items() if name not in reached}
        assert model.outputs(t, namespace(x), namespace(changed), namespace(p | tables))[output] == before[output]


def test_jacobian_of_the_pendulum_is_the_numerical_one() -> None:
    model = library.find("pendulum")
    traced = symbolic.trace(model)
    names = [*traced.symbols["x"], *traced.symbols["u"]]
    symbols = [*traced.symbols["x"].values(), *traced.symbols["u"].values()]
    p = {v.name: v.start for v in model.of("parameter")} | {
        "coulomb_friction_positive": 0.01,
        "coulomb_friction_negative": 0.02,
        "stribeck_friction": 0.005,
        "added_mass": 0.2,
        "added_length": 0.03,
        "equilibrium_angle": 0.1,
    }
    exact = sympy.Matrix([traced.derivatives["angle"], traced.derivatives["speed"]]).jacobian(symbols)
    exact = exact.subs({traced.symbols["p"][name]: value for name, value in p.items()})
    rng = np.random.default_rng(3)
    for point in rng.uniform(-1, 1, (20, 3)):
        found = np.array(exact.subs(dict(zip(symbols, point, strict=True)))).astype(float)
        assert found == pytest.approx(numerical_jacobian(model, names, point, p), rel=1e-6, abs=1e-6)


def numerical_jacobian(model: Model, names: list[str], point: np.ndarray, p: Mapping[str, Any]) -> np.ndarray:
    def rates(values: np.ndarray) -> np.ndarray:
        given = namespace(dict(zip(names, values, strict=True)))
        assert model.derivatives is not None
        return np.array(list(model.derivatives(0.0, given, given, namespace(p)).values()))

    h = 1e-6
    columns = [(rates(point + h * e) - rates(point - h * e)) / (2 * h) for e in np.eye(len(point))]
    return np.array(columns).T


PENDULUM = library.find("pendulum")


def refused(**functions: Any) -> str:
    with pytest.raises(ModelError) as error:
        symbolic.trace(replace(PENDULUM, **functions))
    return str(error.value)


def test_what_sympy_fails_to_simplify_is_traced_as_it_is_written() -> None:
    def outputs(t: Any, x: Any, u: Any, p: Any) -> dict[str, Any]:
        first = ops.where(u.torque < x.angle, x.speed, 1.0)
        second = ops.where(first < x.angle, 0.5, 2.0)
        return {"energy": ops.where(second > 0.7, 3.0, x.angle) ** 2, "acceleration": 0.0}

    model = replace(PENDULUM, outputs=outputs)
    assert symbolic.trace(model).outputs == symbolic.trace(model, as_written=True).outputs
    assert symbolic.feed_through(model)["energy"] == ("torque",)


def test_a_state_left_out_and_a_name_made_up_are_both_named() -> None:
    message = refused(derivatives=lambda t, x, u, p: {"angle": x.speed, "sped": 0.0})
    assert "returns nothing for speed and 'sped', which it returns, is not declared; did you mean 'speed'?" in message
    assert "returns nothing for energy; " in refused(outputs=lambda t, x, u, p: {"acceleration": 0.0})


def test_a_missing_function_is_refused() -> None:
    assert "nothing gives angle, speed; write derivatives()" in refused(derivatives=None)
