"""Simulation, frequency response and change of states of a linear model, against loops and python-control."""

from __future__ import annotations

import warnings
from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import IdentificationError
from identification.linear.model import LinearModel
from identification.linear.recursion import recursion
from tests.support.identification.linear_systems import STEP, distance, random_system, system


def looped(model: LinearModel, u: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States and outputs, sample by sample."""
    states, outputs = [], []
    for now in u:
        states.append(x)
        outputs.append(model.c @ x + model.d @ now)
        x = model.a @ x + model.b @ now
    return np.array(states), np.array(outputs)


@pytest.mark.slow
@given(seed=st.integers(0, 100), samples=st.integers(1, 700), inputs=st.integers(1, 3))
def test_simulation_is_the_loop_over_samples(seed: int, samples: int, inputs: int) -> None:
    model, rng = random_system(seed, inputs=inputs), np.random.default_rng(seed)
    u, start = rng.standard_normal((samples, inputs)), rng.standard_normal(model.order)
    states, outputs = looped(model, u, start)
    assert model.states(u, start) == pytest.approx(states, abs=1e-11)
    assert model.simulate(u, start) == pytest.approx(outputs, abs=1e-11)


def test_simulation_without_a_start_is_from_the_origin() -> None:
    model = random_system(1)
    u = np.ones((5, 1))
    assert np.array_equal(model.simulate(u), model.simulate(u, np.zeros(model.order)))
    assert model.simulate(u[:0]).shape == (0, 2)


def test_simulation_of_a_defective_system_is_exact() -> None:
    chain = LinearModel(
        np.array([[1.0, 1.0], [0.0, 1.0]]),
        np.array([[0.0], [1.0]]),
        np.eye(2)[:1],
        np.zeros((1, 1)),
        STEP,
        ("u",),
        ("y",),
    )
    k = np.arange(1000.0)
    assert chain.simulate(np.ones((1000, 1)))[:, 0] == pytest.approx(k * (k - 1) / 2, rel=1e-12)


def test_simulation_agrees_with_python_control() -> None:
    model = random_system(3, inputs=2)
    u = np.random.default_rng(0).standard_normal((400, 2))
    theirs = control.forced_response(model.control(), inputs=u.T).outputs.T
    assert model.simulate(u) == pytest.approx(theirs, abs=1e-10)


def test_a_run_that_overflows_is_not_finite_and_warns_of_nothing() -> None:
    runaway = system([2.0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not np.isfinite(runaway.simulate(np.ones((3000, 1)))[-1]).any()


def test_the_recursion_hands_over_the_state_behind_its_last_sample() -> None:
    rng = np.random.default_rng(5)
    a, force, start = 0.3 * rng.standard_normal((3, 3)), rng.standard_normal((90, 2, 3)), rng.standard_normal((2, 3))
    whole, end = recursion(a, force, start)
    first, middle = recursion(a, force[:37], start)
    second, last = recursion(a, force[37:], middle)
    assert np.concatenate([first, second]) == pytest.approx(whole, abs=1e-13)
    assert last == pytest.approx(end, abs=1e-13)


def test_frequency_response_agrees_with_python_control() -> None:
    model, omega = random_system(2, inputs=2), np.geomspace(0.1, 300, 30)
    theirs = control.frequency_response(model.control(), omega).complex
    assert np.abs(model.frequency_response(omega) - np.moveaxis(theirs, -1, 0)).max() < 1e-9


@given(st.integers(0, 100))
def test_a_change_of_states_leaves_poles_and_response_alone(seed: int) -> None:
    model, rng = random_system(seed), np.random.default_rng(seed)
    other = model.transformed(np.linalg.qr(rng.standard_normal((5, 5)))[0] * rng.uniform(0.1, 10, 5))
    assert distance(other, model) < 1e-9
    assert np.poly(other.a) == pytest.approx(np.poly(model.a), abs=1e-9)


@pytest.mark.parametrize("name", ["b", "c", "d"])
def test_matrices_that_do_not_fit_are_refused_by_name(name: str) -> None:
    with pytest.raises(IdentificationError, match=f"linear model: {name.upper()} is"):
        replace(random_system(0), **{name: np.zeros((7, 7))})


def test_models_are_equal_when_all_their_numbers_are_and_cannot_be_written_to() -> None:
    model = random_system(0)
    again = random_system(0)
    assert (again, hash(again)) == (model, hash(model))
    assert replace(model, c=model.c * (1 + 1e-15)) != model
    assert replace(model, inputs=("torque",)) != model
    with pytest.raises(ValueError, match="read-only"):
        model.a[0, 0] = 1.0
    assert repr(model) == "<LinearModel of order 5, u1 to y1, y2, every 0.01 s>"
