"""What leaving out modes does: bounded before, measured after, against free runs of models put together anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification.linear.modes import from_modes, modes
from identification.linear.reduction import one_by_one, together, without_constants
from tests.support.identification.linear_fits import eigenvalue, model_of, white

EIGENVALUES = [eigenvalue(5.0, 0.02), eigenvalue(17.0, 0.03), eigenvalue(40.0, 0.1), 0.9, 1.0]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.sets(st.integers(0, 4), min_size=0, max_size=5))
def test_the_error_of_what_is_dropped_is_the_free_runs_and_never_above_the_bound(seed: int, kept: set[int]) -> None:
    model, u = model_of(EIGENVALUES, seed, inputs=2), white(400, inputs=2, seed=seed)
    found = together(model, sorted(kept), u)
    whole = model.simulate(u)
    left = from_modes([modes(model)[i] for i in sorted(kept)], model).simulate(u) if kept else 0 * whole
    expected = np.abs(whole - left).mean(axis=0).max() / np.abs(whole).mean(axis=0).max()
    assert found.measured == pytest.approx(expected, rel=1e-6, abs=1e-12)
    assert found.measured <= found.bound * (1 + 1e-9) + 1e-12
    assert len(found.dropped) == 5 - len(kept)


def test_one_mode_alone_attains_its_bound() -> None:
    model, u = model_of(EIGENVALUES, 3), white(400, seed=4)
    for dropped in one_by_one(model, u):
        assert dropped.measured == pytest.approx(dropped.bound, rel=1e-6)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([1 - 3e-15, 1.0, 1 + 3e-15]))
def test_a_state_that_only_adds_a_constant_goes_on_either_side_of_one(seed: int, beside_one: float) -> None:
    model, u = model_of(EIGENVALUES[:4], seed, inputs=2), white(400, inputs=2, seed=seed)
    n = model.order
    a, b, c = np.eye(n + 1) * beside_one, np.zeros((n + 1, 2)), np.ones((len(model.outputs), n + 1))
    a[:n, :n], b[:n], c[:, :n] = model.a, model.b, model.c
    rng = np.random.default_rng(seed)
    basis = np.linalg.qr(rng.normal(size=(n + 1, n + 1)))[0] * rng.uniform(0.2, 5, n + 1)  # far from singular
    left = without_constants(replace(model, a=a, b=b, c=c).transformed(basis), [u])
    assert left.order == n
    np.testing.assert_allclose(left.simulate(u), model.simulate(u), rtol=1e-6, atol=1e-9)


def test_an_integrator_that_an_input_moves_stays() -> None:
    model = model_of(EIGENVALUES, 3)
    assert without_constants(model, [white(400, seed=4)]) is model
