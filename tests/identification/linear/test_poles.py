"""Poles put on request: which move, which stay, and their eigenvectors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import IdentificationError
from identification.linear.model import LinearModel
from identification.linear.poles import LARGEST, constrained, injecting, stabilised
from tests.support.identification.linear_systems import random_system, sorted_poles, system

UNSTABLE = system([1.1, 1.02 * np.exp(0.4j), 0.9 * np.exp(1.2j), 0.5], outputs=2)


def contained(value: complex, values: np.ndarray) -> bool:
    return bool(np.abs(values - value).min() < 1e-9)


def test_unstable_poles_are_reflected_and_the_others_keep_value_and_eigenvector() -> None:
    a, moves = constrained(UNSTABLE.a, "stable")
    values, vectors = np.linalg.eig(a)
    for wanted in (1 / 1.1, np.exp(0.4j) / 1.02, np.exp(-0.4j) / 1.02, 0.9 * np.exp(1.2j), 0.5):
        assert contained(wanted, values)
    assert sorted(abs(move.before) for move in moves) == pytest.approx([1.02, 1.02, 1.1])
    before, shapes = np.linalg.eig(UNSTABLE.a)
    kept, same = shapes[:, np.argmin(np.abs(before - 0.5))], vectors[:, np.argmin(np.abs(values - 0.5))]
    assert abs(kept.conj() @ same) == pytest.approx(1)


def test_poles_on_the_circle_move_just_inside_as_published() -> None:
    (move,) = constrained(np.array([[1.0000235]]), "stable")[1]
    assert move.after == LARGEST == 0.9999
    assert constrained(np.array([[1.0]]), "stable")[0][0, 0] == pytest.approx(LARGEST)
    assert constrained(np.array([[-1.5]]), "stable")[0][0, 0] == pytest.approx(-1 / 1.5)


def test_an_integrator_is_the_nearest_real_pole_and_the_other_unstable_ones_move_inside() -> None:
    a, moves = constrained(UNSTABLE.a, "integrating")
    values = np.linalg.eigvals(a)
    assert contained(1.0, values)
    assert np.sort(np.abs(values))[-2] < 1
    assert len(moves) == 3


@given(st.integers(0, 200))
def test_a_stable_model_is_left_as_it_is(seed: int) -> None:
    model = random_system(seed)
    for poles in ("free", "stable"):
        a, moves = constrained(model.a, poles)  # type: ignore[arg-type]
        assert np.array_equal(a, model.a)
        assert not moves


@pytest.mark.parametrize("outputs", [1, 2])
@pytest.mark.parametrize("poles", ["stable", "integrating"])
def test_output_injection_puts_the_same_poles_where_they_belong(poles: str, outputs: int) -> None:
    c = UNSTABLE.c[:outputs]
    gain, moves = injecting(UNSTABLE.a, c, poles)  # type: ignore[arg-type]
    direct, same = constrained(UNSTABLE.a, poles)  # type: ignore[arg-type]
    found = np.linalg.eigvals(UNSTABLE.a + gain @ c)
    assert np.abs(np.sort_complex(found) - np.sort_complex(np.linalg.eigvals(direct))).max() < 1e-8
    assert [move.after for move in moves] == [move.after for move in same]


def test_injection_into_a_stable_model_is_none() -> None:
    model = random_system(1)
    assert not injecting(model.a, model.c, "stable")[0].any()
    assert not injecting(UNSTABLE.a, UNSTABLE.c, "free")[0].any()


def test_an_integrating_model_needs_a_real_pole() -> None:
    with pytest.raises(IdentificationError, match="of order 2 has no real pole"):
        constrained(system([0.9j]).a, "integrating")
    assert sorted_poles(UNSTABLE)[-1] == pytest.approx(1.1)


def test_stabilising_moves_what_is_outside_to_one_radius_at_its_angle_and_an_integrator_stays() -> None:
    moved = stabilised(system([1.0003, 1.0, 1.02 * np.exp(0.3j), 0.7]))
    assert np.sort(np.abs(moved.eigenvalues)) == pytest.approx([0.7, LARGEST, LARGEST, LARGEST, 1.0], abs=1e-12)
    assert np.angle([z for z in moved.eigenvalues if z.imag > 1e-6]) == pytest.approx([0.3])


@given(st.integers(0, 200))
def test_stabilising_leaves_a_stable_model_alone_bit_for_bit(seed: int) -> None:
    model = system([1.0, 0.99, 0.97 * np.exp(0.5j), 0.3], seed=seed)  # the integrator is off 1 by rounding
    same = stabilised(model)
    assert all(np.array_equal(getattr(same, name), getattr(model, name)) for name in "abcd")


@given(st.integers(0, 200))
def test_stabilising_changes_no_mode_but_the_unstable_ones_however_near_the_others_are_to_each_other(seed: int) -> None:
    pair = np.array([[0.9, 1.0], [0.0, 0.9 + 1e-10]])  # nearly one eigenvector: no modal basis holds ten digits
    rng = np.random.default_rng(seed)
    stable = LinearModel(pair, rng.normal(size=(2, 1)), rng.normal(size=(1, 2)), np.zeros((1, 1)), 0.01, ("u",), ("y",))
    a = np.block([[pair, np.zeros((2, 1))], [np.zeros((1, 2)), np.array([[1.01]])]])
    whole = replace(stable, a=a, b=np.vstack([stable.b, 1.0]), c=np.hstack([stable.c, [[0.0]]]))
    turned = whole.transformed(np.linalg.qr(rng.normal(size=(3, 3)))[0])
    u = rng.normal(size=(200, 1))
    expected = stable.simulate(u)
    assert stabilised(turned).simulate(u) == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def test_unstable_poles_with_one_eigenvector_are_refused() -> None:
    with pytest.raises(IdentificationError, match="have one eigenvector"):
        constrained(np.array([[1.1, 1.0], [0.0, 1.1]]), "stable")
