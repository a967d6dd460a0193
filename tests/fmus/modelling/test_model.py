"""What a model may declare, and what is refused before anything runs."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus import library
from fmus.modelling.model import (
    Model,
    State,
    Table,
    Variable,
    array,
    assign,
    element,
    element_names,
    element_number,
    input_,
    namespace,
    output,
    parameter,
    start_values,
)

VARIABLES = (
    input_("force", "N", "Input"),
    output("position", "m", "Output"),
    parameter("mass", "kg", 2.0, "Real"),
    parameter("count", "1", 3, "Integer", minimum=1),
    parameter("on", "1", True, "Boolean"),
    parameter("period", "s", 0.1, "Sample period"),
)
VALID: dict[str, Any] = {"name": "cart", "description": "A cart", "variables": VARIABLES}


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"variables": (*VARIABLES, VARIABLES[0])}, "one name"),
        ({"states": (State("x", sampled=True), State("x", sampled=True)), "sample_time": "period"}, "one name"),
        ({"name": "my cart"}, "'my cart' is no name"),
        ({"variables": (parameter("lambda", "1", 1.0, ""),)}, "'lambda' is no name"),
        ({"tables": ("a-b",)}, "'a-b' is no name"),
        ({"states": (State("x", "start"),), "solver_step": lambda p: 1.0}, "starts at 'start'"),
        ({"states": (State("mass"),), "solver_step": lambda p: 1.0}, "'mass' has the name of a variable"),
        ({"states": (State("x", sampled=True),)}, "need a sample period"),
        ({"states": (State("x", sampled=True),), "sample_time": "tick"}, "'tick' is no parameter"),
        ({"states": (State("x"),)}, "need a solver_step"),
    ],
)
def test_declarations_that_do_not_fit_together_are_refused(change: dict[str, Any], problem: str) -> None:
    Model(**VALID)
    with pytest.raises(ValueError, match=problem):
        Model(**(VALID | change))


def test_the_type_of_a_variable_is_that_of_its_start_value() -> None:
    types = {variable.name: variable.type for variable in Model(**VALID).variables}
    assert types == {
        "force": "Real",
        "position": "Real",
        "mass": "Real",
        "count": "Integer",
        "on": "Boolean",
        "period": "Real",
    }


def test_start_values_are_those_of_inputs_and_parameters() -> None:
    assert start_values(Model(**VALID)) == {"force": 0.0, "mass": 2.0, "count": 3, "on": True, "period": 0.1}


@pytest.mark.parametrize(
    ("time", "values", "problem"),
    [
        ((), (), "0 instants"),
        ((0.0, 1.0), (0.0,), "2 instants for 1"),
        ((0.0, 0.0), (1.0, 2.0), "increase strictly"),
        ((1.0, 0.0), (1.0, 2.0), "increase strictly"),
        ((0.0, float("nan")), (1.0, 2.0), "increase strictly"),
    ],
)
def test_a_table_needs_one_value_an_instant_and_instants_that_increase(
    time: tuple[float, ...], values: tuple[float, ...], problem: str
) -> None:
    with pytest.raises(ValueError, match=problem):
        Table("data", time, values)


@pytest.mark.parametrize("name", library.names())
def test_defaults_of_the_library_lie_within_their_bounds(name: str) -> None:
    for variable in library.find(name).variables:
        if variable.start is not None:
            assert variable.minimum is None or variable.start >= variable.minimum, variable.name
            assert variable.maximum is None or variable.start <= variable.maximum, variable.name


@pytest.mark.parametrize("name", library.names())
def test_every_variable_of_the_library_has_a_description_and_a_unit(name: str) -> None:
    for variable in library.find(name).variables:
        assert variable.description
        assert variable.unit


def test_models_are_values() -> None:
    model = Model(**VALID)
    assert model == replace(model)
    assert model != replace(model, name="other")


def with_parameters(*variables: Variable) -> Model:
    return Model("m", "Model", (output("y", "1", "Output"), *variables), outputs=lambda t, x, u, p: {"y": 0.0})


def test_elements_of_arrays_come_as_nested_lists_too() -> None:
    values = {"A[1,1]": 1.0, "A[1,2]": 2.0, "A[2,1]": 3.0, "A[2,2]": 4.0, "b[1]": 5.0, "c": 6.0}
    space = namespace(values)
    assert (space.A, space.b, space.c) == ([[1.0, 2.0], [3.0, 4.0]], [5.0], 6.0)
    assign(space, "A[2,1]", 9.0)
    assert space.A == [[1.0, 2.0], [9.0, 4.0]]
    assert vars(space)["A[2,1]"] == 9.0


def test_an_array_declares_an_element_for_each_place_row_by_row() -> None:
    model = with_parameters(*array("A", "1", (2, 3), "Matrix", range(6)), *array("b", "1", (2,), "Vector"))
    assert model.arrays == {"A": (2, 3), "b": (2,)}
    assert start_values(model) == {
        "A[1,1]": 0,
        "A[1,2]": 1,
        "A[1,3]": 2,
        "A[2,1]": 3,
        "A[2,2]": 4,
        "A[2,3]": 5,
        "b[1]": 0.0,
        "b[2]": 0.0,
    }


@given(st.lists(st.integers(1, 4), min_size=1, max_size=3))
def test_the_number_of_an_element_is_its_place_among_the_names(shape: list[int]) -> None:
    places = [element(name) for name in element_names("A", shape)]
    assert [element_number(place[1], shape) for place in places if place] == list(range(math.prod(shape)))
    assert element_number([1] * (len(shape) + 1), shape) is None
    assert element_number([size + 1 for size in shape], shape) is None


@pytest.mark.parametrize(
    ("variables", "problem"),
    [
        ([parameter("A[2]", "1", 0.0, "A"), parameter("A[1]", "1", 0.0, "A")], "not all there"),
        ([parameter("A[1]", "1", 0.0, "A"), parameter("A[3]", "1", 0.0, "A")], "not all there"),
        (
            [parameter("A[1]", "1", 0.0, "A"), parameter("b", "1", 0.0, "b"), parameter("A[2]", "1", 0.0, "A")],
            "not all",
        ),
        ([parameter("A[1]", "1", 0.0, "A"), parameter("A", "1", 0.0, "A")], "an array and something else"),
        ([parameter("A[1]", "1", 3, "A")], "must be real parameters"),
        ([input_("A[1]", "1", "A")], "must be real parameters"),
        ([parameter("A[0]", "1", 0.0, "A")], "no name"),
        ([parameter("1A[1]", "1", 0.0, "A")], "no name"),
    ],
)
def test_arrays_that_are_not_whole_are_refused(variables: list[Variable], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        with_parameters(*variables)
