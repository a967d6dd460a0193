"""Declarations of what is free, and their scaling."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import IdentificationError
from identification.estimation.parameters import Around, InitialState, Parameter, ParameterSet, Tie

positive = st.floats(1e-6, 1e6)


@given(start=positive, value=positive, scale=st.sampled_from(["linear", "log"]))
def test_scaling_there_and_back_keeps_the_value(start, value, scale):
    parameter = Parameter("rig.mass", start, 1e-7, 1e7, scale=scale)
    # On the linear scale a value is start + z * size: its rounding error is relative to the larger of the two.
    assert parameter.value(parameter.z(value)) == pytest.approx(value, rel=1e-12, abs=1e-15 * start)


@given(start=st.floats(-10, 10), z=st.floats(-1e6, 1e6))
def test_a_value_never_leaves_the_bounds(start, z):
    assert -10 <= Parameter("rig.offset", start, -10, 10).value(z) <= 10


@given(start=positive, z=st.floats(-3, 3), scale=st.sampled_from(["linear", "log"]))
def test_slope_is_the_derivative_of_the_value(start, z, scale):
    parameter = Parameter("rig.mass", start, scale=scale)
    h = 1e-6
    numeric = (parameter.unbounded(z + h) - parameter.unbounded(z - h)) / (2 * h)
    assert parameter.slope(z) == pytest.approx(numeric, rel=1e-6)


def test_the_start_is_the_origin_of_z():
    parameters = ParameterSet((Parameter("a", 3.0), Parameter("b", 5.0, 0, 9, scale="log"), Parameter("c", 0.0)))
    assert parameters.values(np.zeros(3)) == {"a": 3.0, "b": 5.0, "c": 0.0}


def test_bounds_in_z_are_where_the_values_reach_the_bounds():
    parameters = (Parameter("a", 2.0, -4, 3), Parameter("b", 2.0, 0.5, 8, scale="log"))
    for parameter in parameters:
        low, high = parameter.z_bounds
        assert parameter.unbounded(low) == pytest.approx(parameter.lower)
        assert parameter.unbounded(high) == pytest.approx(parameter.upper)
    assert Parameter("c", 1.0, 0.0, scale="log").z_bounds == (-math.inf, math.inf)


def test_a_start_of_zero_takes_its_size_from_the_bounds():
    assert Parameter("a", 0.0, 0.0, 0.5).size == pytest.approx(0.005)
    assert Parameter("a", 0.0).size == 1.0


def test_initial_states_move_from_each_windows_start_by_one_size_and_stay_within_their_bounds():
    state = InitialState("rig.angle", (1, -2.0), -2.5, 2.0)
    assert state.size == 2.0 and state.start == (1.0, -2.0)
    assert [state.value(0, z) for z in (0.0, 0.25, -0.25, 3.0)] == [1.0, 1.5, 0.5, 2.0]
    assert [state.value(1, z) for z in (0.0, 0.25, -3.0)] == [-2.0, -1.5, -2.5]
    lower, upper = state.z_bounds
    assert lower.tolist() == [-1.75, -0.25] and upper.tolist() == [0.5, 2.0]


def test_tied_and_fixed_parameters_follow_and_stay():
    parameters = ParameterSet(
        (Parameter("hand.coulomb_positive", 1.0), Parameter("hand.inertia", 7.0, fixed=True)),
        (Tie("hand.coulomb_negative", "hand.coulomb_positive", 0.5),),
    )
    assert [p.name for p in parameters.free] == ["hand.coulomb_positive"]
    assert parameters.values(np.array([3.0])) == {
        "hand.coulomb_positive": 4.0,
        "hand.inertia": 7.0,
        "hand.coulomb_negative": 2.0,
    }


def test_fixed_at_leaves_nothing_free():
    parameters = ParameterSet((Parameter("a", 1.0), Parameter("b", 2.0)), (Tie("c", "a"),))
    fixed = parameters.fixed_at({"a": 5.0})
    assert fixed.free == ()
    assert fixed.values(np.zeros(0)) == {"a": 5.0, "b": 2.0, "c": 5.0}


@pytest.mark.parametrize(
    ("make", "place", "problem"),
    [
        (lambda: Parameter("rig.a", 2.0, 0.0, 1.0), "rig.a", "start 2 is not within 0 to 1"),
        (lambda: Parameter("rig.a", 1.0, 2.0, 2.0), "rig.a", "leave no room"),
        (lambda: Parameter("rig.a", math.nan), "rig.a", "start nan"),
        (lambda: Parameter("rig.a", 1.0, math.nan, 2.0), "rig.a", "leave no room"),
        (lambda: Parameter("rig.a", 0.0, scale="log"), "rig.a", "log scale"),
        (lambda: Parameter("rig.a", 1.0, scale="square"), "rig.a", "scale is 'square'"),  # type: ignore[arg-type]
        (lambda: InitialState("rig.x", (0.0, 3.0), -1, 1), "rig.x", "start 3 is not within"),
        (lambda: InitialState("rig.x", ()), "rig.x", "no start value"),
        (lambda: Around(("rig.a", "rig.b"), 0.0), "rig.a: around", "std 0 is not positive"),
        (lambda: ParameterSet((Parameter("a", 1), Parameter("a", 2))), "a", "declared twice"),
        (lambda: ParameterSet((Parameter("a", 1),), (Tie("a", "a"),)), "a", "declared twice"),
        (lambda: ParameterSet((Parameter("a", 1),), (Tie("b", "c"),)), "b", "'c', which is no declared"),
        (lambda: ParameterSet((Parameter("a", 1),), (Tie("b", "a", math.inf),)), "b", "factor inf"),
    ],
)
def test_a_declaration_that_makes_no_sense_is_refused_by_name(make, place, problem):
    with pytest.raises(IdentificationError) as caught:
        make()
    assert caught.value.place == place
    assert problem in caught.value.problem
