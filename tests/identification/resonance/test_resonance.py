"""The published estimate of a resonance is the formula of the thesis, and the truth of other tests a resonance."""

from __future__ import annotations

import control
import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy import optimize

from fmus.errors import IdentificationError
from identification.resonance.resonance import decibel, resonance_from_two_largest_as_published
from tests.support.identification.pendulum_resonance import resonance_frequency

A0, A1, B0 = 15.0923, 0.30769, 3076.92
OMEGA_OPT = np.sqrt(A0 - A1**2 / 2)


def gain(omega: ArrayLike) -> np.ndarray:
    return np.abs(control.tf([B0], [1.0, A1, A0])(1j * np.asarray(omega)))


def test_the_resonance_is_where_the_gain_is_largest() -> None:
    found = optimize.minimize_scalar(lambda w: -gain([w])[0], bounds=(3, 5), method="bounded", options={"xatol": 1e-9})
    assert resonance_frequency(1.0, A1, A0) == pytest.approx(found.x, rel=1e-6)


def test_the_added_mass_changes_inertia_and_torque() -> None:
    mass, length = np.array([0.0, 0.1]), 0.2
    inertia, torque = 0.003 + mass * length**2, 0.05 + mass * 9.81 * length
    expected = [float(resonance_frequency(i, 0.001, q)) for i, q in zip(inertia, torque, strict=True)]
    assert resonance_frequency(0.003, 0.001, 0.05, mass, length) == pytest.approx(expected)


def test_strong_damping_leaves_no_resonance() -> None:
    assert resonance_frequency(1.0, 10.0, 1.0) == 0


def test_eq_100_is_eq_90_as_published_with_the_largest_gain_for_the_peak() -> None:
    (w1, w2), (g1, g2) = (3.5, 4.0), gain([3.5, 4.0])
    r = (g1 / g2) ** 2
    by_hand = np.sqrt((w2**2 * np.sqrt(r + 1) + w1**2 * np.sqrt(2)) / (np.sqrt(r + 1) + np.sqrt(2)))
    assert g2 > g1
    assert resonance_from_two_largest_as_published([w1, w2, 6.0], [g1, g2, 1.0]) == pytest.approx(by_hand)


def test_decibels_of_ten_are_twenty() -> None:
    assert decibel([10.0, 1.0]) == pytest.approx([20.0, 0.0])


@pytest.mark.parametrize(
    ("omega", "gains", "problem"),
    [
        ([4.0], [1.0], "needs 2"),
        ([4.0, 4.5], [1.0, np.nan], "needs 2 finite"),
        ([4.0, 4.5, 5.0], [1.0, 2.0], "as many frequencies"),
    ],
)
def test_columns_that_do_not_fit_are_refused(omega: list[float], gains: list[float], problem: str) -> None:
    with pytest.raises(IdentificationError, match=problem):
        resonance_from_two_largest_as_published(omega, gains)
