"""Following modes over orders, and how the uncertainty of A becomes that of frequencies and dampings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.linear.mode_tracking import shape_agreement, spreads, stabilisation
from identification.linear.model import LinearModel
from identification.linear.modes import modes
from tests.support.identification.linear_fits import eigenvalue, model_of


def test_a_mode_that_stays_is_stable_and_one_that_wanders_is_not() -> None:
    steady = eigenvalue(9.0, 0.03)
    models = [_with(steady, eigenvalue(20.0 + order, 0.01), order) for order in (4, 6, 8)]
    found = stabilisation(models)
    assert all(seen.stable for seen in found if seen.order > 4 and abs(seen.mode.frequency - 9.0) < 1e-6)
    assert not any(seen.in_frequency for seen in found if seen.order > 4 and abs(seen.mode.frequency - 9.0) > 5)
    assert not any(seen.in_frequency for seen in found if seen.order == 4)


def _with(steady: complex, wandering: complex, order: int) -> LinearModel:
    model = model_of([steady, wandering], mixed=False)
    padded = model_of([steady, wandering, *[0.1 * i for i in range(1, order - 3)]], mixed=False)
    return replace(padded, c=np.hstack([model.c[:, :2], padded.c[:, 2:]]))


def test_shapes_agree_with_their_multiples_and_not_with_orthogonal_ones() -> None:
    first, second = modes(model_of([0.9 + 0.3j, 0.5 + 0.5j], outputs=2))
    assert shape_agreement(first, first) == pytest.approx(1.0)
    assert 0.0 <= shape_agreement(first, second) < 1.0


def test_spreads_are_those_of_random_draws() -> None:
    model = model_of([eigenvalue(9.0, 0.03), eigenvalue(23.0, 0.05), 0.98])
    rng = np.random.default_rng(5)
    sensitivity = rng.normal(size=(3, 5, 5))
    root = 1e-5 * rng.normal(size=(3, 3))
    drawn = np.array([_figures(model, sensitivity, root @ rng.normal(size=3)) for _ in range(4000)])
    expected = drawn.std(axis=0)
    found = spreads(model, sensitivity, root @ root.T)
    assert [spread.frequency for spread in found] == pytest.approx(expected[:, 0].tolist(), rel=0.06)
    assert [spread.damping for spread in found[:2]] == pytest.approx(expected[:2, 1].tolist(), rel=0.06)


def _figures(model: LinearModel, sensitivity: np.ndarray, move: np.ndarray) -> list[list[float]]:
    a = model.a + np.einsum("p,pij->ij", move, sensitivity)
    moved = LinearModel(a, model.b, model.c, model.d, model.step, model.inputs, model.outputs)
    return [[mode.frequency, mode.damping] for mode in modes(moved)]
