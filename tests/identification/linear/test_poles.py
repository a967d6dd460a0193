"""Poles put on request: which move, which stay, and their eigenvectors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import IdentificationError
from identification.linear.poles import LARGEST, constrained, injecting
from tests.support.linear_systems import random_system, sorted_poles, system

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
